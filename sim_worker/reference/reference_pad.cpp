// The jaws as a pad on both faces of the reference solid (scene.tool.grip, docs/tissue.md 13).
//
// Every node under the pad hangs on a spring k_i of the bed from its place a_i of a rigid body,
// which gives way by u and turns by the rotation vector theta against springs of its own:
//
//   E = sum k_i / 2 |s_i|^2 + |u|^2 / (2 C) + theta . K theta / 2,   s_i = x_i - centre - u - a_i
//
// u and theta are eliminated exactly: E(x) is the minimum over them. Its gradient is k_i s_i and
// its second derivative k_i I - C^T D^-1 C (prepare_constraint), D that of E by the pose.
#include <Eigen/Cholesky>
#include <cmath>

#include "sim_worker/reference/reference_tissue.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;

// A rigid pad has a bed as well [N/m^3]: 1 N on a square millimetre gives way 1 um.
constexpr double kRigidBed = 1e12;

}  // namespace

void ReferenceTissue::make_pad(Grasp& grasp) const {
  GraspPad pad = model_->make_pad(grasp.centre, grasp.radius);
  const double bed = model_->surroundings.grip.stiffness;
  grasp.in_pad.assign(model_->nodes.size(), 0);
  for (std::size_t k = 0; k < pad.area.size(); ++k) {
    for (const int node : {pad.lower[k], pad.upper[k]}) {
      grasp.pad_node.push_back(node);
      grasp.pad_stiffness.push_back((bed > 0 ? bed : kRigidBed) * pad.area[k]);
      grasp.in_pad[node] = 1;
    }
  }
  grasp.arm.assign(grasp.pad_node.size(), Vector3d::Zero());
  grasp.patch.particles = std::move(pad.particles);
}

void ReferenceTissue::take_pad(const Matrix3d& jaw, const Vector3d& tip, bool collapse) {
  Vector3d centre = Vector3d::Zero();
  double sum = 0;
  for (std::size_t k = 0; k < grasp_->arm.size(); ++k) {
    centre += grasp_->pad_stiffness[k] * state_.x[grasp_->pad_node[k]];
    sum += grasp_->pad_stiffness[k];
  }
  centre /= sum;
  for (std::size_t k = 0; k < grasp_->arm.size(); ++k)
    grasp_->arm[k] = jaw * (state_.x[grasp_->pad_node[k]] - centre);
  grasp_->offset.setZero();
  if (!collapse) grasp_->offset.col(0) = jaw * (centre - tip);
}

/// K [N m/rad]; zero where the pad does not turn. From its size: springs that give way by C as a
/// whole, spread over the middle between the faces.
Matrix3d ReferenceTissue::pad_turn_stiffness() const {
  const double stated = effects_.values().grasp_turn;
  const double turn = stated > 0 ? stated : model_->surroundings.grip.turn_compliance;
  if (turn > 0) return Matrix3d::Identity() / turn;
  const double compliance = effects_.values().grasp_compliance;
  if (!(compliance > 0)) return Matrix3d::Zero();
  Matrix3d gyration = Matrix3d::Zero();
  double sum = 0;
  for (std::size_t k = 0; k < grasp_->arm.size(); k += 2) {
    const Vector3d a = 0.5 * (grasp_->arm[k] + grasp_->arm[k + 1]);
    gyration +=
        grasp_->pad_stiffness[k] * (a.squaredNorm() * Matrix3d::Identity() - a * a.transpose());
    sum += grasp_->pad_stiffness[k];
  }
  return gyration / (sum * compliance);
}

/// Second derivative of the springs' part of E by u and by a turn after theta, and the first.
ReferenceTissue::Matrix6 ReferenceTissue::pad_springs(const PadPose& pose, const Nodes& x,
                                                      Vector6& gradient) const {
  gradient.setZero();
  Matrix6 D = Matrix6::Zero();
  for (std::size_t i = 0; i < grasp_->arm.size(); ++i) {
    const double k = grasp_->pad_stiffness[i];
    const Vector3d a = pose.turn * grasp_->arm[i];
    const Vector3d s = x[grasp_->pad_node[i]] - pad_centre_ - pose.shift - a;
    gradient.head<3>() -= k * s;
    gradient.tail<3>() -= k * a.cross(s);
    D.topLeftCorner<3, 3>().diagonal().array() += k;
    D.topRightCorner<3, 3>() -= k * cross_matrix(a);
    D.bottomRightCorner<3, 3>() += k * ((a + s).dot(a) * Matrix3d::Identity() - a * a.transpose() -
                                        0.5 * (s * a.transpose() + a * s.transpose()));
  }
  D.bottomLeftCorner<3, 3>() = D.topRightCorner<3, 3>().transpose();
  return D;
}

/// The same of E.
ReferenceTissue::Matrix6 ReferenceTissue::pad_balance(const PadPose& pose, const Nodes& x,
                                                      Vector6& gradient) const {
  Matrix6 D = pad_springs(pose, x, gradient);
  const auto fix = [&](int first) {
    gradient.segment<3>(first).setZero();
    D.middleRows<3>(first).setZero();
    D.middleCols<3>(first).setZero();
    D.block<3, 3>(first, first).setIdentity();
  };
  const double compliance = effects_.values().grasp_compliance;
  if (compliance > 0) {
    gradient.head<3>() += pose.shift / compliance;
    D.topLeftCorner<3, 3>().diagonal().array() += 1 / compliance;
  } else {
    fix(0);
  }
  const Matrix3d K = pad_turn_stiffness();
  if (K.isZero(0)) {
    fix(3);
  } else {
    gradient.tail<3>() += turn_change(pose.angle).transpose() * K * pose.angle;
    D.bottomRightCorner<3, 3>() += K;
  }
  return D;
}

ReferenceTissue::PadPose ReferenceTissue::pad_pose(const Nodes& x) const {
  constexpr double kSettled = 1e-15;  // [m], [rad]
  constexpr int kMost = 30;
  PadPose pose;
  Turn turn;
  for (int iteration = 0; iteration < kMost; ++iteration) {
    Vector6 gradient;
    const Matrix6 D = pad_balance(pose, x, gradient);
    const Vector6 step = -D.ldlt().solve(gradient);
    pose.shift += step.head<3>();
    turn.add(step.tail<3>());
    pose.turn = turn.matrix;
    pose.angle = turn.angle;
    if (!(step.cwiseAbs().maxCoeff() > kSettled)) break;
  }
  return pose;
}

void ReferenceTissue::add_pad(const Nodes& x, Residual& out) const {
  const PadPose pose = led_pose_ ? *led_pose_ : pad_pose(x);
  for (std::size_t i = 0; i < grasp_->arm.size(); ++i) {
    const int node = grasp_->pad_node[i];
    const double k = grasp_->pad_stiffness[i];
    const Vector3d s = x[node] - pad_centre_ - pose.shift - pose.turn * grasp_->arm[i];
    out.count_energy(0.5 * k * s.squaredNorm());
    add_force(node, k * s, out);
  }
  const double compliance = effects_.values().grasp_compliance;
  if (compliance > 0) out.count_energy(0.5 / compliance * pose.shift.squaredNorm());
  out.count_energy(0.5 * pose.angle.dot(pad_turn_stiffness() * pose.angle));
  out.miss.setZero();
  out.miss_force.setZero();
  if (led_pose_) out.miss.leftCols<2>() = pad_miss(pose, x);
}

/// Derivative of the forces on the nodes by the pose, [unknown][u, turn]: what it may do of it.
MatrixXd ReferenceTissue::pad_columns(const PadPose& pose, bool shifts, bool turns) const {
  MatrixXd Y = MatrixXd::Zero(model_->unknowns, 6);
  for (std::size_t i = 0; i < grasp_->arm.size(); ++i) {
    const int row = model_->unknown[grasp_->pad_node[i]];
    const double k = grasp_->pad_stiffness[i];
    if (row < 0) continue;
    if (shifts) Y.block<3, 3>(row, 0) = -k * Matrix3d::Identity();
    if (turns) Y.block<3, 3>(row, 3) = k * cross_matrix(pose.turn * grasp_->arm[i]);
  }
  return Y;
}

/// Force of the tissue on a pad of this pose and its moment about `tip` [N], [N m].
Eigen::Matrix<double, 3, 2> ReferenceTissue::pad_wrench(const PadPose& pose, const Nodes& x,
                                                        const Vector3d& tip) const {
  Vector3d force = Vector3d::Zero();
  Vector3d moment = Vector3d::Zero();
  for (std::size_t i = 0; i < grasp_->arm.size(); ++i) {
    const Vector3d place = pad_centre_ + pose.shift + pose.turn * grasp_->arm[i];
    const Vector3d f = grasp_->pad_stiffness[i] * (x[grasp_->pad_node[i]] - place);
    force += f;
    moment += (place - tip).cross(f);
  }
  Eigen::Matrix<double, 3, 2> wrench;
  wrench << force, moment;
  return wrench;
}

/// In the place of the multipliers.
void ReferenceTissue::remember_pad(const Terms& terms) {
  state_.multiplier.setZero();
  state_.multiplier.leftCols<2>() = pad_wrench(pad_pose(state_.x), state_.x, terms.tip);
}

Vector3d ReferenceTissue::held_moment() const {
  if (!grasp_) return Vector3d::Zero();
  if (has_pad()) return state_.multiplier.col(1);
  const Targets targets = patch_turn(state_.turn, grasp_->offset, state_.multiplier).targets;
  Vector3d moment = Vector3d::Zero();
  for (int row = 0; row < GraspPatch::kRows; ++row)
    moment += targets.col(row).cross(state_.multiplier.col(row));
  return moment;
}

}  // namespace omentum
