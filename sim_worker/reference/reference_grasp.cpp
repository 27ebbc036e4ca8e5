// Grasp of the reference solid: its patch, and the constraint it puts on the nodes.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "core/decompositions.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {

using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

ReferenceTissue::Targets ReferenceTissue::patch_rows(const Nodes& x) const {
  Targets rows = Targets::Zero();
  const GraspPatch& patch = grasp_->patch;
  for (int k = 0; k < patch.weight.rows(); ++k) rows += x[patch.node[k]] * patch.weight.row(k);
  return rows;
}

/// Of the rows of the patch [m/N]; the compliance of the jaws acts on its mean position only.
Eigen::Vector4d ReferenceTissue::grasp_compliances() const {
  Eigen::Vector4d c = Eigen::Vector4d::Constant(model_->grasp_compliance);
  c[0] += effects_.values().grasp_compliance;
  return c;
}

/// Jaws that turn by R(theta) lead the rows of slopes to t_r = R target_r. Their spring, of energy
/// |theta|^2 / (2 C_turn), bears the moment sum_r t_r x p_r of the multipliers. With w a turn after
/// R the energy less sum_r p_r . t_r has the gradient `moment` and the inverse Hessian
/// `compliance`.
ReferenceTissue::PatchTurn ReferenceTissue::patch_turn(const Turn& turn, const Targets& targets,
                                                       const Targets& multiplier) const {
  PatchTurn result{targets};
  if (!turns()) return result;
  const double compliance = effects_.values().grasp_turn;
  result.energy = 0.5 / compliance * turn.angle.squaredNorm();
  result.moment = turn.angle / compliance;
  Eigen::Matrix3d second = turn_change(turn.angle) / compliance;
  for (int r = 1; r < GraspPatch::kRows; ++r) {
    const Vector3d t = turn.matrix * targets.col(r);
    const Vector3d p = multiplier.col(r);
    result.targets.col(r) = t;
    result.moment -= t.cross(p);
    second += t.dot(p) * Eigen::Matrix3d::Identity() - t * p.transpose();
  }
  // Far from equilibrium it may bend the other way: then a descent along each axis.
  const Eigen::Matrix3d symmetric = 0.5 * (second + second.transpose());
  const PrincipalAxes3 principal = principal_axes(symmetric);
  const Vector3d stiffness = principal.values.cwiseAbs().cwiseMax(1e-3 / compliance);
  result.compliance =
      principal.axes * stiffness.cwiseInverse().asDiagonal() * principal.axes.transpose();
  return result;
}

/// Adds how far multipliers move the targets, row by row: d t_r = sum_s [t_r]x^T C [t_s]x d p_s.
void ReferenceTissue::add_grasp_compliance(const PatchTurn& turn, Eigen::Ref<MatrixXd> rows) const {
  const Eigen::Vector4d compliances = grasp_compliances();
  for (int r = 0; r < GraspPatch::kRows; ++r) {
    rows.block<3, 3>(3 * r, 3 * r).diagonal().array() += compliances[r];
    for (int s = 1; s < GraspPatch::kRows && r > 0 && !turn.compliance.isZero(0); ++s) {
      rows.block<3, 3>(3 * r, 3 * s) += cross_matrix(turn.targets.col(r)).transpose() *
                                        turn.compliance * cross_matrix(turn.targets.col(s));
    }
  }
}

/// Force per displacement of the patch along a direction in the next step [N/m]: K = S^-1 of the
/// mean position, see prepare_constraint(). That of the sheet where there is no factor, a pad, or
/// tissue that is stable only because it is held.
double ReferenceTissue::patch_stiffness(const Vector3d& along) {
  const double sheet = model_->material.young_modulus_pa() * model_->body.thickness;
  if (has_pad() || !tangent_.usable || !carry_factor()) return sheet;
  VectorXd unit = VectorXd::Zero(3L * GraspPatch::kRows);
  unit.head<3>() = along;
  const double stiffness = unit.dot(constraint_solver_.solve(unit).col(0));
  return stiffness > 0 ? stiffness : sheet;
}

/// Slip of the patch in the jaws over a control step; may release it.
void ReferenceTissue::slip() {
  const EffectValues& fx = effects_.values();
  if (!grasp_ || !(fx.slip_speed > 0) || held_force_.isZero(0)) return;
  const Vector3d slip = slip_of(fx, held_force_, patch_stiffness(held_force_.normalized()),
                                slipped_, model_->control_period);
  slipped_ += slip.norm();
  if (fx.slip_loss > 0 && slipped_ > fx.slip_loss) {
    release(0);
  } else {
    shift_held(0, slip);
  }
}

/// Augmented Lagrangian of the constraint with the multipliers p of the trial: with r = C x -
/// targets and m = r - c p, the force C^T p and the energy p . r + m^2 / (2 (c + kMissCompliance)).
void ReferenceTissue::add_grasp(const Terms& terms, const Nodes& x, Residual& out) const {
  if (has_pad()) return add_pad(x, out);
  const PatchTurn turn = patch_turn(trial_turn_, terms.target, trial_multiplier_);
  const Targets offset = patch_rows(x) - turn.targets;
  const Eigen::Vector4d compliances = grasp_compliances();
  out.miss = offset - trial_multiplier_ * compliances.asDiagonal();
  const Eigen::Vector4d stiffness = (compliances.array() + kMissCompliance).inverse();
  out.miss_force = out.miss * stiffness.asDiagonal();
  out.count_energy(trial_multiplier_.cwiseProduct(offset).sum());
  if (turns()) {
    out.count_energy(turn.energy);
    out.moment = turn.moment;
    out.moment_force = turn.moment.norm() / turn.targets.rightCols<2>().colwise().norm().maxCoeff();
  }
  out.count_energy(0.5 * out.miss.cwiseProduct(out.miss_force).sum());
  const GraspPatch& patch = grasp_->patch;
  for (int k = 0; k < patch.weight.rows(); ++k)
    add_force(patch.node[k], trial_multiplier_ * patch.weight.row(k).transpose(), out);
}

/// Of a new factor A = L S L^T, for constrain(): Y = L^-1 C^T and the factor of c I + Y^T S Y. The
/// step A dx + C^T dp = -force, C dx - c dp = -m with y = -L^-1 force is
/// (c I + Y^T S Y) dp = Y^T S y + m, dx = L^-T S (y - Y dp).
///
/// False where a motion that the grasp allows gains energy. Held tissue under compression may be
/// stable only because it is held: A + C^T C / c is positive definite where the bordered matrix has
/// as many negative eigenvalues as rows [Gould85], which are those of A and the positive ones of
/// c I + Y^T S Y [Haynsworth68].
bool ReferenceTissue::prepare_constraint() {
  if (!grasp_) return factor_.negative() == 0;
  constrained_ = true;
  MatrixXd& Y = constraint_response_;
  if (has_pad()) {
    // Of the pose eliminated, A - C^T D^-1 C: the same with Y^T Y - D.
    const PadPose pose = pad_pose(trial_x_);
    Vector6 gradient;
    Y = pad_columns(pose, effects_.values().grasp_compliance > 0, !pad_turn_stiffness().isZero(0));
    factor_.solve_lower(Y);
    constraint_solver_.compute(Y.transpose() * Y - pad_balance(pose, trial_x_, gradient), 0);
    return factor_.negative() == 0;
  }
  Y = grasp_columns();
  factor_.solve_lower(Y);
  signed_response_ = Y;
  factor_.apply_signs(signed_response_);
  MatrixXd rows = Y.transpose() * signed_response_;
  add_grasp_compliance(patch_turn(trial_turn_, grasp_->offset, trial_multiplier_), rows);
  return constraint_solver_.compute(rows, factor_.negative());
}

/// C^T of the rows of the patch, [unknown][3 row + axis].
MatrixXd ReferenceTissue::grasp_columns() const {
  const GraspPatch& patch = grasp_->patch;
  MatrixXd Y = MatrixXd::Zero(model_->unknowns, 3L * GraspPatch::kRows);
  for (int k = 0; k < patch.weight.rows(); ++k) {
    const int row = model_->unknown[patch.node[k]];
    if (row < 0) continue;
    for (int r = 0; r < GraspPatch::kRows; ++r) {
      for (int axis = 0; axis < 3; ++axis) Y(row + axis, 3 * r + axis) += patch.weight(k, r);
    }
  }
  return Y;
}

/// y <- y - Y dp, between the forward and the backward solve; next_multiplier_ = p + dp. Jaws that
/// turn, with D their compliance and T_r = [t_r]x^T, turn by w = D (T^T dp - moment), which
/// eliminated makes it (c I + Y^T S Y + T D T^T) dp = Y^T S y + m + T D moment.
void ReferenceTissue::constrain(const Targets& miss, Eigen::Ref<VectorXd> direction) {
  if (has_pad()) {
    const VectorXd pose = constraint_solver_.solve(constraint_response_.transpose() * direction);
    direction -= constraint_response_ * pose;
    next_multiplier_ = trial_multiplier_;
    return;
  }
  VectorXd load =
      signed_response_.transpose() * direction + VectorXd::Map(miss.data(), miss.size());
  PatchTurn turn;
  if (turns()) {
    turn = patch_turn(trial_turn_, grasp_->offset, trial_multiplier_);
    MatrixXd rows = constraint_response_.transpose() * signed_response_;
    add_grasp_compliance(turn, rows);
    constraint_solver_.compute(rows, factor_.negative());
    const Vector3d by_moment = turn.compliance * turn.moment;
    for (int r = 1; r < GraspPatch::kRows; ++r)
      load.segment<3>(3L * r) += by_moment.cross(turn.targets.col(r));
  }
  const VectorXd more = constraint_solver_.solve(load);
  direction -= constraint_response_ * more;
  next_multiplier_ = trial_multiplier_ + Targets::Map(more.data());
  if (turns()) {
    const PatchTurn next = patch_turn(trial_turn_, grasp_->offset, next_multiplier_);
    turn_step_ = -turn.compliance * next.moment;
  }
}

/// Nearest point of the bilinear mid-surface, searched from the nearest particle; none on the
/// clamp.
std::optional<SheetPoint> ReferenceTissue::nearest_point(const Vector3d& tip) const {
  std::array<Nearest, 1> nearest{};
  find_nearest(std::array<Vector3d, 1>{tip}, nearest);
  const auto at = [&](const Vector2d& X) {
    const BodyPoint::Location found = model_->locate({X.x(), X.y(), 0}).locations.front();
    const std::array<double, 8> N = hex_functions(found.xi);
    Vector3d p = Vector3d::Zero();
    for (int a = 0; a < 8; ++a) p += N[a] * state_.x[model_->elements[found.element].node[a]];
    return p;
  };
  const Eigen::AlignedBox2d sheet(Vector2d(model_->lines[0].front(), model_->lines[1].front()),
                                  Vector2d(model_->lines[0].back(), model_->lines[1].back()));
  const SheetPoint found =
      nearest_on_sheet(at, sheet, model_->body.particles[nearest[0].particle].head<2>(), tip);
  if (!(found.X.y() > model_->clamp_edge) && model_->unknown.front() < 0) return std::nullopt;
  if (!(found.X.y() < model_->second_edge) && model_->unknown.back() < 0) return std::nullopt;
  return found;
}

ReferenceTissue::Grasp ReferenceTissue::make_grasp(const Vector2d& centre, double radius) const {
  Grasp grasp;
  grasp.centre = centre;
  grasp.radius = radius;
  if (model_->surroundings.grip.pad) {
    make_pad(grasp);
  } else {
    grasp.patch = model_->make_patch(centre, radius);
  }
  return grasp;
}

void ReferenceTissue::hold(int lane, const Vector3d& tip, double nominal_radius, bool collapse) {
  release(0);
  const EffectValues& fx = effects_.values();
  const double radius = nominal_radius + fx.grasp_radius;
  const auto nearest =
      nearest_point(tip + model_->body.X_WB.linear() * Vector3d(fx.grasp_x, fx.grasp_y, 0));
  if (!nearest || !(nearest->distance < radius)) return;
  const double patch_radius = std::sqrt(radius * radius - nearest->distance * nearest->distance);
  const Eigen::Matrix3d jaw = jaw_rotation(fx, model_->surroundings.shaft_axis);
  if (!(patch_radius > 1e-5)) return;  // [m]: the sphere only grazes the sheet
  grasp_ = make_grasp(nearest->X, patch_radius);
  constrained_ = false;
  if (has_pad()) {
    take_pad(jaw, tip, collapse);
  } else {
    grasp_->offset = patch_rows(state_.x);
    grasp_->offset.col(0) -= tip;
    if (fx.turns_jaw()) grasp_->offset = jaw * Targets(grasp_->offset);
    if (collapse) grasp_->offset.col(0).setZero();
  }
  if (!columns_) return;
  hold_columns(jaw, collapse);
  for_each_follower([&](ReferenceTissue& follower) {
    follower.follow(*this);
    follower.hold(lane, tip, nominal_radius, collapse);
  });
  if (has_pad()) compare_pads();
}

void ReferenceTissue::release(int) {
  grasp_.reset();
  constrained_ = false;
  slipped_ = 0;
  held_force_.setZero();
  state_.multiplier.setZero();
  state_.turn = {};
  for_each_follower([](ReferenceTissue& follower) { follower.release(0); });
}

std::span<const std::int32_t> ReferenceTissue::held(int) const {
  if (!grasp_) return {};
  return grasp_->patch.particles;
}

void ReferenceTissue::shift_held(int, const Vector3d& by) {
  if (grasp_) grasp_->offset.col(0) += by;
  for_each_follower([&](ReferenceTissue& follower) { follower.shift_held(0, by); });
}

Vector3d ReferenceTissue::held_force(int) const { return held_force_; }

}  // namespace omentum
