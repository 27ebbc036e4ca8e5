#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "mismatch/tool_track.h"
#include "sim_worker/instrument/arm.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// How recorded commands take hold of the tissue.
struct GraspSettings {
  double patch_radius_m = 0.005;  ///< tissue within this of the tip is held
  double closed_rad = 0.2915;     ///< jaw at or below this holds: 2 atan(3 mm / 2 / 10.2 mm)
};

/// What a simulation of recorded commands gives, one entry per control step, the state at t = 0
/// included.
struct SimulatedRecording {
  std::vector<double> time;                          ///< [s], on the clock of the commands
  std::vector<Eigen::Vector3d> tip;                  ///< true p_WT [m]
  std::vector<Eigen::Vector3d> measured_tip;         ///< p_WT by the encoders [m]
  std::vector<ArmReport> arm;                        ///< empty while the arm has no effects
  std::vector<Eigen::Vector3d> force;                ///< of the tissue on the tool, in W [N]
  std::vector<std::vector<Eigen::Vector3d>> points;  ///< every node, p_W [m]
  std::vector<std::vector<float>> surface;           ///< drawn surface, x y z interleaved, in W [m]
  pb::StreamClocks clocks;                           ///< added to time stamps of the streams
  int missed_grasps = 0;                             ///< the jaw closed and held nothing
};

/// State at time t [s] for a camera that lags: surface and tip, linear between steps.
struct SeenState {
  std::vector<float> surface;
  Eigen::Vector3d tip = Eigen::Vector3d::Zero();
};
SeenState seen_at(const SimulatedRecording& recording, double t);

/// Runs the tissue of a scene under recorded tool commands: one environment, double precision, one
/// control step per control_period. What was commanded is what is done, but for the effects of the
/// arm: no workspace box, no speed cap. Throws Error when a number of the state is no longer
/// finite, with the time.
SimulatedRecording simulate_recording(const TissueModel& model, const Arm& arm,
                                      const ToolTrack& track, const GraspSettings& grasp);

}  // namespace omentum
