#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <ctime>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "mismatch/fit/fit_data.h"

namespace omentum {

/// A number that was looked for.
struct CalibratedNumber {
  std::string name;       ///< path in the scene; of a nuisance of a recording "lift1: pinch.x"
  std::string recording;  ///< whose own it is; empty: of all
  std::string unit;
  double value = 0, low90 = 0, high90 = 0;
  double prior_value = 0, prior_low90 = 0, prior_high90 = 0;
  std::string prior_source;
  bool at_bound = false;
  bool unseen = false;  ///< the recordings say nothing of it: value and interval are the prior's
  double pull = 0;      ///< distance from the prior in its standard deviations
  /// How far what the recordings say alone is from the prior, in standard deviations of both. A
  /// weak word against a firm belief moves the value little, and may still speak clearly against
  /// it.
  double surprise = 0;
};

/// What the recordings see only together.
struct NumberGroup {
  std::string name, unit;  ///< of what is seen: "E/(rho g)", m
  double value = 0, low90 = 0, high90 = 0;
  std::vector<std::string> members;  ///< scene paths
  std::string text;                  ///< why, and what would part them
};

/// How far a recording is from its simulation.
struct FitRow {
  std::string recording;
  std::string role;  ///< fitted, left_out (its pinch point was not fitted), held_out
  double rmse_base = 0, rmse_model = 0, floor = 0;  ///< from point to surface [m]
  double mean_model = 0;                            ///< mean distance [m]
  double far = 0;    ///< share of points farther than 30 mm, which no figure counts
  double paper = 0;  ///< equation 3 of the paper per level and particle [m]; 0: not computed
};

/// A recording beside the simulation before and after, for the report.
struct ShownRecording {
  std::string name;
  std::vector<double> times;                                ///< of the frames [s]
  std::vector<std::vector<Eigen::Vector3d>> before, after;  ///< vertices as the camera has them
  std::vector<Eigen::Vector3d> tip;
  std::vector<std::vector<Eigen::Vector3d>> seen;  ///< points of the cloud, p_W [m]
  std::vector<double> rmse_before, rmse_after;     ///< of every frame [m]
};

/// A law of elasticity against the one that stands in the scene.
struct LawRow {
  std::string law;
  double behind = 0;                                       ///< how much less its log likelihood is
  std::vector<std::pair<std::string, double>> parameters;  ///< path and value, with that law
};

struct Calibration {
  std::string method;  ///< shell, reference or paper
  std::vector<CalibratedNumber> parameters, nuisances;
  std::vector<NumberGroup> groups;
  std::vector<LawRow> laws;  ///< that were fitted; the scene's with 0
  std::vector<FitRow> fit;
  double numerics_m = 0;              ///< what mesh, step and law may be off by, rms of the surface
  std::vector<std::string> numerics;  ///< its parts in words
  std::vector<std::string> warnings;
  double core_seconds = 0;
  pb::Scene scene;    ///< the calibrated one
  pb::Priors priors;  ///< of its parameters: what is known now
  std::vector<ShownRecording> shown;
  std::vector<Eigen::Vector3i> triangles;  ///< of the vertices of `shown`
  /// Markers on tissue, seen and simulated (marker_table()).
  struct MarkerTable {
    std::string recording;
    Series table;
  };
  std::vector<MarkerTable> markers;
  /// Of recordings of a pinch point that was not fitted: what the scene without it says they hold.
  struct LeftOut {
    std::string recording;
    pb::Scene scene;
  };
  std::vector<LeftOut> left_out;
};

/// Work done of all, 0 ... 1, and what is being done.
using ProgressOf = std::function<void(double share, const std::string& stage)>;

struct CalibrationOptions : FitSetup {
  std::uint64_t seed = 1;     ///< of the genetic algorithm
  double tolerance_m = 3e-4;  ///< of the mesh that the answer is from; rms error of the surface
  bool leave_out = true;      ///< every pinch point once
  ProgressOf progress;
};

/// Processor time of this process since then, and of the workers that simulate for it [s].
double core_seconds_since(std::clock_t started, const Simulator& simulator);

/// The default method for a body on a clamp (docs/calibrate.md): converged solid, its derivatives,
/// Gauss and Newton. The same result for any number of threads, but for core_seconds. Throws Error
/// where nothing can be fitted.
Calibration calibrate_reference(const pb::Scene& scene, std::vector<Observation> observations,
                                const CalibrationOptions& options);

/// The same of a shell, whose derivatives are differences: of bodies that lie free. Every number of
/// the scene that a prior names is looked for.
Calibration calibrate_shell(const pb::Scene& scene, std::vector<Observation> observations,
                            const CalibrationOptions& options);

/// The paper's: genetic algorithm on three numbers of the clusters, equation 3 (docs/calibrate.md).
Calibration calibrate_paper(const pb::Scene& scene, std::vector<Observation> observations,
                            const CalibrationOptions& options);

}  // namespace omentum
