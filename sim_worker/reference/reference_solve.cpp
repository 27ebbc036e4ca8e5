// One implicit step of the reference solid: residual, exact tangent, Newton with a line search.
#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "sim_worker/reference/reference_tissue.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::VectorXd;

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
// The block of a node enters a factor anew where it changed by this share. The tangent of the
// elements is kept for so many factors.
constexpr double kBlockChange = 0.1;
constexpr int kKeepTangent = 4;

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
  Renewal renewal = carry_factor() ? Renewal::kNodes : Renewal::kAll;
  int updates = 0;  // of friction
  int rounds = 0;   // with frozen friction
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
    const long factors = factorisations_;
    if (renewal != Renewal::kNone && !renew_factor(terms, renewal, iteration > 0)) return false;
    const bool fresh = factorisations_ > factors;
    const double before = residual.norm;
    const bool found = newton_direction(residual) && search_line(terms, residual);
    if (!found && fresh && kept_ == 0) return false;
    renewal = !found                                 ? Renewal::kAll
              : residual.norm > kKeepFactor * before ? Renewal::kNodes
                                                     : Renewal::kNone;
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

/// Second derivative of the incremental potential by a node, per mass [1/s^2].
double ReferenceTissue::inertia(const Terms& terms) const {
  const double damping = model_->material.damping_per_s() * parameters_.damping_scale;
  return 1 / (terms.beta * terms.beta) + damping / terms.beta;
}

/// Incremental potential of the step and its derivative. Where the nodes are clamped nothing is
/// counted.
void ReferenceTissue::evaluate(const Terms& terms, const Nodes& x, const Bubbles& bubble,
                               Residual& out) const {
  out.energy = 0;
  out.scale = 0;
  out.force.setZero(direction_.size());
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
        out.force[bubble_unknown(first + lane, c)] = lanes[lane];
    }
  }

  const double beta = terms.beta;
  const double inertia = this->inertia(terms);
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
  out.norm = std::sqrt(out.force.squaredNorm() + out.miss_force.squaredNorm());
}

/// Sets the block of a node with itself: elements and inertia, and what else acts on the node.
void ReferenceTissue::set_block(int node, const Matrix3d& more) {
  const BlockPlace& place = model_->node_blocks[static_cast<std::size_t>(node)];
  if (place.at < 0) return;
  double* entries = factor_.entries() + place.at;
  const Matrix3d& body = body_blocks_[static_cast<std::size_t>(node)];
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k)
      entries[i * place.down + k * place.across] = body(i, k) + more(i, k);
  }
}

/// Tangent of elements and inertia where tangent_ says, parabolas eliminated.
void ReferenceTissue::assemble() {
  factor_.set_zero();
  double* entries = factor_.entries();
  HexTangent tangent;
  std::array<std::array<double, Pack::kLanes>, 324> stiffness{};
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    hex_tangent(model_->material.law(), gather(batch, tangent_.x, tangent_.bubble), tangent);
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
  body_blocks_.resize(model_->nodes.size());
  for (std::size_t i = 0; i < model_->nodes.size(); ++i) {
    const BlockPlace& place = model_->node_blocks[i];
    if (place.at < 0) continue;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c)
        body_blocks_[i](r, c) = entries[place.at + r * place.down + c * place.across];
    }
    body_blocks_[i].diagonal().array() += model_->mass[i] * tangent_.inertia;
    set_block(static_cast<int>(i), tangent_.node_blocks[i]);
  }
}

/// Makes the factor (without the grasp) anew. With kNodes the elements keep the tangent they have,
/// kKeepTangent times at most, where blocks of nodes changed: where nodes touch, part, stick or
/// slip, that decides how fast Newton gets on.
bool ReferenceTissue::renew_factor(const Terms& terms, Renewal renewal, bool must) {
  std::vector<Matrix3d> blocks = node_blocks(terms);
  if (renewal == Renewal::kNodes && kept_ < kKeepTangent) {
    std::vector<int> changed;
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      Matrix3d& old = tangent_.node_blocks[i];
      const double size = std::max(old.cwiseAbs().maxCoeff(), blocks[i].cwiseAbs().maxCoeff());
      const double change = (blocks[i] - old).cwiseAbs().maxCoeff();
      if (model_->unknown[i] < 0 || !(change > kBlockChange * size)) continue;
      changed.push_back(model_->unknown[i]);
      old = blocks[i];
      set_block(static_cast<int>(i), old);
    }
    if (changed.empty() && !must) return true;
    if (!changed.empty()) {
      ++kept_;
      ++factorisations_;
      factored_ = factor_.factor_again(changed);
      if (factored_) {
        if (grasp_) prepare_constraint();
        return true;
      }
    }
  }
  return make_factor(terms, std::move(blocks));
}

/// From the elements on; moves the tangent by inertia until it is positive definite.
bool ReferenceTissue::make_factor(const Terms& terms, std::vector<Matrix3d> blocks) {
  ++factorisations_;
  kept_ = 0;
  tangent_.inertia = inertia(terms);
  tangent_.x = trial_x_;
  tangent_.bubble = trial_bubble_;
  tangent_.node_blocks = std::move(blocks);
  assemble();
  double shift = 0;
  for (int attempt = 0; attempt <= kMaxShifts; ++attempt) {
    const double more = shift / (terms.beta * terms.beta);
    for (std::size_t i = 0; i < model_->nodes.size() && shift > 0; ++i) {
      set_block(static_cast<int>(i),
                more * model_->mass[i] * Matrix3d::Identity() + tangent_.node_blocks[i]);
    }
    factored_ = factor_.factor();
    if (factored_) {
      // What the material remembers changes with the step, and with it the elements' tangent.
      tangent_.usable = shift == 0 && !effects_.values().has_memory();
      if (grasp_) prepare_constraint();
      return true;
    }
    shift = shift == 0 ? 1 : 10 * shift;
  }
  return false;
}

/// Contact, friction and springs at the trial, per node.
std::vector<Matrix3d> ReferenceTissue::node_blocks(const Terms& terms) const {
  std::vector<Matrix3d> sum(model_->nodes.size(), Matrix3d::Zero());
  const auto add = [&sum](int node, const Matrix3d& block) {
    sum[static_cast<std::size_t>(node)] += block;
  };
  contact_stiffness(terms, add);
  effects_.for_each_force(trial_x_, [&](int node, double, const Vector3d&, const Matrix3d& block) {
    add(node, block);
  });
  return sum;
}

/// The factor of the step before, made again where the state was loaded. False where there is none.
bool ReferenceTissue::carry_factor() {
  kept_ = 0;
  if (!tangent_.usable) return false;
  if (!factored_) {
    assemble();
    factored_ = factor_.factor();
    constrained_ = false;
  }
  tangent_.usable = factored_;
  if (factored_ && grasp_ && !constrained_) prepare_constraint();
  return factored_;
}

/// Newton step of nodes and parabolas with the factor there is.
bool ReferenceTissue::newton_direction(const Residual& residual) {
  direction_ = -residual.force;
  std::array<double, Pack::kLanes> values{};
  std::array<Pack, 9> bubble_force;
  // Parabolas eliminated: f - K_xb K_bb^-1 f_b = f - coupling^T rhs.
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    HexInner& inner = inner_[batch];
    const std::size_t first = Pack::kLanes * batch;
    const std::size_t count = std::min<std::size_t>(Pack::kLanes, model_->elements.size() - first);
    for (int c = 0; c < 9; ++c) {
      for (std::size_t lane = 0; lane < count; ++lane)
        values[lane] = -direction_[bubble_unknown(first + lane, c)];
      bubble_force[c] = load_pack(values);
    }
    hex_condense(bubble_force, inner);
    for (int c = 0; c < 24; ++c) {
      Pack sum;
      for (int r = 0; r < 9; ++r) sum = fma(inner.coupling[24 * r + c], inner.rhs[r], sum);
      for (std::size_t lane = 0; lane < count; ++lane) {
        const int row = model_->unknown[model_->elements[first + lane].node[c / 3]];
        if (row >= 0) direction_[row + c % 3] += sum.lane(static_cast<int>(lane));
      }
    }
  }

  auto nodes = direction_.head(model_->unknowns);
  factor_.solve_lower(nodes);
  if (grasp_) constrain(residual.miss, nodes);
  factor_.solve_upper(nodes);

  std::array<Pack, 24> dx;
  std::array<Pack, 9> dbubble;
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
        direction_[bubble_unknown(first + lane, c)] = values[lane];
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
      trial_bubble_[e][c] = bubble[e][c] + share * direction_[bubble_unknown(e, c)];
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
  const double slope =
      residual.force.dot(direction_) - residual.miss.cwiseProduct(residual.miss_force).sum();
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
