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
// so that the end of the iteration minimises one function. Where the limits do not fit the normal
// forces that it ends with (share of the weight), another round begins with those that do, and
// has max_newton iterations of its own: a round is another function to minimise.
constexpr double kFrictionTolerance = 1e-6;
constexpr int kFrictionUpdates = 10;
constexpr int kFrictionRounds = 8;
constexpr int kMaxLineSearch = 14;
constexpr int kMaxShifts = 8;
// The factor is used again, within a step, while it brings the residual down to this share.
constexpr double kKeepFactor = 0.1;
constexpr int kKeepTangent = 2;

Pack load_pack(const std::array<double, Pack::kLanes>& values) {
  return Pack(_mm256_loadu_pd(values.data()));
}

}  // namespace

bool ReferenceTissue::solve(const Terms& terms) {
  trial_x_ = state_.x;
  trial_bubble_ = state_.bubble;
  trial_pull_ = state_.pull;
  update_friction(terms, trial_x_);
  for (std::size_t i = 0; i < trial_x_.size(); ++i) {
    if (model_->unknown[i] >= 0) trial_x_[i] += terms.h * state_.v[i];
  }
  const double weight = model_->total_mass * kStandardGravity;
  const double tolerance = model_->numerics.newton_tolerance() * weight;
  Residual residual;
  evaluate(terms, trial_x_, trial_bubble_, residual);
  if (!std::isfinite(residual.energy)) {  // an element inverted on the way: start where it was
    trial_x_ = state_.x;
    evaluate(terms, trial_x_, trial_bubble_, residual);
  }
  bool fresh = true;  // the factor is to be made anew,
  bool all = true;    // with the tangent of the elements
  int updates = 0;    // of friction
  int rounds = 0;     // with frozen friction
  for (int iteration = 0; iteration < static_cast<int>(model_->numerics.max_newton());
       ++iteration) {
    const bool frozen = updates == kFrictionUpdates;
    if (iteration > 0 && residual.norm <= tolerance) {
      if (!frozen) return true;
      update_friction(terms, trial_x_);
      evaluate_outside(terms, trial_x_, residual);
      if (residual.norm <= kFrictionTolerance * weight || ++rounds == kFrictionRounds) return true;
      iteration = 0;  // of the next round
    }
    ++newton_iterations_;
    if (fresh && !make_factor(terms, all)) return false;
    renew_inner(residual);
    const double before = residual.norm;
    const bool found = newton_direction(residual) && search_line(terms, residual);
    if (!found && fresh && kept_ == 0) return false;
    all = !found;
    fresh = !found || residual.norm > kKeepFactor * before;
    if (frozen) continue;
    update_friction(terms, trial_x_);
    evaluate_outside(terms, trial_x_, residual);
    ++updates;
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

  effects_.for_each_force(x,
                          [&](int node, double energy, const Vector3d& gradient, const Matrix3d&) {
                            out.count_energy(energy);
                            add_force(node, gradient, out);
                          });
  out.inside = out.force;
  out.energy_inside = out.energy;
  evaluate_outside(terms, x, out);
}

/// Contact, friction and grasp anew, the rest as evaluate() left it.
void ReferenceTissue::evaluate_outside(const Terms& terms, const Nodes& x, Residual& out) const {
  out.force = out.inside;
  out.energy = out.energy_inside;
  add_contact(terms, x, out);
  if (grasp_) add_grasp(terms, x, out);
  double squares = out.force.squaredNorm() + out.miss_force.squaredNorm();
  for (const auto& b : out.bubble_force) {
    for (const double f : b) squares += f * f;
  }
  out.norm = std::sqrt(squares);
}

/// Adds a block of a node with itself.
void ReferenceTissue::add_block(int node, const Matrix3d& block) {
  const BlockPlace& place = model_->node_blocks[static_cast<std::size_t>(node)];
  if (place.at < 0) return;
  double* entries = factor_.entries() + place.at;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) entries[i * place.down + k * place.across] += block(i, k);
  }
}

/// Tangent of elements and inertia at the trial, parabolas eliminated.
void ReferenceTissue::assemble(const Terms& terms) {
  factor_.set_zero();
  double* entries = factor_.entries();
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
      const double* block = &stiffness[0][lane];
      for (const BlockPlace& place : model_->element_blocks[first + lane]) {
        if (place.at >= 0) {
          double* entry = entries + place.at;
          for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k)
              entry[i * place.down + k * place.across] += block[Pack::kLanes * (3 * i + k)];
          }
        }
        block += std::ptrdiff_t{9} * Pack::kLanes;
      }
    }
  }
  const double beta = terms.beta;
  const double damping = model_->material.damping_per_s() * parameters_.damping_scale;
  const double inertia = 1 / (beta * beta) + damping / beta;
  for (std::size_t i = 0; i < model_->nodes.size(); ++i)
    add_block(static_cast<int>(i), model_->mass[i] * inertia * Matrix3d::Identity());
  body_tangent_.assign(entries, entries + model_->order.entries);
}

/// Factors the tangent without the grasp; moves it by inertia until it is positive definite. Where
/// nodes touch, part, stick or slip since the last factor, that decides how fast Newton gets on:
/// the elements then keep the tangent of that factor, twice in a row at most.
bool ReferenceTissue::make_factor(const Terms& terms, bool all) {
  ++factorisations_;
  std::vector<int> touch = contact_states(terms);
  const bool keep = !all && touch != touch_ && kept_ < kKeepTangent;
  touch_ = std::move(touch);
  kept_ = keep ? kept_ + 1 : 0;
  if (!keep) assemble(terms);
  double shift = 0;
  for (int attempt = 0; attempt <= kMaxShifts; ++attempt) {
    if (keep || attempt > 0)
      std::copy(body_tangent_.begin(), body_tangent_.end(), factor_.entries());
    for (std::size_t i = 0; i < model_->nodes.size() && shift > 0; ++i) {
      add_block(static_cast<int>(i),
                shift / (terms.beta * terms.beta) * model_->mass[i] * Matrix3d::Identity());
    }
    add_contact_stiffness(terms);
    effects_.for_each_force(trial_x_, [&](int node, double, const Vector3d&,
                                          const Matrix3d& block) { add_block(node, block); });
    if (factor_.factor()) {
      if (grasp_) prepare_constraint();
      return true;
    }
    shift = shift == 0 ? 1 : 10 * shift;
  }
  return false;
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

  factor_.solve_lower(direction_);
  if (grasp_) constrain_direction(residual.miss);
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

/// Walks along the direction until the potential falls enough (Armijo), with the pull on the jaws
/// that the direction ends with. Where rounding hides the fall of the potential the residual has to
/// shrink instead. The trial stays where it was if neither happens.
bool ReferenceTissue::search_line(const Terms& terms, Residual& residual) {
  constexpr double kRounding = 1e-13;  // of a sum over some thousand terms
  const Targets pull = trial_pull_;
  if (grasp_) trial_pull_ = next_pull_;
  evaluate_outside(terms, trial_x_, residual);
  double slope =
      residual.force.dot(direction_) - residual.miss.cwiseProduct(residual.miss_force).sum();
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
  trial_x_ = x;
  trial_bubble_ = bubble;
  trial_pull_ = pull;
  evaluate_outside(terms, trial_x_, residual);
  return false;
}

}  // namespace omentum
