#include "core/psm.h"

#include <cmath>

#include "core/constants.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kHalfPi = kPi / 2;
constexpr double kRemoteCentreLength = 0.4318;  // L_rcc [m]
constexpr double kToolLength = 0.4162;          // L_tool [m]
constexpr double kPitchToYaw = 0.0091;          // [m]

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

/// Distance of the wrist-pitch axis from the remote centre.
double wrist_distance(double insertion) { return insertion - kRemoteCentreLength + kToolLength; }

}  // namespace

const std::array<JointRange, 6> kPsmLimits = {{{"yaw", -1.588, 1.588},
                                               {"pitch", -0.925025, 0.925025},
                                               {"insertion", 0.0, 0.24},
                                               {"roll", -4.53786, 4.53786},
                                               {"wrist_pitch", -1.39626, 1.39626},
                                               {"wrist_yaw", -1.39626, 1.39626}}};

PsmPose psm_forward(const PsmJoints& q, double theta_offset) {
  PsmPose pose;
  append(pose, make_link(1, 0, 0, q[0] + theta_offset, 0));
  append(pose, make_link(-1, 0, 0, q[1] - theta_offset, 0));
  append(pose, make_link(1, 0, 0, 0, q[2] - kRemoteCentreLength));
  append(pose, make_link(0, 1, 0, q[3], kToolLength));
  append(pose, make_link(-1, 0, 0, q[4] - theta_offset, 0));
  append(pose, make_link(-1, 0, kPitchToYaw, q[5] - theta_offset, 0));
  pose.R = pose.R * tip_rotation();
  return pose;
}

Result<PsmJoints> psm_inverse(const PsmPose& pose, double roll_near, double theta_offset) {
  const double orthonormality =
      (pose.R.transpose() * pose.R - Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(orthonormality < 1e-6))
    return Failure{fmt::format("rotation is not orthonormal by {:.3g}", orthonormality)};
  if (!(pose.p.norm() >= 1e-3)) {
    return Failure{fmt::format("goal is {:.3g} m from the remote centre, allowed at least 0.001",
                               pose.p.norm())};
  }
  const Vector3d z6 = -pose.R.col(0);
  const Vector3d in_plane = pose.p - pose.p.dot(z6) * z6;
  if (!(in_plane.norm() > 1e-9)) return Failure{"wrist axis passes through the remote centre"};
  const Vector3d c = pose.p - kPitchToYaw * in_plane.normalized();

  PsmJoints q{};
  q[0] = trig::atan2(c.x(), -c.z());
  q[1] = -trig::atan2(c.y(), std::sqrt(c.x() * c.x() + c.z() * c.z()));
  q[2] = c.norm() + kRemoteCentreLength - kToolLength;

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
  return q;
}

std::string psm_limit_violation(const PsmJoints& q) {
  for (std::size_t i = 0; i < q.size(); ++i) {
    if (!(q[i] >= kPsmLimits[i].min && q[i] <= kPsmLimits[i].max)) {
      return fmt::format("joint {} at {:.6g}, allowed {} ... {}", kPsmLimits[i].name, q[i],
                         kPsmLimits[i].min, kPsmLimits[i].max);
    }
  }
  if (!(wrist_distance(q[2]) >= kPsmCannula)) {
    return fmt::format("wrist-pitch axis {:.6g} m from the remote centre, allowed at least {}",
                       wrist_distance(q[2]), kPsmCannula);
  }
  return {};
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

Result<PsmJoints> joints_for_tip(const ToolMount& mount, const Vector3d& p_WT) {
  PsmPose pose;
  const Eigen::Isometry3d X_RW = mount.X_WR.inverse();
  pose.R = X_RW.linear() * mount.R_WC;
  pose.p = X_RW * mount.control_point(p_WT);
  Result<PsmJoints> joints = psm_inverse(pose);
  if (!joints) return joints;
  const std::string violation = psm_limit_violation(joints.value());
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

}  // namespace omentum
