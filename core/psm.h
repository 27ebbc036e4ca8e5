#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <string>

#include "core/psm_instrument.h"
#include "core/result.h"

namespace omentum {

/// Kinematics of the da Vinci PSM (classic) with an instrument, the Large Needle Driver 400006
/// where none is named, in double precision and with our own sine, cosine and arc tangent: the same
/// bits on every machine. Frames: R remote centre of motion, C dVRK control point (wrist yaw axis),
/// T jaw tip. Numbers and sources: docs/dvrk.md 1 (sawIntuitiveResearchKit
/// share/kinematic/PSM.json).

/// yaw, pitch [rad], insertion [m], roll, wrist pitch, wrist yaw [rad].
using PsmJoints = std::array<double, 6>;

struct PsmPose {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();  ///< R_RC
  Eigen::Vector3d p = Eigen::Vector3d::Zero();      ///< p_RC [m]
};

/// The theta offset of the robot's files; M_PI/2 is the textbook variant (1.2 um apart).
inline constexpr double kPsmThetaOffset = 1.5708;

/// Pose of the control point, X_RC. Joints may lie outside their limits; they must be finite.
PsmPose psm_forward(const PsmJoints& q, const PsmInstrument& instrument = large_needle_driver(),
                    double theta_offset = kPsmThetaOffset);

/// Why a pose has no inverse.
enum class InverseFault { kNone, kNotOrthonormal, kNearRemoteCentre, kWristAxisThroughCentre };

struct InverseSolution {
  InverseFault fault = InverseFault::kNone;
  PsmJoints q{};  ///< where there is no fault
};

/// Closed form (docs/dvrk.md 3), branch |wrist pitch| < 90 deg; roll is unwrapped towards
/// `roll_near`. Faults: a pose nearer than 1 mm to the remote centre, a rotation that is not
/// orthonormal to 1e-6, also where a number is not finite. Joint limits are not judged: see
/// psm_limit_violation(). Allocates nothing.
InverseSolution psm_solve(const PsmPose& pose, double roll_near = 0,
                          const PsmInstrument& instrument = large_needle_driver(),
                          double theta_offset = kPsmThetaOffset) noexcept;

/// psm_solve() with the fault as one line.
Result<PsmJoints> psm_inverse(const PsmPose& pose, double roll_near = 0,
                              const PsmInstrument& instrument = large_needle_driver(),
                              double theta_offset = kPsmThetaOffset);

/// Distance of the wrist-pitch axis from the remote centre below which the robot refuses to go [m].
inline constexpr double kPsmCannula = 0.045;

/// Distance of the wrist-pitch axis from the remote centre at an insertion [m].
double psm_wrist_distance(double insertion, const PsmInstrument& instrument) noexcept;

/// Empty when the joints are inside their limits and the wrist-pitch axis is at least kPsmCannula
/// from the remote centre; else which rule is broken and by how much.
std::string psm_limit_violation(const PsmJoints& q,
                                const PsmInstrument& instrument = large_needle_driver());

/// How far a pose that the robot reports (local/measured_cp) is from that of its joints
/// (measured_js of the same Timestamp) with this instrument.
struct PsmMismatch {
  double position = 0;  ///< [m]
  double rotation = 0;  ///< largest difference of an element

  /// Within 2 um and 2e-5, what the two theta offsets differ by (docs/dvrk.md 1.1).
  bool agrees() const { return position <= 2e-6 && rotation <= 2e-5; }
};
PsmMismatch psm_mismatch(const PsmJoints& q, const PsmPose& pose,
                         const PsmInstrument& instrument) noexcept;

/// The robot computes its pose with this instrument, or one that moves alike; else one line with
/// the tool length of `instrument` and the one the pose speaks for, and the instruments of that
/// length.
Result<void> check_instrument(const PsmJoints& q, const PsmPose& pose,
                              const PsmInstrument& instrument);

/// Where the arm stands and how the tool is held: constant orientation, as the paper does (P
/// III-A); turned() is the mount of a tool that is held otherwise.
struct ToolMount {
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  /// Orientation of the control point frame.
  Eigen::Matrix3d R_WC = Eigen::Matrix3d::Identity();
  double tip_offset = 0.0102;                               ///< |p_CT| along the jaw [m]
  Eigen::Vector3d workspace_min = Eigen::Vector3d::Zero();  ///< box for the tip in W [m]
  Eigen::Vector3d workspace_max = Eigen::Vector3d::Zero();
  const PsmInstrument* instrument = &large_needle_driver();  ///< must outlive the mount; never null

  /// Direction of the jaw in W: from C to T.
  Eigen::Vector3d jaw_direction() const;
  Eigen::Vector3d control_point(const Eigen::Vector3d& p_WT) const {
    return p_WT - tip_offset * jaw_direction();
  }
  Eigen::Vector3d tip(const Eigen::Vector3d& p_WC) const {
    return p_WC + tip_offset * jaw_direction();
  }
};

/// Tool pointing straight down -z_W, rolled about it [rad].
ToolMount make_tool_mount(const Eigen::Isometry3d& X_WR, double roll, double tip_offset,
                          const Eigen::Vector3d& workspace_min,
                          const Eigen::Vector3d& workspace_max);

/// Roll, pitch and yaw of the tool [rad]: turns about x, y and z of W in this order, from how the
/// mount of the scene holds it.
using RollPitchYaw = Eigen::Vector3d;

/// Rz(yaw) Ry(pitch) Rx(roll); angles must be finite.
Eigen::Matrix3d rotation_of(const RollPitchYaw& angles);

/// The mount with the tool turned about its tip: R_WC = rotation_of(angles) mount.R_WC.
ToolMount turned(const ToolMount& mount, const RollPitchYaw& angles);

/// Joints that bring the tip to p_WT, or why not (limits and 45 mm rule included).
Result<PsmJoints> joints_for_tip(const ToolMount& mount, const Eigen::Vector3d& p_WT);

/// What limit_command did with a command.
struct LimitedCommand {
  Eigen::Vector3d p_WT = Eigen::Vector3d::Zero();  ///< the goal that is in force
  int axes_dropped = 0;      ///< axes that would have left the box and kept their value
  bool unreachable = false;  ///< no inverse inside the limits: the previous goal stays
};

/// The limits of every command (docs/task.md 3): an axis of the increment that would leave the
/// workspace box keeps its value; with a goal without an inverse inside joint limits and the 45 mm
/// rule the previous goal stays in force. `increment` is in W [m].
LimitedCommand limit_command(const ToolMount& mount, const Eigen::Vector3d& previous_p_WT,
                             const Eigen::Vector3d& increment);

/// What limit_turn did with a command.
struct LimitedTurn {
  RollPitchYaw angles = RollPitchYaw::Zero();  ///< in force
  int axes_dropped = 0;      ///< angles that would have left their range and kept their value
  bool unreachable = false;  ///< all together had no inverse inside the limits
};

/// The same of a turn about p_WT: every angle within +- `limit` [rad], each as far as in reach.
LimitedTurn limit_turn(const ToolMount& mount, const Eigen::Vector3d& p_WT,
                       const RollPitchYaw& previous, const RollPitchYaw& increment, double limit);

}  // namespace omentum
