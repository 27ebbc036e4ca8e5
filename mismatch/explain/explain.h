#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "mismatch/explain/base_fit.h"
#include "mismatch/explain/proposals.h"
#include "proto/verdict.pb.h"

namespace omentum {

/// Surfaces of a recording for others to compute with, in the frame of its clouds: the upper face
/// at the places of the grid, of every frame that was looked at.
struct PredictedRecording {
  std::string name;
  std::vector<double> times;                              ///< [s]
  std::vector<std::vector<Eigen::Vector3d>> base, model;  ///< [frame][place] [m]
  std::vector<std::vector<Eigen::Vector3d>> seen;         ///< points of the cloud [m]
  std::vector<Eigen::Vector3d> tips;                      ///< p_WT, as simulated [m]
};

/// What was found, and what belongs to it.
struct Explanation {
  pb::Verdict verdict;
  pb::Scene scene;                    ///< repaired: base refitted, and what was named switched on
  pb::Scene base_scene;               ///< the same without what was named
  std::vector<Eigen::Vector2d> uv_B;  ///< places of the grid, x_B, y_B at rest [m]
  std::vector<PredictedRecording> predictions;
  std::vector<Eigen::Vector3i> triangles;  ///< of the upper face
  ResidualMap residuals;                   ///< of the base
};

/// From recordings to a verdict (docs/mismatch.md 5): refits the believed scene, asks for every
/// effect by score tests and by what recordings that were left out say, puts what is claimed into
/// the base and asks again, and shows the fit on recordings that were held out. Says that nothing
/// was found, with what could have been, where that is so. The same bytes on any number of threads.
/// Throws Error where nothing can be fitted.
Explanation explain(const pb::Scene& scene, std::vector<Observation> observations,
                    const ExplainOptions& options);

/// The page for people.
std::string make_verdict_page(const Explanation& explanation, const std::string& folder);
/// The sentence on top of it.
std::string verdict_sentence(const pb::Verdict& verdict);

}  // namespace omentum
