#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "mismatch/fit/unknowns.h"
#include "mismatch/seen/observation.h"
#include "mismatch/simulate/simulator.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {

/// Columns of a prediction beside those of the shared unknowns, in this order.
enum OwnColumn { kPinchX, kPinchY, kOwnColumns };
/// And those of the place where the body was held at the start, if it was.
inline constexpr int kHeldColumns = 3;

/// The surface at a control step near a frame.
struct TrajectoryPoint {
  double later = 0;  ///< than the frame [s]
  std::shared_ptr<const std::vector<Eigen::Vector3d>> vertices;
};

/// What the simulation says of one frame. Vertices are those of close_sheet(): the upper face at
/// the places of the grid, then the lower.
struct PredictedFrame {
  bool valid = false;                     ///< the tissue got there
  std::vector<Eigen::Vector3d> vertices;  ///< p_W [m]
  std::vector<Eigen::Vector3d> velocity;  ///< [m/s]
  /// The surface before and after it, ascending; empty: straight on, at that velocity.
  std::vector<TrajectoryPoint> trajectory;
  /// Added to every surface of `trajectory`: a finer mesh's correction of `vertices` [m]; empty: 0.
  std::vector<Eigen::Vector3d> correction;
  Eigen::Vector3d force = Eigen::Vector3d::Zero();  ///< of the tissue on the tool [N]
  /// [3 vertex + axis, then axis of the force][unknown, then own ones] per unit of x; empty where
  /// none were asked for.
  Eigen::MatrixXf columns;
  Eigen::Vector3d tip = Eigen::Vector3d::Zero();  ///< [m]
};

/// Places and velocities of a frame whose cloud was taken `later` than it was simulated [s], along
/// its trajectory; at its ends the surface rests.
void move_in_time(const PredictedFrame& frame, double later, std::vector<Eigen::Vector3d>& vertices,
                  std::vector<Eigen::Vector3d>& velocity);

struct Prediction {
  std::vector<PredictedFrame> frames;
  std::string failure;   ///< why it ends before the commands do; empty: it does not
  bool refused = false;  ///< the scene cannot be simulated at all, and no frame is valid
  double lift = 0;       ///< highest place of the tip above its first [m]
};

/// The jaws hold a pad, whose place in them has no column: which nodes are under it does not follow
/// (docs/tissue.md 13).
bool holds_pad(const pb::Scene& scene);

/// Of a recording that cannot be simulated: no frame is valid.
Prediction failed_prediction(const Observation& observation, const std::string& why);

/// Frames that the simulation got to.
std::ptrdiff_t count_valid(const Prediction& prediction);

/// Rms distance between the surfaces of the same recordings, simulated in two ways [m].
double surfaces_apart(const std::vector<Prediction>& a, const std::vector<Prediction>& b);

/// How the model is solved.
struct Numerics {
  pb::TissueModelKind model = pb::TISSUE_REFERENCE;
  /// Of the mesh of the reference along x, y (without the clamp) and z; 0: as the scene says.
  std::array<int, 3> elements = {0, 0, 0};
  double substeps = 1;            ///< times as many as the scene has
  double slip_speed_m_per_s = 0;  ///< friction is smooth below this or what the scene says
  double period = 1;              ///< control steps are so many times as long, with their substeps
  double newton_tolerance = 0;    ///< of the reference: this or what the scene says, the larger
};

/// The trajectory of a frame reaches so far before and after it [s].
inline constexpr double kTrajectoryReach = 0.25;

/// The simulation of a recording in a scene, whose clouds were taken `clock` before their time
/// stamps [s]; with derivatives by those `unknowns` at x that have a column, and by the pinch
/// unless it is that of a pad (then zero), of TISSUE_REFERENCE. A pure function. A scene that
/// cannot be simulated is a failure.
Prediction predict(const Observation& observation, const pb::Scene& scene,
                   const std::string& folder, const std::vector<Unknown>& unknowns,
                   const Eigen::VectorXd& x, double clock, const Numerics& numerics,
                   bool with_columns, Simulator& simulator);

/// Elements of a mesh of that tolerance, enough for every recording. All states of a fit have them:
/// where the mesh follows thickness or law, differences of states are differences of meshes. Throws
/// Error for a scene that cannot be.
std::array<int, 3> count_elements(const pb::Scene& scene, const std::string& folder,
                                  std::span<const Observation> observations, double tolerance_m);
/// Of a mesh whose cells are `ratio` times as large in plane.
std::array<int, 3> fewer_elements(const std::array<int, 3>& elements, double ratio);

/// The task behind it.
SimulationTask make_calibration_task(const Observation& observation, const pb::Scene& scene,
                                     const std::string& folder, const Numerics& numerics);

}  // namespace omentum
