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

// The friction limits follow the normal forces in the first iterations of a step and are then
// frozen, so that the iteration minimises one function. Where they then differ from the limits of
// the final normal forces by more than a fraction of the weight, another round with these begins,
// with max_newton iterations of its own.
constexpr double kFrictionTolerance = 1e-6;
constexpr int kFrictionUpdates = 10;
constexpr int kFrictionRounds = 8;
constexpr int kMaxLineSearch = 14;
constexpr int kMaxShifts = 8;
// Modified Newton: within a step a factor is used again while the residual falls to this fraction.
constexpr double kKeepFactor = 0.1;
// Relative change of a node's block above which the factor is updated there; number of updates
// before the tangent of the elements is renewed as well.
constexpr double kBlockChange = 0.1;
constexpr int kKeepTangent = 4;

using Values = std::array<double, Pack::kLanes>;

}  // namespace

/// One implicit step by Newton's method, from where the tissue would go freely (`moving`) or from
/// where it is.
bool ReferenceTissue::solve(const Terms& terms, bool moving) {
  trial_x_ = state_.x;
  trial_mode_ = state_.mode;
  trial_multiplier_ = state_.multiplier;
  trial_turn_ = state_.turn;
  update_friction(terms, trial_x_);
  for (std::size_t i = 0; i < trial_x_.size(); ++i) {
    if (model_->unknown[i] >= 0 && moving) trial_x_[i] += terms.h * state_.v[i];
  }
  const double weight = model_->total_mass * kStandardGravity;
  const double tolerance = model_->numerics.newton_tolerance() * weight;
  Residual residual;
  evaluate(terms, trial_x_, trial_mode_, residual);
  if (!std::isfinite(residual.energy)) {  // the guess inverts an element: start from x_n
    trial_x_ = state_.x;
    evaluate(terms, trial_x_, trial_mode_, residual);
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
    if (!found && fresh && kept_ == 0) return residual.norm <= rounding_;
    renewal = !found                                 ? Renewal::kAll
              : residual.norm > kKeepFactor * before ? Renewal::kNodes
                                                     : Renewal::kNone;
    if (frozen) continue;
    update_friction(terms, trial_x_);
    evaluate_outside(terms, trial_x_, residual);
    ++updates;
  }
  if (!(residual.norm <= tolerance)) return false;
  // The last iteration has converged, perhaps with limits of friction that are not those of its
  // contacts.
  update_friction(terms, trial_x_);
  evaluate_outside(terms, trial_x_, residual);
  return residual.norm <= kFrictionTolerance * weight;
}

void ReferenceTissue::add_force(int node, const Vector3d& force, Residual& out) const {
  const int row = model_->unknown[node];
  if (row >= 0) out.force.segment<3>(row) += force;
}

/// Second derivative of the inertial potential by a node, per mass [1/s^2].
double ReferenceTissue::inertia(const Terms& terms) const {
  const double damping = model_->material.damping_per_s() * parameters_.damping_scale;
  return 1 / (terms.beta * terms.beta) + damping / terms.beta;
}

/// Incremental potential of the step and its derivative by the free nodes and the parabolas.
void ReferenceTissue::evaluate(const Terms& terms, const Nodes& x, const Modes& mode,
                               Residual& out) const {
  evaluate_elements(x, mode, out);
  evaluate_nodes(terms, x, out);
}

/// The part of the elements.
void ReferenceTissue::evaluate_elements(const Nodes& x, const Modes& mode, Residual& out) const {
  out.energy = 0;
  out.scale = 0;
  out.elements.setZero(model_->unknowns + 9 * static_cast<Eigen::Index>(model_->elements.size()));
  HexForce hex;
  Values values{};
  for (std::size_t batch = 0; batch < model_->batches(); ++batch) {
    hex_force(model_->material.law(), gather(batch, x, mode), hex);
    hex.energy.store(values.data());
    for (int lane = 0; lane < elements_in(batch); ++lane) out.count_energy(values[lane]);
    for (int c = 0; c < 24; ++c) {
      hex.force[c].store(values.data());
      for (int lane = 0; lane < elements_in(batch); ++lane) {
        const int row = node_unknown(Pack::kLanes * batch + lane, c);
        if (row >= 0) out.elements[row] += values[lane];
      }
    }
    for (int c = 0; c < 9; ++c) {
      hex.mode_force[c].store(values.data());
      for (int lane = 0; lane < elements_in(batch); ++lane)
        out.elements[mode_unknown(Pack::kLanes * batch + lane, c)] = values[lane];
    }
  }
}

/// Adds that of the nodes: inertia, gravity, springs, then what evaluate_outside() has.
void ReferenceTissue::evaluate_nodes(const Terms& terms, const Nodes& x, Residual& out) const {
  out.force = out.elements;
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

/// Renews the terms of contact, friction and grasp.
void ReferenceTissue::evaluate_outside(const Terms& terms, const Nodes& x, Residual& out) const {
  out.force = out.inside;
  out.energy = out.energy_inside;
  add_contact(terms, x, out);
  if (grasp_) add_grasp(terms, x, out);
  out.norm = std::sqrt(out.force.squaredNorm() + out.miss_force.squaredNorm() +
                       out.moment_force * out.moment_force);
}

/// Sets the diagonal block of a node: elements and inertia, plus `more`.
void ReferenceTissue::set_block(int node, const Matrix3d& block, FrontalCholesky& factor) const {
  const BlockPlace& place = model_->node_blocks[node];
  if (place.at < 0) return;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) factor.entries()[place.entry(i, k)] = block(i, k);
  }
}

void ReferenceTissue::assemble() { assemble(tangent_, factor_, inner_, body_blocks_); }

/// Matrix of a tangent: elements with the modes eliminated, inertia, blocks of the nodes.
void ReferenceTissue::assemble(const Tangent& tangent, FrontalCholesky& factor,
                               std::vector<HexInner>& inner,
                               std::vector<Matrix3d>& body_blocks) const {
  factor.set_zero();
  inner.resize(model_->batches());
  double* entries = factor.entries();
  HexTangent hex;
  std::array<Values, 324> stiffness{};
  for (std::size_t batch = 0; batch < inner.size(); ++batch) {
    hex_tangent(model_->material.law(), gather(batch, tangent.x, tangent.mode), hex);
    inner[batch] = hex.inner;
    for (std::size_t k = 0; k < stiffness.size(); ++k) hex.stiffness[k].store(stiffness[k].data());
    for (int lane = 0; lane < elements_in(batch); ++lane) {
      const auto& places = model_->element_blocks[Pack::kLanes * batch + lane];
      for (std::size_t b = 0; b < places.size(); ++b) {
        if (places[b].at < 0) continue;
        for (int i = 0; i < 3; ++i) {
          for (int k = 0; k < 3; ++k)
            entries[places[b].entry(i, k)] += stiffness[9 * b + 3 * i + k][lane];
        }
      }
    }
  }
  for (std::size_t p = 0; p < model_->bed.size(); ++p) {
    const BedPoint& point = model_->bed[p];
    const double k = effects_.bed_stiffness(p);
    auto place = model_->bed_blocks[p].begin();
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b <= a; ++b, ++place) {
        for (int axis = 0; axis < 3 && place->at >= 0; ++axis)
          entries[place->entry(axis, axis)] += k * point.share[a] * point.share[b];
      }
    }
  }
  body_blocks.resize(model_->nodes.size());
  for (std::size_t i = 0; i < model_->nodes.size(); ++i) {
    const BlockPlace& place = model_->node_blocks[i];
    if (place.at < 0) continue;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) body_blocks[i](r, c) = entries[place.entry(r, c)];
    }
    body_blocks[i].diagonal().array() += model_->mass[i] * tangent.inertia;
    set_block(static_cast<int>(i), body_blocks[i] + tangent.node_blocks[i], factor);
  }
}

/// Renews the factor (without the grasp). With kNodes the elements keep their tangent, kKeepTangent
/// times at most, and only blocks of nodes that changed are renewed: where nodes touch, part, stick
/// or slip, these decide the convergence of Newton's method.
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
      set_block(static_cast<int>(i), body_blocks_[i] + old, factor_);
    }
    if (changed.empty() && !must) return true;
    if (!changed.empty()) {
      ++kept_;
      ++factorisations_;
      factored_ = factor_.factor_again(changed);
      if (factored_ && prepare_constraint()) return true;
    }
  }
  return make_factor(terms, std::move(blocks));
}

/// Factor at the trial from the elements on; adds inertia until it is positive definite in the
/// motions that the grasp allows.
bool ReferenceTissue::make_factor(const Terms& terms, std::vector<Matrix3d> blocks) {
  ++factorisations_;
  kept_ = 0;
  tangent_.inertia = inertia(terms);
  tangent_.x = trial_x_;
  tangent_.mode = trial_mode_;
  tangent_.node_blocks = std::move(blocks);
  assemble();
  rounding_ = rounding();
  double shift = 0;
  for (int attempt = 0; attempt <= kMaxShifts; ++attempt) {
    const double more = shift / (terms.beta * terms.beta);
    for (std::size_t i = 0; i < model_->nodes.size() && shift > 0; ++i) {
      const Matrix3d block =
          more * model_->mass[i] * Matrix3d::Identity() + tangent_.node_blocks[i];
      set_block(static_cast<int>(i), body_blocks_[i] + block, factor_);
    }
    factored_ = factor_.factor();
    if (factored_ && prepare_constraint()) {
      // Where the material has memory, or the bed gives way for good, they change with the step.
      tangent_.usable = shift == 0 && !effects_.values().has_memory() &&
                        !(effects_.values().anchor_break > 0 && !model_->bed.empty());
      return true;
    }
    shift = shift == 0 ? 1 : 10 * shift;
  }
  return false;
}

/// Residual that rounding of the coordinates alone makes [N]: no iteration gets below it. It counts
/// where stiff material meets small cells.
double ReferenceTissue::rounding() const {
  constexpr double kUlp = 0x1p-53;
  double squares = 0;
  for (std::size_t i = 0; i < body_blocks_.size(); ++i) {
    const double force = kUlp * trial_x_[i].norm() * body_blocks_[i].diagonal().maxCoeff();
    if (model_->unknown[i] >= 0) squares += force * force;
  }
  return 4 * std::sqrt(squares);
}

/// Stiffness of contact, friction and springs at the trial, per node [N/m].
std::vector<Matrix3d> ReferenceTissue::node_blocks(const Terms& terms) const {
  std::vector<Matrix3d> sum(model_->nodes.size(), Matrix3d::Zero());
  const auto add = [&sum](int node, const Matrix3d& block) { sum[node] += block; };
  contact_stiffness(terms, add);
  effects_.for_each_force(trial_x_, [&](int node, double, const Vector3d&, const Matrix3d& block) {
    add(node, block);
  });
  for (std::size_t k = 0; has_pad() && k < grasp_->pad_node.size(); ++k)
    add(grasp_->pad_node[k], grasp_->pad_stiffness[k] * Matrix3d::Identity());
  return sum;
}

/// Carries the factor of the last step over, or makes it again after load(). False without one.
bool ReferenceTissue::carry_factor() {
  kept_ = 0;
  if (!tangent_.usable) return false;
  if (!factored_) {
    assemble();
    factored_ = factor_.factor();
    constrained_ = false;
  }
  tangent_.usable = factored_ && (constrained_ || prepare_constraint());
  return tangent_.usable;
}

/// Newton step of nodes and parabolas with the factor there is.
bool ReferenceTissue::newton_direction(const Residual& residual) {
  direction_ = -residual.force;
  Values values{};
  std::array<Pack, 9> mode_force;
  // Parabolas eliminated: f - K_xb K_bb^-1 f_b = f - coupling^T rhs.
  for (std::size_t batch = 0; batch < model_->batches(); ++batch) {
    HexInner& inner = inner_[batch];
    for (int c = 0; c < 9; ++c) {
      for (int lane = 0; lane < elements_in(batch); ++lane)
        values[lane] = -direction_[mode_unknown(Pack::kLanes * batch + lane, c)];
      mode_force[c] = Pack::load(values.data());
    }
    hex_condense(mode_force, inner);
    for (int c = 0; c < 24; ++c) {
      Pack sum;
      for (int r = 0; r < 9; ++r) sum = fma(inner.coupling[24 * r + c], inner.rhs[r], sum);
      for (int lane = 0; lane < elements_in(batch); ++lane) {
        const int row = node_unknown(Pack::kLanes * batch + lane, c);
        if (row >= 0) direction_[row] += sum.lane(lane);
      }
    }
  }

  auto nodes = direction_.head(model_->unknowns);
  factor_.solve_lower(nodes);
  if (grasp_) constrain(residual.miss, nodes);
  factor_.solve_upper(nodes);

  std::array<Pack, 24> dx;
  std::array<Pack, 9> dmode;
  for (std::size_t batch = 0; batch < model_->batches(); ++batch) {
    for (int c = 0; c < 24; ++c) {
      values.fill(0);
      for (int lane = 0; lane < elements_in(batch); ++lane) {
        const int row = node_unknown(Pack::kLanes * batch + lane, c);
        if (row >= 0) values[lane] = direction_[row];
      }
      dx[c] = Pack::load(values.data());
    }
    hex_recover(inner_[batch], dx, dmode);
    for (int c = 0; c < 9; ++c) {
      dmode[c].store(values.data());
      for (int lane = 0; lane < elements_in(batch); ++lane)
        direction_[mode_unknown(Pack::kLanes * batch + lane, c)] = values[lane];
    }
  }
  return direction_.allFinite();
}

/// Sets the trial to (x, mode) plus a step length times the direction. A node whose slip would
/// reverse stops instead, at the kink of the friction law, from where the next iteration sticks or
/// slips in the right direction; plain Newton steps would oscillate. A stopped node has the speed
/// of its rounding: what is a millionth of the slip speed may go anywhere.
void ReferenceTissue::move_trial(const Terms& terms, double length, const Nodes& x,
                                 const Modes& mode) {
  for (std::size_t i = 0; i < x.size(); ++i) {
    const int row = model_->unknown[i];
    if (row >= 0) trial_x_[i] = x[i] + length * direction_.segment<3>(row);
  }
  for (std::size_t e = 0; e < mode.size(); ++e) {
    for (int c = 0; c < 9; ++c)
      trial_mode_[e][c] = mode[e][c] + length * direction_[mode_unknown(e, c)];
  }
  const double still = 1e-6 * terms.slip_speed;
  for (const FrictionPoint& f : friction_) {
    const Vector3d before = slip_velocity(terms, f, x[f.node]);
    const Vector3d after = slip_velocity(terms, f, trial_x_[f.node]);
    if (before.norm() > still && after.dot(before) < 0) trial_x_[f.node] -= terms.beta * after;
  }
}

/// Rounding of the elements' energies [J]: each is a small difference of terms as large as mu.
double ReferenceTissue::energy_rounding() const {
  double volume = 1;
  for (const std::vector<double>& lines : model_->lines) volume *= lines.back() - lines.front();
  return 0x1p-53 * model_->lame.mu * parameters_.stiffness_scale * volume;
}

/// Backtracking line search: halves the step until the potential, with the multipliers of the full
/// step, falls enough (Armijo), or the residual shrinks where the fall is below rounding. False,
/// and the trial unchanged, where no step does.
bool ReferenceTissue::search_line(const Terms& terms, Residual& residual) {
  constexpr double kRounding = 1e-13;  // of a sum over some thousand terms
  const Targets multiplier = trial_multiplier_;
  const Turn turn = trial_turn_;
  if (grasp_) trial_multiplier_ = next_multiplier_;
  evaluate_outside(terms, trial_x_, residual);
  double slope =
      residual.force.dot(direction_) - residual.miss.cwiseProduct(residual.miss_force).sum();
  if (turns()) slope += residual.moment.dot(turn_step_);
  const bool hidden = std::fabs(slope) < kRounding * residual.scale;
  const double rounding = energy_rounding();
  const Nodes x = trial_x_;
  const Modes mode = trial_mode_;
  Residual trial;
  double length = 1;
  for (int attempt = 0; attempt < kMaxLineSearch; ++attempt, length *= 0.5) {
    move_trial(terms, length, x, mode);
    trial_turn_ = turn;
    if (turns()) trial_turn_.add(length * turn_step_);
    evaluate(terms, trial_x_, trial_mode_, trial);
    if (!std::isfinite(trial.energy)) continue;
    const bool shrinks = trial.norm < residual.norm;
    const double change = trial.energy - residual.energy;
    if (hidden ? shrinks
               : change <= 1e-4 * length * slope || (shrinks && std::fabs(change) <= rounding)) {
      std::swap(residual, trial);
      return true;
    }
  }
  trial_x_ = x;
  trial_mode_ = mode;
  trial_multiplier_ = multiplier;
  trial_turn_ = turn;
  evaluate_outside(terms, trial_x_, residual);
  return false;
}

}  // namespace omentum
