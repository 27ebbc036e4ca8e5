#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <utility>

#include "core/check.h"
#include "mismatch/calibrate/clock_posterior.h"
#include "mismatch/calibrate/law_choice.h"
#include "mismatch/calibrate/reference_fit.h"
#include "mismatch/calibrate/stages.h"
#include "mismatch/calibrate/starts.h"

namespace omentum {
namespace {

constexpr double kMeshRatio = 1.5;
// Work of simulating all recordings once, against the fine mesh without derivatives: with them on
// the coarse and the fine mesh, and without on the one that measures the error of the mesh.
constexpr double kCoarseWork = 0.4, kFineWork = 1.6, kMeshWork = 0.4;
// Work of most calibrations: starts, coarse mesh, fine mesh, mesh and step, settling, laws,
// settling again, before and left out.
constexpr std::array<double, 8> kPlan = {3.5,           5 * kCoarseWork,
                                         3 * kFineWork, kMeshWork + 2,
                                         kFineWork,     2 * (3 * kFineWork + kMeshWork),
                                         2 * kFineWork, 2.2};

/// By the converged solid.
class ReferenceStages : public Stages {
 public:
  ReferenceStages(const pb::Scene& scene, std::vector<Observation> observations,
                  const CalibrationOptions& options)
      : Stages(std::make_unique<ReferenceFit>(scene, std::move(observations), options), options,
               "reference", {kPlan.begin(), kPlan.end()}),
        elements_(count_elements(scene, options.folder, fit_.observations, options.tolerance_m)),
        coarse_elements_(
            count_elements(scene, options.folder, fit_.observations, 6 * options.tolerance_m)) {}

 private:
  void fit_recordings() override;
  Numerics fine() const override { return {pb::TISSUE_REFERENCE, elements_, 1}; }
  Numerics coarse() const { return {pb::TISSUE_REFERENCE, coarse_elements_, 1}; }

  void begin();
  void begin_held();
  void descend_coarsely();
  LawFit keep() const;
  void restore(const LawFit& fit);
  void fit_laws();
  void compare_laws();
  void judge_laws();
  void integrate();
  void measure_mesh();

  Which usable_;              ///< recordings that may be fitted
  std::vector<LawFit> laws_;  ///< the one chosen among them
  std::array<int, 3> elements_ = {}, coarse_elements_ = {};
};

/// Of bodies that are let go: a swing that is looked at for long has as many best fits as it has
/// periods, so the search begins with what is seen at first and goes on with ever more of it.
void ReferenceStages::begin_held() {
  constexpr double kFirst = 0.05, kLonger = 2;  // [s]
  constexpr double kNear = 1;                   // standard deviations
  constexpr std::size_t kFrames = 60;
  state_ = fit_.believed();
  fit_.noise = NoiseModel{0.003, 5e-4, 0.02, 4};
  bool all = false;
  for (double seconds = kFirst; !all; seconds *= kLonger) {
    const FirstFrames first(fit_.observations, seconds, kFrames);
    descend(coarse(), 6, kNear, kCoarseWork, "starts");
    all = first.all();
  }
  usable_ = fitted_;
}

/// Begins by the shell; recordings that are mirrored are named and left out.
void ReferenceStages::begin() {
  bind_markers(coarse());
  if (fit_.layout.held > 0) return begin_held();
  const Start start = find_start(fit_, fitted_, [&](double share) {
    say("starts", kPlan.front() * share * static_cast<double>(fitted_.size()));
  });
  if (!start.failure.empty()) {
    result_.warnings.push_back(
        fmt::format("the shell cannot be simulated and the search begins at what is believed: {}",
                    start.failure));
  }
  for (const std::size_t r : start.mirrored) {
    const Observation& seen = fit_.observations[r];
    result_.warnings.push_back(
        fmt::format("recording {}: the cloud shows the sheet held on the other side of its middle: "
                    "the jaws are "
                    "recorded at x_B = {:.1f} mm, seen at {:.1f} mm; it is left out of the fit",
                    seen.name, 1e3 * seen.pinch.x(), -1e3 * seen.pinch.x()));
  }
  if (start.mirrored.size() == fitted_.size())
    throw_error("every recording shows the sheet held on the other side: is x mirrored?");
  std::erase_if(fitted_, [&](std::size_t r) { return std::ranges::count(start.mirrored, r) > 0; });
  usable_ = fitted_;
  state_ = start.state;
}

/// Large cells move the numbers as far as they are told: neither all frames are needed there nor
/// rest.
void ReferenceStages::descend_coarsely() {
  constexpr double kNear = 1;
  const std::size_t kFrames = fit_.layout.held > 0 ? kMostFrames : 12;  // a swing needs more
  const FewFrames few(fit_.observations, kFrames);
  descend(coarse(), 6, kNear, kCoarseWork, "coarse mesh");
  settle_beliefs();
  descend(coarse(), 6, kNear, kCoarseWork, "coarse mesh");
  fitted_ = usable_;  // what fails on large cells may not on small ones
}

/// The mesh as a nuisance, by a simulation with larger cells.
void ReferenceStages::measure_mesh() {
  const std::array<int, 3> fewer = fewer_elements(elements_, kMeshRatio);
  const double ratio = std::sqrt(static_cast<double>(elements_[0]) * elements_[1] /
                                 (static_cast<double>(fewer[0]) * fewer[1]));
  const double fall = 1 / (std::pow(ratio, 2.5) - 1);  // docs/results.md: error ~ cell^2.5
  const auto mesh = fit_.simulate(at_, {pb::TISSUE_REFERENCE, fewer, 1}, false, fitted_);
  mesh_rms_ = fall * surfaces_apart(mesh, predictions_);
  say("mesh", kMeshWork * static_cast<double>(fitted_.size()));
  fit_.set_difference({"numerics.mesh", "1", "", Unknown::Scale::kShift, 0, 1.5,
                       "1.5 times its estimated error", false, false},
                      mesh, -fall, predictions_, at_, state_);
}

LawFit ReferenceStages::keep() const {
  return {fit_.scene.tissue().material().law(),
          {predictions_, at_, state_, sure_, settled_},
          fit_.differences,
          mesh_rms_,
          0};
}

void ReferenceStages::restore(const LawFit& fit) {
  fit_.change_law(fit.law);
  fit_.differences = fit.differences;
  mesh_rms_ = fit.mesh_rms;
  take(fit.d);
}

/// The other laws, each fitted from where the believed one led, on the same mesh and with its own
/// error of the mesh; goes on with the one that is chosen.
void ReferenceStages::fit_laws() {
  const LawFit first = keep();
  const NoiseModel noise = fit_.noise;
  laws_ = {first};
  for (const pb::ElasticLaw law : kLaws) {
    if (law == first.law) continue;
    restore(first);
    fit_.change_law(law);
    const SimulateState simulate = [&](const FitState& state) {
      auto predictions = fit_.simulate(state, fine(), true, fitted_);
      say("laws of elasticity", kFineWork * static_cast<double>(fitted_.size()));
      return predictions;
    };
    Descent d;
    d.at = state_;
    d.predictions = simulate(state_);
    const bool fails = std::ranges::any_of(fitted_, [&](std::size_t r) {
      return count_valid(d.predictions[r]) < count_valid(first.d.predictions[r]);
    });
    if (fails) {
      result_.warnings.push_back(
          fmt::format("law of elasticity: that of {} cannot be simulated where the recordings lead "
                      "with that of {}; it is not compared",
                      law_name(law), law_name(first.law)));
      continue;
    }
    omentum::descend(fit_, simulate, fitted_, 3, kSmallMove, d);
    take(std::move(d));
    measure_mesh();
    laws_.push_back(keep());
  }
  restore(first);
  fit_.noise = noise;
  compare_laws();
  restore(choose_law(laws_, first.law));
}

/// Costs of all laws at the noise and the beliefs found so far.
void ReferenceStages::compare_laws() {
  const NoiseModel noise = fit_.noise;
  for (LawFit& law : laws_) {
    fit_.improve(law.d.predictions, law.d.at, fitted_, 8, law.d.state);
    fit_.noise = noise;
    law.cost = fit_.cost(law.d.predictions, law.d.at, fitted_, law.d.state, noise);
  }
}

/// What the law is worth at the end: told from the others, or not.
void ReferenceStages::judge_laws() {
  const pb::ElasticLaw law = fit_.scene.tissue().material().law();
  LawFit& chosen = *std::ranges::find(laws_, law, &LawFit::law);
  chosen = keep();
  compare_laws();
  chosen.d.state = state_;
  for (const LawFit& fit : laws_) {
    LawRow& row = result_.laws.emplace_back(LawRow{law_name(fit.law), fit.cost - chosen.cost, {}});
    for (std::size_t k = 0; k < fit_.unknowns.size(); ++k) {
      const Unknown& unknown = fit_.unknowns[k];
      const double x = fit.d.state.shared[static_cast<Eigen::Index>(k)];
      if (unknown.in_scene) row.parameters.emplace_back(unknown.path, unknown.value(x));
    }
  }
  std::string names;
  for (const LawFit* other : laws_alike(laws_, chosen, numerics())) {
    const double behind = other->cost - chosen.cost;
    names += fmt::format("{}{} ({:.1f} {})", names.empty() ? "" : ", ", law_name(other->law),
                         std::fabs(behind), behind < 0 ? "ahead" : "behind");
    law_rms_ = std::max(law_rms_, surfaces_apart(other->d.predictions, predictions_));
  }
  if (names.empty()) return;
  result_.warnings.push_back(fmt::format(
      "law of elasticity: that of {} is not told from {}: no better, or no farther from "
      "it than mesh and step may be off. Values are those of the first, intervals reach "
      "over all of them; lift higher to tell them apart",
      law_name(law), names));
}

/// Intervals over the clocks and the laws that may be.
void ReferenceStages::integrate() {
  ClockPosterior over = integrate_clock(fit_, predictions_, at_, fitted_, state_, sure_);
  state_ = std::move(over.state);
  sure_ = std::move(over.sure);
  clock_ = over.clock;
  const pb::ElasticLaw law = fit_.scene.tissue().material().law();
  const LawFit& chosen = *std::ranges::find(laws_, law, &LawFit::law);
  widen_over_laws(chosen, laws_alike(laws_, chosen, numerics()), fitted_, sure_);
}

void ReferenceStages::fit_recordings() {
  next_stage();
  begin();
  next_stage();
  descend_coarsely();
  next_stage();
  descend(fine(), 4, kSmallMove, kFineWork, "fine mesh");
  next_stage();
  measure_mesh();
  measure_step(4.0 / 3);  // the error falls with its square
  next_stage();
  settle(kFineWork);  // else the other laws, which are simulated further, look better
  next_stage();
  fit_laws();
  next_stage();
  settle(kFineWork);
  judge_laws();
  integrate();
}

}  // namespace

Calibration calibrate_reference(const pb::Scene& scene, std::vector<Observation> observations,
                                const CalibrationOptions& options) {
  return ReferenceStages(scene, std::move(observations), options).run();
}

}  // namespace omentum