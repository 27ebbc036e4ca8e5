#include "core/psm.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <vector>

#include "core/constants.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kHalfPi = kPi / 2;
constexpr double kRemoteCentreLength = 0.4318;  // L_rcc [m]

/// Largest size of an element, infinite if one is not finite: maxCoeff() may pass over NaN.
double largest(const Matrix3d& M) {
  return M.allFinite() ? M.cwiseAbs().maxCoeff() : std::numeric_limits<double>::infinity();
}

double deviation_from_orthonormal(const Matrix3d& R) {
  return largest(R.transpose() * R - Matrix3d::Identity());
}

/// One row of the modified DH table: RotX(alpha) TransX(a) RotZ(theta) TransZ(d), alpha a multiple
/// of pi/2 whose sine and cosine are exact.
struct Link {
  Matrix3d R;
  Vector3d p;
};

Link make_link(double sin_alpha, double cos_alpha, double a, double theta, double d) {
  const auto [s, c] = trig::sin_cos(theta);
  Link link;
  link.R << c, -s, 0, s * cos_alpha, c * cos_alpha, -sin_alpha, s * sin_alpha, c * sin_alpha,
      cos_alpha;
  link.p = Vector3d(a, -sin_alpha * d, cos_alpha * d);
  return link;
}

void append(PsmPose& pose, const Link& link) {
  pose.p += pose.R * link.p;
  pose.R = pose.R * link.R;
}

Matrix3d tip_rotation() {
  Matrix3d off;
  off << 0, -1, 0, 0, 0, 1, -1, 0, 0;
  return off;
}

}  // namespace

double psm_wrist_distance(double insertion, const PsmInstrument& instrument) noexcept {
  return insertion - kRemoteCentreLength + instrument.tool_length;
}

PsmPose psm_forward(const PsmJoints& q, const PsmInstrument& instrument, double theta_offset) {
  PsmPose pose;
  append(pose, make_link(1, 0, 0, q[0] + theta_offset, 0));
  append(pose, make_link(-1, 0, 0, q[1] - theta_offset, 0));
  append(pose, make_link(1, 0, 0, 0, q[2] - kRemoteCentreLength));
  append(pose, make_link(0, 1, 0, q[3], instrument.tool_length));
  append(pose, make_link(-1, 0, 0, q[4] - theta_offset, 0));
  append(pose, make_link(-1, 0, instrument.pitch_to_yaw, q[5] - theta_offset, 0));
  pose.R = pose.R * tip_rotation();
  return pose;
}

InverseSolution psm_solve(const PsmPose& pose, double roll_near, const PsmInstrument& instrument,
                          double theta_offset) noexcept {
  if (!(deviation_from_orthonormal(pose.R) < 1e-6)) return {InverseFault::kNotOrthonormal, {}};
  if (!(pose.p.norm() >= 1e-3)) return {InverseFault::kNearRemoteCentre, {}};
  const Vector3d z6 = -pose.R.col(0);
  const Vector3d in_plane = pose.p - pose.p.dot(z6) * z6;
  if (!(in_plane.norm() > 1e-9)) return {InverseFault::kWristAxisThroughCentre, {}};
  const Vector3d c = pose.p - instrument.pitch_to_yaw * in_plane.normalized();

  PsmJoints q{};
  q[0] = trig::atan2(c.x(), -c.z());
  q[1] = -trig::atan2(c.y(), std::sqrt(c.x() * c.x() + c.z() * c.z()));
  q[2] = c.norm() + kRemoteCentreLength - instrument.tool_length;

  PsmPose shaft;
  append(shaft, make_link(1, 0, 0, q[0] + kHalfPi, 0));
  append(shaft, make_link(-1, 0, 0, q[1] - kHalfPi, 0));
  append(shaft, make_link(1, 0, 0, 0, 0));
  const Matrix3d M = shaft.R.transpose() * pose.R * tip_rotation().transpose();
  q[3] = trig::atan2(M(1, 2), M(0, 2));
  q[4] = trig::atan2(-M(2, 2), std::sqrt(M(0, 2) * M(0, 2) + M(1, 2) * M(1, 2)));
  q[5] = trig::atan2(M(2, 0), M(2, 1));

  const double e = theta_offset - kHalfPi;
  q[0] -= e;
  q[1] += e;
  q[4] += e;
  q[5] += e;
  q[3] += 2 * 2 * kHalfPi * std::nearbyint((roll_near - q[3]) / (4 * kHalfPi));
  return {InverseFault::kNone, q};
}

Result<PsmJoints> psm_inverse(const PsmPose& pose, double roll_near,
                              const PsmInstrument& instrument, double theta_offset) {
  const InverseSolution solution = psm_solve(pose, roll_near, instrument, theta_offset);
  switch (solution.fault) {
    case InverseFault::kNone:
      return solution.q;
    case InverseFault::kNotOrthonormal:
      return Failure{
          fmt::format("rotation is not orthonormal by {:.3g}", deviation_from_orthonormal(pose.R))};
    case InverseFault::kNearRemoteCentre:
      return Failure{fmt::format("goal is {:.3g} m from the remote centre, allowed at least 0.001",
                                 pose.p.norm())};
    case InverseFault::kWristAxisThroughCentre:
      break;
  }
  return Failure{"wrist axis passes through the remote centre"};
}

std::string psm_limit_violation(const PsmJoints& q, const PsmInstrument& instrument) {
  for (std::size_t i = 0; i < q.size(); ++i) {
    const JointRange& limit = instrument.limits[i];
    if (!(q[i] >= limit.min && q[i] <= limit.max)) {
      return fmt::format("joint {} at {:.6g}, allowed {} ... {}", limit.name, q[i], limit.min,
                         limit.max);
    }
  }
  const double distance = psm_wrist_distance(q[2], instrument);
  if (!(distance >= kPsmCannula)) {
    return fmt::format("wrist-pitch axis {:.6g} m from the remote centre, allowed at least {}",
                       distance, kPsmCannula);
  }
  return {};
}

PsmMismatch psm_mismatch(const PsmJoints& q, const PsmPose& pose,
                         const PsmInstrument& instrument) noexcept {
  const PsmPose expected = psm_forward(q, instrument);
  return {(pose.p - expected.p).norm(), largest(pose.R - expected.R)};
}

Result<void> check_instrument(const PsmJoints& q, const PsmPose& pose,
                              const PsmInstrument& instrument) {
  const PsmMismatch mismatch = psm_mismatch(q, pose, instrument);
  if (mismatch.agrees()) return {};
  if (!(mismatch.rotation <= 2e-5)) {
    return Failure{
        fmt::format("local/measured_cp is turned by {:.3g} from the pose of measured_js, allowed "
                    "2e-05: another "
                    "arm, or not of one Timestamp",
                    mismatch.rotation)};
  }
  const auto lengths = [](const PsmInstrument& of) {
    return fmt::format("{:.4f} m, pitch to yaw {:.4f} m", of.tool_length, of.pitch_to_yaw);
  };
  const std::string given =
      fmt::format("instrument {} has tool length {}", instrument.name, lengths(instrument));
  std::vector<std::string> alike;
  std::string found;
  for (const PsmInstrument& other : psm_instruments()) {
    if (!psm_mismatch(q, pose, other).agrees()) continue;
    alike.emplace_back(other.name);
    found = lengths(other);
  }
  if (!alike.empty()) {
    return Failure{fmt::format("{}; the robot computes with tool length {}: {}", given, found,
                               fmt::join(alike, " or "))};
  }
  // A longer tool moves the control point along the shaft.
  const PsmPose shaft = psm_forward({q[0], q[1], q[2], 0, 0, 0}, instrument);
  const double longer = shaft.R.col(2).dot(pose.p - psm_forward(q, instrument).p);
  return Failure{fmt::format(
      "{}; the robot computes with tool length {:.4f} m or another wrist, {:.3g} m away: no "
      "instrument known",
      given, instrument.tool_length + longer, mismatch.position)};
}

Vector3d ToolMount::jaw_direction() const { return R_WC.col(2); }

ToolMount make_tool_mount(const Eigen::Isometry3d& X_WR, double roll, double tip_offset,
                          const Vector3d& workspace_min, const Vector3d& workspace_max) {
  ToolMount mount;
  mount.X_WR = X_WR;
  mount.tip_offset = tip_offset;
  mount.workspace_min = workspace_min;
  mount.workspace_max = workspace_max;
  // At q = 0 the tip frame has x = y_R, y = x_R, z = -z_R (docs/dvrk.md 1); rolled about the shaft.
  const auto [s, c] = trig::sin_cos(roll);
  Matrix3d down;
  down << 0, 1, 0, 1, 0, 0, 0, 0, -1;
  Matrix3d turn;
  turn << c, -s, 0, s, c, 0, 0, 0, 1;
  mount.R_WC = turn * down;
  return mount;
}

Matrix3d rotation_of(const RollPitchYaw& angles) {
  const auto [sr, cr] = trig::sin_cos(angles[0]);
  const auto [sp, cp] = trig::sin_cos(angles[1]);
  const auto [sy, cy] = trig::sin_cos(angles[2]);
  Matrix3d roll, pitch, yaw;
  roll << 1, 0, 0, 0, cr, -sr, 0, sr, cr;
  pitch << cp, 0, sp, 0, 1, 0, -sp, 0, cp;
  yaw << cy, -sy, 0, sy, cy, 0, 0, 0, 1;
  return yaw * (pitch * roll);
}

ToolMount turned(const ToolMount& mount, const RollPitchYaw& angles) {
  ToolMount held = mount;
  held.R_WC = rotation_of(angles) * mount.R_WC;
  return held;
}

Result<PsmJoints> joints_for_tip(const ToolMount& mount, const Vector3d& p_WT) {
  PsmPose pose;
  const Eigen::Isometry3d X_RW = mount.X_WR.inverse();
  pose.R = X_RW.linear() * mount.R_WC;
  pose.p = X_RW * mount.control_point(p_WT);
  Result<PsmJoints> joints = psm_inverse(pose, 0, *mount.instrument);
  if (!joints) return joints;
  const std::string violation = psm_limit_violation(joints.value(), *mount.instrument);
  if (!violation.empty()) return Failure{violation};
  return joints;
}

LimitedCommand limit_command(const ToolMount& mount, const Vector3d& previous_p_WT,
                             const Vector3d& increment) {
  LimitedCommand result;
  Vector3d goal = previous_p_WT;
  for (int axis = 0; axis < 3; ++axis) {
    const double moved = previous_p_WT[axis] + increment[axis];
    if (moved >= mount.workspace_min[axis] && moved <= mount.workspace_max[axis]) {
      goal[axis] = moved;
    } else if (increment[axis] != 0) {
      ++result.axes_dropped;
    }
  }
  result.unreachable = !joints_for_tip(mount, goal).has_value();
  result.p_WT = result.unreachable ? previous_p_WT : goal;
  return result;
}

LimitedTurn limit_turn(const ToolMount& mount, const Vector3d& p_WT, const RollPitchYaw& previous,
                       const RollPitchYaw& increment, double limit) {
  LimitedTurn result{previous};
  RollPitchYaw goal = previous;
  for (int axis = 0; axis < 3; ++axis) {
    const double angle = previous[axis] + increment[axis];
    if (std::fabs(angle) <= limit) {
      goal[axis] = angle;
    } else if (increment[axis] != 0) {
      ++result.axes_dropped;
    }
  }
  const auto in_reach = [&](const RollPitchYaw& angles) {
    return joints_for_tip(turned(mount, angles), p_WT).has_value();
  };
  if (goal == previous || in_reach(goal)) {
    result.angles = goal;
    return result;
  }
  // One by one, so that a tool at the limit of a joint turns along it.
  result.unreachable = true;
  for (int axis = 0; axis < 3; ++axis) {
    RollPitchYaw alone = result.angles;
    alone[axis] = goal[axis];
    if (goal[axis] != previous[axis] && in_reach(alone)) result.angles = alone;
  }
  return result;
}

}  // namespace omentum
