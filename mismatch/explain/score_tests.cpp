#include "mismatch/explain/score_tests.h"

#include <cmath>
#include <limits>
#include <set>

namespace omentum {

using Eigen::Index;
using Eigen::MatrixXd;

namespace {

/// `recordings` with one numerics column as an atom that they share: what it does to others is then
/// what is left of it beside everything else.
std::vector<Evidence> with_as_atom(std::span<const Evidence> recordings, const std::string& key) {
  std::vector<Evidence> changed(recordings.begin(), recordings.end());
  for (Evidence& recording : changed) {
    for (Number& number : recording.numbers) {
      if (number.key != key) continue;
      number.role = NumberRole::kAtom;
      number.owner.clear();
    }
  }
  return changed;
}

/// Keys of numerics columns and how far floors move them, largest where recordings differ.
std::map<std::string, double> numerics_of(std::span<const Evidence> recordings) {
  std::map<std::string, double> numerics;
  for (const Evidence& recording : recordings) {
    for (const Number& number : recording.numbers) {
      if (number.role != NumberRole::kNumerics) continue;
      const double step = number.floor_step > 0 ? number.floor_step : number.sd;
      double& known = numerics[number.key];
      known = std::max(known, step);
    }
  }
  return numerics;
}

}  // namespace

Result<std::vector<ScoreTest>> score_tests(const FoldEvidence& evidence) {
  auto projected = project_atoms(evidence);
  if (!projected) return Failure{projected.error()};
  std::vector<ScoreTest> tests;
  for (int k = 0; k < evidence.atoms(); ++k) {
    ScoreTest test;
    test.atom = evidence.atom(k).key;
    const double information = projected.value().information(k, k);
    const double score = projected.value().score[k];
    test.testable = information > 0;
    test.sd = test.testable ? 1 / std::sqrt(information) : std::numeric_limits<double>::infinity();
    if (test.testable) {
      test.z = score / std::sqrt(information);
      test.amplitude = score / information;
    }
    tests.push_back(test);
  }
  return tests;
}

Result<MatrixXd> cosines(const FoldEvidence& evidence) {
  auto projected = project_atoms(evidence);
  if (!projected) return Failure{projected.error()};
  MatrixXd cosine = projected.value().information;
  const Eigen::VectorXd length = cosine.diagonal().cwiseSqrt();
  for (Index i = 0; i < cosine.rows(); ++i) {
    for (Index j = 0; j < cosine.cols(); ++j) {
      const double scale = length[i] * length[j];
      cosine(i, j) = scale > 0 ? cosine(i, j) / scale : 0;
    }
  }
  return cosine;
}

Result<Floors> amplitude_floors(std::span<const Evidence> recordings, double factor) {
  Floors floors;
  for (const Evidence& recording : recordings) {
    for (const Number& number : recording.numbers) {
      if (number.role == NumberRole::kAtom) floors[number.key];
    }
  }
  for (const auto& [numerics, step] : numerics_of(recordings)) {
    if (std::isinf(step)) return Failure{numerics + " is free: nothing says how far it may be off"};
    auto folds = make_folds(with_as_atom(recordings, numerics));
    if (!folds) return Failure{folds.error()};
    const FoldEvidence& evidence = folds.value();
    auto projected = project_atoms(evidence);
    if (!projected) return Failure{projected.error()};
    const MatrixXd& S = projected.value().information;
    int moved = 0;
    while (evidence.atom(moved).key != numerics) ++moved;
    for (int k = 0; k < evidence.atoms(); ++k) {
      if (k == moved || !(S(k, k) > 0)) continue;
      Floor& floor = floors[evidence.atom(k).key];
      const double amplitude = factor * std::fabs(S(k, moved) / S(k, k)) * step;
      if (amplitude > floor.amplitude) floor = {amplitude, numerics};
    }
  }
  return floors;
}

}  // namespace omentum
