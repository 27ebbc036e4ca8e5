#include "mismatch/calibrate/law_choice.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

namespace omentum {
namespace {

bool is_told(const LawFit& better, const LawFit& other, double numerics_m) {
  return other.cost > better.cost + kLawTold &&
         surfaces_apart(better.d.linear.predictions, other.d.linear.predictions) > numerics_m;
}

}  // namespace

std::string law_name(pb::ElasticLaw law) {
  switch (law) {
    case pb::LAW_NEO_HOOKE:
      return "neo-Hooke";
    case pb::LAW_ST_VENANT_KIRCHHOFF:
      return "St. Venant and Kirchhoff";
    default:
      return "corotated";
  }
}

const LawFit& choose_law(const std::vector<LawFit>& fits, pb::ElasticLaw believed) {
  OMENTUM_CHECK(!fits.empty(), "no law was fitted");
  const LawFit& best = *std::ranges::min_element(fits, {}, &LawFit::cost);
  const auto first = std::ranges::find(fits, believed, &LawFit::law);
  return first == fits.end() || first->cost > best.cost + kLawTold ? best : *first;
}

std::vector<const LawFit*> laws_alike(const std::vector<LawFit>& fits, const LawFit& chosen,
                                      double numerics_m) {
  std::vector<const LawFit*> alike;
  for (const LawFit& fit : fits) {
    if (fit.law != chosen.law && !is_told(chosen, fit, numerics_m)) alike.push_back(&fit);
  }
  return alike;
}

void widen_over_laws(const LawFit& chosen, const std::vector<const LawFit*>& alike,
                     const Which& which, FitPosterior& posterior) {
  const double share = 1 / (1 + static_cast<double>(alike.size()));
  for (const LawFit* other : alike) {
    const Eigen::VectorXd by = other->d.found.state.shared - chosen.d.found.state.shared;
    posterior.shared_covariance += share * by * by.transpose();
    for (std::size_t i = 0; i < which.size(); ++i) {
      const Eigen::VectorXd own =
          other->d.found.state.own[which[i]] - chosen.d.found.state.own[which[i]];
      posterior.own_sd[i] =
          (posterior.own_sd[i].array().square() + share * own.array().square()).sqrt();
    }
  }
}

}  // namespace omentum
