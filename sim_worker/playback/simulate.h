#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/instrument/arm.h"
#include "sim_worker/playback/columns.h"
#include "sim_worker/playback/tool_track.h"
#include "sim_worker/reference/reference_model.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// A body that is held at a place before the commands begin, and let go (pb::HeldStart).
struct HeldBody {
  Eigen::Vector2d place = Eigen::Vector2d::Zero();     ///< in B at rest [m]
  double radius = 0.005;                               ///< [m]
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< in W [m]
  double until = 0;                                    ///< on the clock of the commands [s]
};

/// How recorded commands take hold of the tissue.
struct GraspSettings {
  double patch_radius_m = 0.005;  ///< tissue within this of the tip is held
  double closed_rad = 0.2915;     ///< jaw at or below this holds: 2 atan(3 mm / 2 / 10.2 mm)
};

/// How the tissue is when the commands begin.
struct RecordingStart {
  bool from_rest = false;                              ///< else in the shape of the scene
  std::optional<HeldBody> held;                        ///< before the commands begin
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< of every free point, in W [m/s]
};

/// What a simulation of recorded commands gives, one entry per control step, the state at t = 0
/// included.
struct SimulatedRecording {
  std::vector<double> time;                   ///< [s], on the clock of the commands
  std::vector<Eigen::Vector3d> tip;           ///< true p_WT [m]
  std::vector<Eigen::Vector3d> measured_tip;  ///< p_WT by the encoders [m]
  std::vector<ArmReport> arm;                 ///< empty while the arm has no effects
  std::vector<Eigen::Vector3d> force;         ///< of the tissue on the tool, in W [N]
  /// Every node, p_W [m]; of the reference the upper face at the places of the grid, then the
  /// lower.
  std::vector<std::vector<Eigen::Vector3d>> points;
  /// Drawn surface, x y z interleaved, in W [m]; of the reference the two faces, as `points`.
  std::vector<std::vector<float>> surface;
  pb::StreamClocks clocks;  ///< added to time stamps of the streams
  int missed_grasps = 0;    ///< the jaw closed and held nothing
  double start_speed = 0;   ///< of the fastest particle at rest [m/s]; 0 where it need not rest
  std::string failure;      ///< why it ends before the commands do: time and reason; else empty
};

/// State at time t [s] for a camera that lags: surface and tip, linear between steps.
struct SeenState {
  std::vector<float> surface;
  Eigen::Vector3d tip = Eigen::Vector3d::Zero();
};
SeenState seen_at(const SimulatedRecording& recording, double t);

/// Numbers of these times [s] at which the jaw closes; without a jaw the first.
std::vector<std::size_t> closings(const ToolTrack& track, const GraspSettings& grasp,
                                  std::span<const double> times);

/// Where the jaw closes, as circles on the rest sheet: a mesh is graded there. Closings more than
/// 20 mm away from the sheet are left out, which may lie up to `above` above or below its flat
/// shape [m].
std::vector<PinchCircle> pinches_of(const ToolTrack& track, const Scene& scene,
                                    const GraspSettings& grasp, double above = 0);

/// Lets tissue come to rest before its first command, with the tool at `tip`; the speed of its
/// fastest particle then [m/s]. Others than the reference move for as long as they are faster than
/// 0.1 mm/s, up to 30 s, and until stop().
double settle(Tissue<double>& tissue, const Eigen::Vector3d& tip,
              const std::function<bool()>& stop = {});

/// Takes hold of a body and leads it to its place, 20 mm/s at most, where settle() may follow; the
/// jaws are there then. Throws Error where there is nothing to hold.
void hold_at_start(Tissue<double>& tissue, const HeldBody& held);

/// Control steps of the commands.
std::size_t count_steps(const ToolTrack& track, double period);

/// Runs the tissue of a scene under recorded tool commands: one environment, double precision, one
/// control step per control_period. What was commanded is what is done, but for the effects of the
/// arm: no workspace box, no speed cap. Ends early where the tissue fails. `columns`: of a tissue
/// of the reference. A pure function of its arguments; several at a time share nothing that
/// changes. Throws Error where the result does not fit into memory. `stop`, asked once per control
/// step, ends it early with that as its failure.
SimulatedRecording simulate_recording(const TissueModel& model, const Arm& arm,
                                      const ToolTrack& track, const GraspSettings& grasp,
                                      const RecordingStart& start = {},
                                      ColumnCarrier* columns = nullptr,
                                      const std::function<bool()>& stop = {});

}  // namespace omentum
