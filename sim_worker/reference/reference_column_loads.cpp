// What the parameters of the columns do at the states of the base (reference_columns.h): residuals
// of tissues that follow it, and sites.
#include <algorithm>

#include "sim_worker/reference/reference_tissue.h"

namespace omentum {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using Values = std::array<double, Pack::kLanes>;

void ReferenceTissue::for_each_follower(const std::function<void(ReferenceTissue&)>& fn) {
  if (!columns_) return;
  fn(*columns_->same);
  for (const auto& follower : columns_->pinched_aside) fn(*follower);
  for (const auto& follower : columns_->changed) {
    if (follower) fn(*follower);
  }
}

/// To where the base is; clamped nodes stay where this tissue's mesh has them.
void ReferenceTissue::follow(const ReferenceTissue& base) {
  const State& from = base.state_;
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    if (model_->unknown[i] < 0) continue;
    state_.x[i] = from.x[i];
    state_.v[i] = from.v[i];
    state_.x_before[i] = from.x_before[i];
    state_.v_before[i] = from.v_before[i];
  }
  state_.step_before = from.step_before;
  state_.mode = from.mode;
  state_.multiplier = from.multiplier;
  state_.turn = from.turn;
  held_force_ = base.held_force_;
}

/// Residual at the converged trial of the base with this tissue's own parameters, memory and grasp;
/// the forces of the elements are taken from `elements` where that is given.
void ReferenceTissue::evaluate_along(const ReferenceTissue& base, Terms terms,
                                     const Residual* elements, Residual& out) {
  follow(base);
  trial_x_ = state_.x;
  for (std::size_t i = 0; i < trial_x_.size(); ++i) {
    if (model_->unknown[i] >= 0) trial_x_[i] = base.trial_x_[i];
  }
  trial_mode_ = base.trial_mode_;
  trial_multiplier_ = base.trial_multiplier_;
  led_pose_.reset();
  if (has_pad()) {
    pad_centre_ = grasp_->offset.col(0) + terms.tip;
    led_pose_ = base.pad_pose(base.trial_x_);
  } else if (grasp_) {
    terms.target = grasp_->offset;
    terms.target.col(0) += terms.tip;
    trial_turn_ = base.trial_turn_;
    const PatchTurn turn = patch_turn(trial_turn_, terms.target, trial_multiplier_);
    if (turns()) trial_turn_.add(-turn.compliance * turn.moment);  // where it now leads the jaws
  }
  terms.slip_speed = base.friction_smoothing_ * model_->numerics.friction_slip_speed_m_per_s();
  effects_.begin(terms.h, state_.x, state_.v, terms.x_tilde, terms.beta);
  follow_friction(terms, base);
  out.miss.setZero();
  if (elements != nullptr) {
    out.elements = elements->elements;
  } else {
    evaluate_elements(trial_x_, trial_mode_, out);
  }
  evaluate_nodes(terms, trial_x_, out);
  effects_.remember(trial_x_,
                    [this](std::size_t batch) { return gather(batch, trial_x_, trial_mode_); });
}

/// Adds -dR/dtheta of every parameter at the converged trial: of the unknowns, of the modes, of the
/// rows of the grasp.
void ReferenceTissue::column_loads(const Terms& terms, RightSides& nodes, RightSides& modes,
                                   MatrixXd& grasp) {
  ReferenceColumns& c = *columns_;
  Residual same;
  Residual changed;
  c.same->evaluate_along(*this, terms, nullptr, same);
  c.pressed.setZero(static_cast<Eigen::Index>(friction_.size()), c.count());
  VectorXd load;
  Targets miss;
  const auto subtract = [&](double step) {
    load = (same.force - changed.force) / step;
    miss = (same.miss - changed.miss) / step;
  };
  for (int axis = 0; axis < 2 && grasp_ && !has_pad(); ++axis) {
    c.pinched_aside[axis]->evaluate_along(*this, terms, &same, changed);
    subtract(ReferenceColumns::kAside);
    nodes += load.head(model_->unknowns) * c.aside.row(axis);
    grasp += VectorXd::Map(miss.data(), miss.size()) * c.aside.row(axis);
  }
  for (Eigen::Index k = 0; k < c.count(); ++k) {
    const ColumnParameter& p = c.parameters[k];
    if (p.kind == ColumnKind::kToolPath && grasp_ && !has_pad()) {
      grasp.col(k).head<3>() += c.tip_from.col(k) + terms.end * (c.tip_to - c.tip_from).col(k);
    }
    if (p.kind != ColumnKind::kScene) continue;
    const bool same_elements = c.same_elements[k] != 0;
    c.changed[k]->evaluate_along(*this, terms, same_elements ? &same : nullptr, changed);
    subtract(p.step);
    nodes.col(k) += load.head(model_->unknowns);
    if (!same_elements) modes.col(k) += load.tail(modes.rows());
    if (grasp_) grasp.col(k) += VectorXd::Map(miss.data(), miss.size());
    for (std::size_t i = 0; i < friction_.size(); ++i) {
      c.pressed(static_cast<Eigen::Index>(i), k) =
          (c.changed[k]->friction_[i].pressed - c.same->friction_[i].pressed) / p.step;
    }
  }
  site_loads(terms, nodes, modes);
  clamp_loads(same, nodes, modes, grasp);
}

/// Gradient of the energy by the clamped nodes at the trial, weight included [N]; zero at others.
ReferenceTissue::Nodes ReferenceTissue::clamp_forces() const {
  Nodes force(trial_x_.size(), Eigen::Vector3d::Zero());
  for (std::size_t i = 0; i < force.size(); ++i) {
    if (model_->unknown[i] < 0) force[i] = -model_->mass[i] * gravity_;
  }
  HexForce hex;
  Values values{};
  for (const std::size_t batch : columns_->clamp_batches) {
    hex_force(model_->material.law(), gather(batch, trial_x_, trial_mode_), hex);
    for (int c = 0; c < 24; ++c) {
      hex.force[c].store(values.data());
      for (int lane = 0; lane < elements_in(batch); ++lane) {
        const int node = model_->elements[Pack::kLanes * batch + lane].node[c / 3];
        if (model_->unknown[node] < 0) force[node][c % 3] += values[lane];
      }
    }
  }
  return force;
}

/// The same of a clamp that is no longer rigid: to first order its nodes give way on their bed, or
/// their springs, by what they carry (release_anchors), and the free ones follow.
void ReferenceTissue::clamp_loads(const Residual& same, RightSides& nodes, RightSides& modes,
                                  MatrixXd& grasp) {
  constexpr double kStep = 1e-7;  // [m] far below what the elements are linear over
  ReferenceColumns& c = *columns_;
  Nodes force;
  for (Eigen::Index k = 0; k < c.count(); ++k) {
    const ColumnParameter& p = c.parameters[k];
    if (p.kind != ColumnKind::kClampGive && p.kind != ColumnKind::kClampFree) continue;
    if (force.empty()) force = clamp_forces();
    Nodes give = p.kind == ColumnKind::kClampGive ? model_->bed_give(force) : force;
    double most = 0;
    for (std::size_t i = 0; i < force.size(); ++i) {
      if (model_->unknown[i] >= 0) continue;
      if (p.kind == ColumnKind::kClampFree) give[i] *= model_->piece_compliance(i, p.place.x());
      c.rest.col(k).segment<3>(3 * static_cast<Eigen::Index>(i)) = -give[i];
      most = std::max(most, give[i].norm());
    }
    if (!(most > 0)) continue;
    const double step = kStep / most;
    Nodes moved = trial_x_;
    for (std::size_t i = 0; i < moved.size(); ++i) {
      if (model_->unknown[i] < 0)
        moved[i] += step * c.rest.col(k).segment<3>(3 * static_cast<Eigen::Index>(i));
    }
    Residual out;
    evaluate_elements(moved, trial_mode_, out);
    const VectorXd load = (same.elements - out.elements) / step;
    nodes.col(k) += load.head(model_->unknowns);
    modes.col(k) += load.tail(modes.rows());
    for (int n = 0; grasp_ && n < grasp_->patch.weight.rows(); ++n) {  // a pad is of free ones
      const int node = grasp_->patch.node[n];
      if (model_->unknown[node] >= 0) continue;
      for (int r = 0; r < GraspPatch::kRows; ++r)
        grasp.col(k).segment<3>(3L * r) -=
            grasp_->patch.weight(n, r) * c.rest.col(k).segment<3>(3L * node);
    }
  }
}

/// The same of the sites: a share of the elements' forces, of the masses' or a force.
void ReferenceTissue::site_loads(const Terms& terms, RightSides& nodes, RightSides& modes) const {
  const ReferenceColumns& c = *columns_;
  const bool any_stiffness =
      std::ranges::any_of(c.site_elements, [](const auto& list) { return !list.empty(); });
  // Per element and Gauss point: of the 24 numbers of its nodes, then of its modes.
  using ElementForces = std::array<std::array<double, 33>, kHexPoints>;
  std::vector<ElementForces> forces;
  if (any_stiffness) {
    std::array<HexForce, kHexPoints> hex;
    Values values{};
    forces.resize(model_->elements.size());
    for (std::size_t batch = 0; batch < model_->batches(); ++batch) {
      // Relative to the stiffness without inclusions, as theirs.
      HexShape shape = gather(batch, trial_x_, trial_mode_);
      shape.stiffness = nullptr;
      hex_point_forces(model_->material.law(), shape, hex);
      for (std::size_t point = 0; point < kHexPoints; ++point) {
        for (std::size_t f = 0; f < 33; ++f) {
          (f < 24 ? hex[point].force[f] : hex[point].mode_force[f - 24]).store(values.data());
          for (int lane = 0; lane < elements_in(batch); ++lane)
            forces[Pack::kLanes * batch + lane][point][f] = values[lane];
        }
      }
    }
  }
  const double inertia = this->inertia(terms);
  for (Eigen::Index k = 0; k < c.count(); ++k) {
    const ColumnParameter& p = c.parameters[k];
    for (const auto& [element, weights] : c.site_elements[k]) {
      std::array<double, 33> sum{};
      for (std::size_t point = 0; point < kHexPoints; ++point) {
        for (std::size_t f = 0; f < 33 && weights[point] > 0; ++f)
          sum[f] += weights[point] * forces[element][point][f];
      }
      for (int f = 0; f < 24; ++f) {
        const int row = node_unknown(element, f);
        if (row >= 0) nodes(row, k) -= sum[f];
      }
      for (int m = 0; m < 9; ++m) modes(9L * element + m, k) -= sum[24 + m];
    }
    if (p.kind == ColumnKind::kObstacle) add_obstacle_load(p, k, nodes);
    if (p.kind != ColumnKind::kDensitySite && p.kind != ColumnKind::kForceSite) continue;
    double whole = 0;
    for (std::size_t i = 0; i < model_->nodes.size(); ++i)
      whole += site_weight(p, model_->nodes[i]) * model_->node_area[i];
    for (std::size_t i = 0; i < model_->nodes.size() && whole > 0; ++i) {
      const int row = model_->unknown[i];
      const double weight = site_weight(p, model_->nodes[i]);
      if (row < 0 || weight == 0) continue;
      if (p.kind == ColumnKind::kForceSite) {
        nodes(row + p.axis, k) += weight * model_->node_area[i] / whole;
      } else {
        nodes.col(k).segment<3>(row) -=
            weight * model_->mass[i] *
            (inertia * (trial_x_[i] - terms.x_tilde[i]) - terms.v_tilde[i] / terms.beta - gravity_);
      }
    }
  }
}

}  // namespace omentum
