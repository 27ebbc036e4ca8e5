#include "mismatch/explain/dispersion.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "mismatch/explain/fold_evidence.h"
#include "mismatch/explain/left_out_gains.h"

namespace omentum {
namespace {

using Eigen::ArrayXd;
using Eigen::Index;

/// Of every atom that all know, jackknife variance of its amplitude over the variance that its
/// information says; the median of them.
Result<double> median_scatter(const FoldEvidence& evidence) {
  auto all = project_atoms(evidence);
  if (!all) return Failure{all.error()};
  const ArrayXd information = all.value().information.diagonal();
  const auto count = static_cast<double>(evidence.folds.size());
  ArrayXd sum = ArrayXd::Zero(information.size()), squares = sum;
  for (std::size_t r = 0; r < evidence.folds.size(); ++r) {
    auto others = project_atoms_without(evidence, {&r, 1});
    if (!others) return Failure{others.error()};
    const ArrayXd amplitude =
        others.value().score.array() / others.value().information.diagonal().array();
    sum += amplitude;
    squares += amplitude.square();
  }
  const ArrayXd variance = (count - 1) / count * (squares - sum.square() / count);
  std::vector<double> ratios;
  for (Index k = 0; k < information.size(); ++k) {
    const double ratio = variance[k] * information[k];
    if (information[k] > 0 && std::isfinite(ratio)) ratios.push_back(ratio);
  }
  if (ratios.empty()) return 0.0;
  const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
  std::ranges::nth_element(ratios, middle);
  return *middle;
}

}  // namespace

void disperse(double dispersion, std::span<Evidence> recordings) {
  for (Evidence& recording : recordings) {
    recording.A /= dispersion;
    recording.b /= dispersion;
    recording.log_constant /= dispersion;
  }
}

Result<double> learned_dispersion(std::span<const Evidence> recordings,
                                  std::span<const std::string> fold_of) {
  constexpr double kStep = 1.25, kMost = 100;
  double dispersion = 1;
  for (; dispersion * kStep < kMost; dispersion *= kStep) {
    std::vector<Evidence> dispersed(recordings.begin(), recordings.end());
    disperse(dispersion, dispersed);
    auto folds = make_folds(dispersed, fold_of);
    if (!folds) return Failure{folds.error()};
    if (folds.value().folds.size() < kLeastTrimmed) return 1.0;
    auto scatter = median_scatter(folds.value());
    if (!scatter) return Failure{scatter.error()};
    if (scatter.value() <= 1) break;
  }
  return dispersion;
}

}  // namespace omentum
