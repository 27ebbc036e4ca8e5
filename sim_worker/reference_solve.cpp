// One implicit step of the reference solid: residual, exact tangent, Newton with a line search.
#include <algorithm>
#include <cmath>

#include "sim_worker/reference_tissue.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kStandardGravity = 9.80665;  // [m/s^2]
// The friction limit follows the normal force in the first iterations of a step and is then frozen,
// so that the end of the iteration minimises one function: Newton converges quadratically there.
constexpr int kFrictionUpdates = 6;
constexpr int kMaxLineSearch = 14;
constexpr int kMaxShifts = 8;
// The factor is used again, within a step, while it brings the residual down to this share.
constexpr double kKeepFactor = 0.1;

Pack load_pack(const std::array<double, Pack::kLanes>& values) {
  return Pack(_mm256_loadu_pd(values.data()));
}

}  // namespace

bool ReferenceTissue::solve(const Terms& terms) {
  trial_x_ = state_.x;
  trial_bubble_ = state_.bubble;
  update_friction(terms, trial_x_);
  for (std::size_t i = 0; i < trial_x_.size(); ++i) {
    if (model_->unknown[i] >= 0) trial_x_[i] += terms.h * state_.v[i];
  }
  const double tolerance =
      model_->numerics.newton_tolerance() * model_->total_mass * kStandardGravity;
  Residual residual;
  evaluate(terms, trial_x_, trial_bubble_, residual);
  if (!std::isfinite(residual.energy)) {  // an element inverted on the way: start where it was
    trial_x_ = state_.x;
    evaluate(terms, trial_x_, trial_bubble_, residual);
  }
  bool fresh = true;
  for (int iteration = 0; iteration < static_cast<int>(model_->numerics.max_newton());
       ++iteration) {
    if (iteration > 0 && residual.norm <= tolerance) return true;
    ++newton_iterations_;
    if (fresh) {
      if (!make_factor(terms)) return false;
    } else {
      renew_inner(residual);
    }
    const double before = residual.norm;
    const bool found = newton_direction(residual) && search_line(terms, residual);
    if (!found && fresh) return false;
    fresh = !found || residual.norm > kKeepFactor * before;
    if (iteration < kFrictionUpdates && !friction_.empty()) {
      update_friction(terms, trial_x_);
      evaluate(terms, trial_x_, trial_bubble_, residual);
    }
  }
  return residual.norm <= tolerance;
}

/// Four elements; the last batch repeats its last element.
HexShape ReferenceTissue::gather(std::size_t batch, const Nodes& x, const Bubbles& bubble) const {
  HexShape shape;
  std::array<const ReferenceElement*, Pack::kLanes> element{};
  std::array<std::size_t, Pack::kLanes> index{};
  for (std::size_t lane = 0; lane < Pack::kLanes; ++lane) {
    index[lane] = std::min(Pack::kLanes * batch + lane, model_->elements.size() - 1);
    element[lane] = &model_->elements[index[lane]];
  }
  std::array<double, Pack::kLanes> values{};
  for (int a = 0; a < kHexNodes; ++a) {
    for (int axis = 0; axis < 3; ++axis) {
      for (std::size_t lane = 0; lane < Pack::kLanes; ++lane)
        values[lane] = x[static_cast<std::size_t>(element[lane]->node[a])][axis];
      shape.x[3 * a + axis] = load_pack(values);
    }
  }
  for (int k = 0; k < 9; ++k) {
    for (std::size_t lane = 0; lane < Pack::kLanes; ++lane) values[lane] = bubble[index[lane]][k];
    shape.bubble[k] = load_pack(values);
  }
  for (int axis = 0; axis < 3; ++axis) {
    for (std::size_t lane = 0; lane < Pack::kLanes; ++lane)
      values[lane] = element[lane]->size[axis];
    shape.size[axis] = load_pack(values);
  }
  for (std::size_t lane = 0; lane < Pack::kLanes; ++lane) values[lane] = element[lane]->stiffness;
  const Pack stiffness = load_pack(values);
  shape.mu = Pack(model_->lame.mu * parameters_.stiffness_scale) * stiffness;
  shape.lambda = Pack(model_->lame.lambda * parameters_.stiffness_scale) * stiffness;
  shape.effects = effects_.of_batch(batch);
  return shape;
}

void ReferenceTissue::add_force(int node, const Vector3d& force, Residual& out) const {
  const int row = model_->unknown[static_cast<std::size_t>(node)];
  if (row >= 0) out.force.segment<3>(row) += force;
}

/// Incremental potential of the step and its derivative. Where the nodes are clamped nothing is
/// counted.
void ReferenceTissue::evaluate(const Terms& terms, const Nodes& x, const Bubbles& bubble,
                               Residual& out) const {
  out.energy = 0;
  out.scale = 0;
  out.force.setZero(model_->unknowns);
  out.bubble_force.resize(bubble.size());
  HexForce hex;
  std::array<double, Pack::kLanes> lanes{};
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    hex_force(model_->material.law(), gather(batch, x, bubble), hex);
    const std::size_t first = Pack::kLanes * batch;
    const std::size_t count = std::min<std::size_t>(Pack::kLanes, model_->elements.size() - first);
    hex.energy.store(lanes.data());
    for (std::size_t lane = 0; lane < count; ++lane) out.count_energy(lanes[lane]);
    for (int c = 0; c < 24; ++c) {
      hex.force[c].store(lanes.data());
      for (std::size_t lane = 0; lane < count; ++lane) {
        const int row = model_->unknown[model_->elements[first + lane].node[c / 3]];
        if (row >= 0) out.force[row + c % 3] += lanes[lane];
      }
    }
    for (int c = 0; c < 9; ++c) {
      hex.bubble_force[c].store(lanes.data());
      for (std::size_t lane = 0; lane < count; ++lane)
        out.bubble_force[first + lane][c] = lanes[lane];
    }
  }

  const double beta = terms.beta;
  const double damping = model_->material.damping_per_s() * parameters_.damping_scale;
  const double inertia = 1 / (beta * beta) + damping / beta;
  const Vector3d& g = gravity_;
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (model_->unknown[i] < 0) continue;
    const Vector3d d = x[i] - terms.x_tilde[i];
    const Vector3d drive = terms.v_tilde[i] / beta + g;
    out.count_energy(model_->mass[i] * (0.5 * inertia * d.squaredNorm() - drive.dot(d)));
    add_force(static_cast<int>(i), model_->mass[i] * (inertia * d - drive), out);
  }

  add_contact(terms, x, out);
  effects_.for_each_force(x,
                          [&](int node, double energy, const Vector3d& gradient, const Matrix3d&) {
                            out.count_energy(energy);
                            add_force(node, gradient, out);
                          });
  if (grasp_) add_grasp(terms, x, out);

  double squares = out.force.squaredNorm();
  for (const auto& b : out.bubble_force) {
    for (const double f : b) squares += f * f;
  }
  out.norm = std::sqrt(squares);
}

/// Adds a block of nodes to the lower triangle; row and column are first unknowns.
void ReferenceTissue::add_block(int row, int column, const Matrix3d& block) {
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      if (row + i >= column + k) factor_.at(row + i, column + k) += block(i, k);
    }
  }
}

/// Tangent of the incremental potential without the grasp, parabolas eliminated, plus `shift` times
/// the inertia.
void ReferenceTissue::assemble(const Terms& terms, double shift) {
  factor_.set_zero();
  HexTangent tangent;
  std::array<std::array<double, Pack::kLanes>, 324> stiffness{};
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    hex_tangent(model_->material.law(), gather(batch, trial_x_, trial_bubble_), tangent);
    inner_[batch] = tangent.inner;
    for (std::size_t k = 0; k < stiffness.size(); ++k)
      tangent.stiffness[k].store(stiffness[k].data());
    const std::size_t first = Pack::kLanes * batch;
    const std::size_t count = std::min<std::size_t>(Pack::kLanes, model_->elements.size() - first);
    for (std::size_t lane = 0; lane < count; ++lane) {
      const ReferenceElement& element = model_->elements[first + lane];
      for (int a = 0; a < kHexNodes; ++a) {
        const int row = model_->unknown[static_cast<std::size_t>(element.node[a])];
        if (row < 0) continue;
        for (int b = 0; b <= a; ++b) {
          const int column = model_->unknown[static_cast<std::size_t>(element.node[b])];
          if (column < 0) continue;
          Matrix3d block;
          for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k)
              block(i, k) =
                  stiffness[static_cast<std::size_t>(9 * (a * (a + 1) / 2 + b) + 3 * i + k)][lane];
          }
          if (row >= column) {
            add_block(row, column, block);
          } else {
            add_block(column, row, block.transpose());
          }
        }
      }
    }
  }

  const double beta = terms.beta;
  const double damping = model_->material.damping_per_s() * parameters_.damping_scale;
  const double inertia = (1 + shift) / (beta * beta) + damping / beta;
  for (std::size_t i = 0; i < model_->nodes.size(); ++i) {
    const int row = model_->unknown[i];
    if (row >= 0) add_block(row, row, model_->mass[i] * inertia * Matrix3d::Identity());
  }
  add_contact_stiffness(terms);
  effects_.for_each_force(trial_x_, [&](int node, double, const Vector3d&, const Matrix3d& block) {
    const int row = model_->unknown[static_cast<std::size_t>(node)];
    if (row >= 0) add_block(row, row, block);
  });
}

/// Factors the tangent at the trial; moves it by inertia until it is positive definite.
bool ReferenceTissue::make_factor(const Terms& terms) {
  ++factorisations_;
  double shift = 0;
  assemble(terms, shift);
  for (int attempt = 0; !factor_.factor(); ++attempt) {
    if (attempt == kMaxShifts) return false;
    shift = shift == 0 ? 1 : 10 * shift;
    assemble(terms, shift);
  }
  if (grasp_) prepare_constraint();
  return true;
}

/// The factor stays, the forces of the parabolas are those of the trial.
void ReferenceTissue::renew_inner(const Residual& residual) {
  std::array<double, Pack::kLanes> values{};
  std::array<Pack, 9> bubble_force;
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    const std::size_t first = Pack::kLanes * batch;
    for (int c = 0; c < 9; ++c) {
      for (std::size_t lane = 0; lane < Pack::kLanes; ++lane) {
        const std::size_t element = std::min(first + lane, model_->elements.size() - 1);
        values[lane] = residual.bubble_force[element][c];
      }
      bubble_force[c] = load_pack(values);
    }
    hex_condense(bubble_force, inner_[batch]);
  }
}

/// Newton step of nodes and parabolas with the factor there is.
bool ReferenceTissue::newton_direction(const Residual& residual) {
  // Condensed force: f - K_xb K_bb^-1 f_b = f - coupling^T rhs.
  direction_ = -residual.force;
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    const HexInner& inner = inner_[batch];
    const std::size_t first = Pack::kLanes * batch;
    const std::size_t count = std::min<std::size_t>(Pack::kLanes, model_->elements.size() - first);
    for (int c = 0; c < 24; ++c) {
      Pack sum;
      for (int r = 0; r < 9; ++r) sum = fma(inner.coupling[24 * r + c], inner.rhs[r], sum);
      for (std::size_t lane = 0; lane < count; ++lane) {
        const int row = model_->unknown[model_->elements[first + lane].node[c / 3]];
        if (row >= 0) direction_[row + c % 3] += sum.lane(static_cast<int>(lane));
      }
    }
  }

  factor_.solve_lower(direction_, 0);
  if (grasp_) constrain_direction();
  factor_.solve_upper(direction_);

  bubble_direction_.resize(model_->elements.size());
  std::array<Pack, 24> dx;
  std::array<Pack, 9> dbubble;
  std::array<double, Pack::kLanes> values{};
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    const std::size_t first = Pack::kLanes * batch;
    const std::size_t count = std::min<std::size_t>(Pack::kLanes, model_->elements.size() - first);
    for (int c = 0; c < 24; ++c) {
      values.fill(0);
      for (std::size_t lane = 0; lane < count; ++lane) {
        const int row = model_->unknown[model_->elements[first + lane].node[c / 3]];
        if (row >= 0) values[lane] = direction_[row + c % 3];
      }
      dx[c] = load_pack(values);
    }
    hex_recover(inner_[batch], dx, dbubble);
    for (int c = 0; c < 9; ++c) {
      dbubble[c].store(values.data());
      for (std::size_t lane = 0; lane < count; ++lane)
        bubble_direction_[first + lane][c] = values[lane];
    }
  }
  return direction_.allFinite();
}

/// Moves the trial from (x, bubble) by a share of the direction. Where friction would turn its
/// direction round, the node stops at the kink of the friction law instead: it then sticks, or
/// leaves in the right direction, in the next iteration. Newton's step alone would jump to and fro.
void ReferenceTissue::move_trial(const Terms& terms, double share, const Nodes& x,
                                 const Bubbles& bubble) {
  for (std::size_t i = 0; i < x.size(); ++i) {
    const int row = model_->unknown[i];
    if (row >= 0) trial_x_[i] = x[i] + share * direction_.segment<3>(row);
  }
  for (std::size_t e = 0; e < bubble.size(); ++e) {
    for (int c = 0; c < 9; ++c)
      trial_bubble_[e][c] = bubble[e][c] + share * bubble_direction_[e][c];
  }
  for (const FrictionPoint& f : friction_) {
    const auto i = static_cast<std::size_t>(f.node);
    const Vector3d before = slip_velocity(terms, f, x[i]);
    const Vector3d after = slip_velocity(terms, f, trial_x_[i]);
    if (after.dot(before) < 0) trial_x_[i] -= terms.beta * after;
  }
}

/// Walks along the direction until the potential falls enough (Armijo). Where rounding hides the
/// fall of the potential the residual has to shrink instead.
bool ReferenceTissue::search_line(const Terms& terms, Residual& residual) {
  constexpr double kRounding = 1e-13;  // of a sum over some thousand terms
  double slope = residual.force.dot(direction_);
  for (std::size_t e = 0; e < bubble_direction_.size(); ++e) {
    for (int c = 0; c < 9; ++c) slope += residual.bubble_force[e][c] * bubble_direction_[e][c];
  }
  const bool hidden = std::fabs(slope) < kRounding * residual.scale;
  const Nodes x = trial_x_;
  const Bubbles bubble = trial_bubble_;
  Residual trial;
  double share = 1;
  for (int attempt = 0; attempt < kMaxLineSearch; ++attempt, share *= 0.5) {
    move_trial(terms, share, x, bubble);
    evaluate(terms, trial_x_, trial_bubble_, trial);
    if (!std::isfinite(trial.energy)) continue;
    if (hidden ? trial.norm < residual.norm
               : trial.energy <= residual.energy + 1e-4 * share * slope) {
      std::swap(residual, trial);
      return true;
    }
  }
  return false;
}

}  // namespace omentum
