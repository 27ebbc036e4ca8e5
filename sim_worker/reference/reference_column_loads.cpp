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
  if (grasp_) {
    terms.target = grasp_->offset;
    terms.target.col(0) += terms.tip;
  }
  effects_.begin(terms.h, state_.x, state_.v, terms.x_tilde, terms.beta);
  update_friction(terms, trial_x_);
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
  VectorXd load;
  Targets miss;
  const auto subtract = [&](double step) {
    load = (same.force - changed.force) / step;
    miss = (same.miss - changed.miss) / step;
  };
  for (int axis = 0; axis < 2 && grasp_; ++axis) {
    c.pinched_aside[axis]->evaluate_along(*this, terms, &same, changed);
    subtract(ReferenceColumns::kAside);
    nodes += load.head(model_->unknowns) * c.aside.row(axis);
    grasp += VectorXd::Map(miss.data(), miss.size()) * c.aside.row(axis);
  }
  for (Eigen::Index k = 0; k < c.count(); ++k) {
    const ColumnParameter& p = c.parameters[k];
    if (p.kind == ColumnKind::kToolPath && grasp_) {
      grasp.col(k).head<3>() += c.tip_from.col(k) + terms.end * (c.tip_to - c.tip_from).col(k);
    }
    if (p.kind != ColumnKind::kScene) continue;
    const bool same_elements = c.same_elements[k] != 0;
    c.changed[k]->evaluate_along(*this, terms, same_elements ? &same : nullptr, changed);
    subtract(p.step);
    nodes.col(k) += load.head(model_->unknowns);
    if (!same_elements) modes.col(k) += load.tail(modes.rows());
    if (grasp_) grasp.col(k) += VectorXd::Map(miss.data(), miss.size());
  }
  site_loads(terms, nodes, modes);
}

/// The same of the sites: a share of the elements' forces, of the masses' or a force.
void ReferenceTissue::site_loads(const Terms& terms, RightSides& nodes, RightSides& modes) const {
  const ReferenceColumns& c = *columns_;
  const bool any_stiffness =
      std::ranges::any_of(c.site_elements, [](const auto& list) { return !list.empty(); });
  std::vector<std::array<double, 33>> forces;
  if (any_stiffness) {
    HexForce hex;
    Values values{};
    forces.resize(model_->elements.size());
    for (std::size_t batch = 0; batch < model_->batches(); ++batch) {
      hex_force(model_->material.law(), gather(batch, trial_x_, trial_mode_), hex);
      for (int f = 0; f < 33; ++f) {
        (f < 24 ? hex.force[f] : hex.mode_force[f - 24]).store(values.data());
        for (int lane = 0; lane < elements_in(batch); ++lane)
          forces[Pack::kLanes * batch + lane][f] = values[lane];
      }
    }
  }
  const double inertia = this->inertia(terms);
  for (Eigen::Index k = 0; k < c.count(); ++k) {
    const ColumnParameter& p = c.parameters[k];
    for (const auto& [element, weight] : c.site_elements[k]) {
      for (int f = 0; f < 24; ++f) {
        const int row = node_unknown(element, f);
        if (row >= 0) nodes(row, k) -= weight * forces[element][f];
      }
      for (int m = 0; m < 9; ++m) modes(9L * element + m, k) -= weight * forces[element][24 + m];
    }
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
