// Derivatives where the jaws are a pad (reference_pad.cpp, reference_columns.h).
//
// The pose is an unknown beside the nodes. With G the gradient of the springs by the pose it solves
//
//   u + C G_u = 0,   theta + P J^-T G_theta = 0
//
// J the change of the rotation vector by a turn after it (turn_change), C and P the compliances: 0
// where the pad is rigid, so that derivatives by them exist there too. Followers leave the pose to
// the base and tell what they miss of these rows. With A the tangent of the nodes at a given pose,
// Y the derivative of their forces by it, D that of G and S = diag(C, P J^-T), a column is
//
//   A s + Y p = b,   S Y^T s + (diag(1, J + P d(J^-T G)) + S D) p = c
//
// The nodes under the pad, and what each bears of it, stay: a column knows nothing of a rim that
// passes a node.
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "sim_worker/reference/reference_tissue.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Matrix3Xd;
using Eigen::MatrixXd;
using Eigen::Vector3d;

// Turn by a moment that means there is nothing in its way [rad/(N m)].
constexpr double kFree = 1e9;

/// J^-T, which turns a gradient by the turn into one by the rotation vector.
Matrix3d by_angle(const Vector3d& angle) { return turn_change(angle).transpose().inverse(); }

}  // namespace

void check_column(const ReferenceTissueModel& model, const ColumnParameter& parameter) {
  if (parameter.kind != ColumnKind::kScene || !model.surroundings.grip.pad) return;
  const EffectValues& base = model.effects;
  const EffectValues& changed = parameter.changed->effects;
  if (base.grasp_x != changed.grasp_x || base.grasp_y != changed.grasp_y ||
      base.grasp_radius != changed.grasp_radius) {
    throw_error(
        "place and size of a pad are those of nodes of the mesh, allowed: scene.tool.grip.hold "
        "HOLD_MEAN");
  }
  const bool turns = base.grasp_compliance > 0 || model.surroundings.grip.turn_compliance > 0;
  if (base.grasp_turn == 0 && changed.grasp_turn > 0 && turns) {
    throw_error(
        "the pad turns already, by scene.tool.grip or by its size; allowed with "
        "scene.tissue.effects.grasp_turn_rad_per_n_m above 0");
  }
}

/// P [rad/(N m)], smooth where the pad is rigid.
Matrix3d ReferenceTissue::pad_turn_compliance() const {
  const double stated = effects_.values().grasp_turn;
  const double turn = stated > 0 ? stated : model_->surroundings.grip.turn_compliance;
  if (turn > 0 || !(effects_.values().grasp_compliance > 0)) return turn * Matrix3d::Identity();
  return pad_turn_stiffness().inverse();
}

/// What a pose misses of its two rows [m], [rad].
Eigen::Matrix<double, 3, 2> ReferenceTissue::pad_miss(const PadPose& pose, const Nodes& x) const {
  Vector6 G;
  pad_springs(pose, x, G);
  Eigen::Matrix<double, 3, 2> miss;
  miss.col(0) = pose.shift + effects_.values().grasp_compliance * G.head<3>();
  miss.col(1) = pose.angle + pad_turn_compliance() * by_angle(pose.angle) * G.tail<3>();
  return miss;
}

/// As take_pad().
void ReferenceTissue::hold_pad_columns(const Matrix3d& jaw, bool collapse) {
  ReferenceColumns& c = *columns_;
  const std::vector<int>& nodes = grasp_->pad_node;
  const auto rows = [](std::size_t i) { return 3 * static_cast<Eigen::Index>(i); };
  MatrixXd centre = MatrixXd::Zero(3, c.count());
  double sum = 0;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    centre += grasp_->pad_stiffness[i] * node_columns(nodes[i]);
    sum += grasp_->pad_stiffness[i];
  }
  centre /= sum;
  c.arm.resize(rows(nodes.size()), c.count());
  for (std::size_t i = 0; i < nodes.size(); ++i)
    c.arm.middleRows<3>(rows(i)) = jaw * (node_columns(nodes[i]) - centre);
  c.offset.setZero();
  if (!collapse) c.offset.topRows<3>() = jaw * (centre - c.tip_from);
  c.multiplier.setZero();
}

/// A changed scene whose pad takes other nodes has no derivative, nor has a pad of one row of
/// nodes, which turns freely.
void ReferenceTissue::compare_pads() {
  ReferenceColumns& c = *columns_;
  const Matrix3d turn = pad_turn_compliance();
  if (!(turn.cwiseAbs().maxCoeff() < kFree)) {
    c.valid = false;
    c.reason = "a pad that holds one row of nodes turns freely";
  }
  for (const auto& follower : c.changed) {
    if (!follower || (follower->has_pad() && follower->grasp_->pad_node == grasp_->pad_node))
      continue;
    c.valid = false;
    c.reason = "a changed scene's pad holds other nodes";
  }
}

/// Border of the factor: L^-1 Y, S and the solver of the pose.
void ReferenceTissue::prepare_pad_columns() {
  constexpr double kStep = 1e-6;  // [rad] of a difference
  ReferenceColumns& c = *columns_;
  const PadPose pose = pad_pose(trial_x_);
  Vector6 G;
  Matrix6 D = pad_springs(pose, trial_x_, G);
  // That is symmetric; the gradient by a turn after one that changes is not.
  D.bottomRightCorner<3, 3>() -= 0.5 * cross_matrix(G.tail<3>());
  c.border = pad_columns(pose, true, true);
  c.factor.solve_lower(c.border);
  c.signed_border = c.border;
  c.factor.apply_signs(c.signed_border);
  D -= c.border.transpose() * c.signed_border;

  const Matrix3d P = pad_turn_compliance();
  const Matrix3d J = turn_change(pose.angle);
  c.softness.setZero();
  c.softness.topLeftCorner<3, 3>().diagonal().setConstant(effects_.values().grasp_compliance);
  c.softness.bottomRightCorner<3, 3>() = P * by_angle(pose.angle);
  MatrixXd S = c.softness * D;
  S.topLeftCorner<3, 3>() += Matrix3d::Identity();
  Matrix3d change;  // of J^-T G by the angle
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3d d = kStep * Vector3d::Unit(axis);
    change.col(axis) =
        (by_angle(pose.angle + d) - by_angle(pose.angle - d)) * G.tail<3>() / (2 * kStep);
  }
  S.bottomRightCorner<3, 3>() += J + P * change * J;
  c.border_solver.compute(S);
}

/// How a parameter moves the places that a pad of this pose leads its nodes to.
Matrix3Xd ReferenceTissue::pad_place_columns(const Terms& terms, Eigen::Index k) const {
  const ReferenceColumns& c = *columns_;
  Vector3d centre = c.offset.col(k).head<3>();
  if (c.parameters[k].kind == ColumnKind::kToolPath)
    centre += c.tip_from.col(k) + terms.end * (c.tip_to - c.tip_from).col(k);
  const Matrix3d turn = pad_pose(trial_x_).turn;
  const Eigen::VectorXd arm = c.arm.col(k);
  Matrix3Xd place = turn * Matrix3Xd::Map(arm.data(), 3, arm.size() / 3);
  place.colwise() += centre;
  return place;
}

/// Adds -dR/dtheta of what the grasp remembers: the tip's way, and the shape the tissue was taken
/// in.
void ReferenceTissue::pad_column_loads(const Terms& terms, RightSides& nodes,
                                       MatrixXd& grasp) const {
  const ReferenceColumns& c = *columns_;
  const PadPose pose = pad_pose(trial_x_);
  Vector6 G;
  pad_springs(pose, trial_x_, G);
  const Matrix3d to_angle = by_angle(pose.angle);
  const Matrix3d P = pad_turn_compliance();
  const double compliance = effects_.values().grasp_compliance;
  const bool by_size = compliance > 0 && !(effects_.values().grasp_turn > 0) &&
                       !(model_->surroundings.grip.turn_compliance > 0);
  const Eigen::Map<const Eigen::VectorXd> k_i(
      grasp_->pad_stiffness.data(), static_cast<Eigen::Index>(grasp_->pad_stiffness.size()));
  for (Eigen::Index k = 0; k < c.count(); ++k) {
    const Matrix3Xd place = pad_place_columns(terms, k);
    Vector6 dG = Vector6::Zero();
    Matrix3d gyration = Matrix3d::Zero();
    for (std::size_t i = 0; i < grasp_->arm.size(); ++i) {
      const auto column = static_cast<Eigen::Index>(i);
      const Vector3d t = place.col(column);
      const Vector3d a = pose.turn * grasp_->arm[i];
      const Vector3d s = trial_x_[grasp_->pad_node[i]] - pad_centre_ - pose.shift - a;
      const Vector3d arm = c.arm.col(k).segment<3>(3 * column);
      nodes.col(k).segment<3>(model_->unknown[grasp_->pad_node[i]]) += k_i[column] * t;
      dG.head<3>() += k_i[column] * t;
      dG.tail<3>() += k_i[column] * (a.cross(t) - Vector3d(pose.turn * arm).cross(s));
      if (!by_size || i % 2 != 0) continue;
      const Vector3d middle = 0.5 * (grasp_->arm[i] + grasp_->arm[i + 1]);
      const Vector3d moved = 0.5 * (arm + c.arm.col(k).segment<3>(3 * column + 3));
      gyration += k_i[column] * (2 * middle.dot(moved) * Matrix3d::Identity() -
                                 middle * moved.transpose() - moved * middle.transpose());
    }
    grasp.col(k).head<3>() -= compliance * dG.head<3>();
    grasp.col(k).segment<3>(3) -= P * to_angle * dG.tail<3>();
    if (by_size) {
      const Matrix3d stiffness = gyration / (0.5 * k_i.sum() * compliance);
      grasp.col(k).segment<3>(3) += P * stiffness * P * to_angle * G.tail<3>();
    }
  }
}

/// Force and moment on the pad from its pose, both of a column.
void ReferenceTissue::finish_pad_columns(const Terms& terms) {
  ReferenceColumns& c = *columns_;
  const PadPose pose = pad_pose(trial_x_);
  const auto same = c.same->pad_wrench(pose, trial_x_, terms.tip);
  for (Eigen::Index k = 0; k < c.count(); ++k) {
    const Vector3d shift = c.multiplier.col(k).head<3>();
    const Vector3d turn = c.multiplier.col(k).segment<3>(3);
    Vector3d tip = Vector3d::Zero();
    if (c.parameters[k].kind == ColumnKind::kToolPath)
      tip = c.tip_from.col(k) + terms.end * (c.tip_to - c.tip_from).col(k);
    const Matrix3Xd led = pad_place_columns(terms, k);
    Vector3d force = Vector3d::Zero();
    Vector3d moment = Vector3d::Zero();
    for (std::size_t i = 0; i < grasp_->arm.size(); ++i) {
      const int node = grasp_->pad_node[i];
      const double stiffness = grasp_->pad_stiffness[i];
      const Vector3d a = pose.turn * grasp_->arm[i];
      const Vector3d place = pad_centre_ + pose.shift + a;
      const Vector3d moved = led.col(static_cast<Eigen::Index>(i)) + shift + turn.cross(a);
      const Vector3d f = stiffness * (trial_x_[node] - place);
      const Vector3d df = stiffness * (c.x.col(k).segment<3>(model_->unknown[node]) - moved);
      force += df;
      moment += (place - terms.tip).cross(df) + (moved - tip).cross(f);
    }
    Eigen::Matrix<double, 3, 2> wrench;
    wrench << force, moment;
    if (c.changed[k]) {
      wrench += (c.changed[k]->pad_wrench(pose, trial_x_, terms.tip) - same) / c.parameters[k].step;
    }
    c.multiplier.col(k).setZero();
    c.multiplier.col(k).head<6>() = wrench.reshaped();
  }
}

}  // namespace omentum
