#include "mismatch/explain/detection_limits.h"

#include <cmath>
#include <limits>
#include <map>

namespace omentum {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

/// What a trimmed sum leaves out of the information on an atom: fold that knows most, fold that
/// knows least, by the diagonal of their own evidence. Empty with fewer than five folds.
std::vector<std::size_t> trimmed_folds(const FoldEvidence& evidence, Index k) {
  if (evidence.folds.size() < kLeastTrimmed) return {};
  std::size_t most = 0, least = 0;
  const auto information = [&](std::size_t r) { return evidence.folds[r].A(k, k); };
  for (std::size_t r = 1; r < evidence.folds.size(); ++r) {
    if (information(r) > information(most)) most = r;
    if (information(r) < information(least)) least = r;
  }
  // Folds that know the same: any two of them.
  if (most == least) least = 1;
  return {most, least};
}

/// Standard deviation of every atom without the folds that trimming leaves out; infinite where
/// nothing is known.
Result<VectorXd> trimmed_sd(const FoldEvidence& evidence) {
  VectorXd sd(evidence.atoms());
  std::map<std::vector<std::size_t>, VectorXd> known;  // few pairs serve all atoms
  for (Index k = 0; k < sd.size(); ++k) {
    const std::vector<std::size_t> left_out = trimmed_folds(evidence, evidence.fitted + k);
    auto found = known.find(left_out);
    if (found == known.end()) {
      auto projected = project_atoms_without(evidence, left_out);
      if (!projected) return Failure{projected.error()};
      found = known.emplace(left_out, projected.value().information.diagonal()).first;
    }
    sd[k] = 1 / std::sqrt(found->second[k]);
  }
  return sd;
}

bool one_effect(const Number& one, const Number& other) {
  return !one.effect.empty() && one.effect == other.effect;
}

}  // namespace

Result<std::vector<DetectionLimit>> detection_limits(const FoldEvidence& evidence,
                                                     const Floors& floors,
                                                     const Thresholds& thresholds,
                                                     double dispersion) {
  auto sd = trimmed_sd(evidence);
  if (!sd) return Failure{sd.error()};
  auto cosine = cosines(evidence);
  if (!cosine) return Failure{cosine.error()};
  // Few folds scatter by chance, so that a gain is divided by more than `dispersion`: for seven
  // that agree by 1.2 in the mean.
  constexpr double kByChance = 1.2;
  const double gain = thresholds.gain * (thresholds.by_dispersion ? kByChance * dispersion : 1);
  // sqrt(2 G*) sd are as likely claimed as not, one more is claimed with 84 %.
  const double deviations = std::sqrt(2 * gain) + std::sqrt(dispersion);
  std::vector<DetectionLimit> limits;
  for (int k = 0; k < evidence.atoms(); ++k) {
    DetectionLimit limit;
    limit.atom = evidence.atom(k).key;
    if (const auto floor = floors.find(limit.atom); floor != floors.end())
      limit.floor = floor->second;
    for (int j = 0; j < evidence.atoms(); ++j) {
      const double alike = std::fabs(cosine.value()(k, j));
      if (j == k || one_effect(evidence.atom(k), evidence.atom(j)) || !(alike > limit.cosine))
        continue;
      limit.cosine = alike;
      limit.look_alike = evidence.atom(j).key;
    }
    const double needed = deviations * sd.value()[k];
    limit.testable = std::isfinite(needed);
    limit.detected = limit.floor.amplitude + needed;
    const double apart = 1 - limit.cosine * limit.cosine;
    limit.named = limit.floor.amplitude +
                  (apart > 0 ? needed / std::sqrt(apart) : std::numeric_limits<double>::infinity());
    limits.push_back(limit);
  }
  return limits;
}

}  // namespace omentum
