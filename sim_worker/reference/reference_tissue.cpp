#include "sim_worker/reference/reference_tissue.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kMaxHalvings = 5;

bool is_finite(const std::vector<Vector3d>& values) {
  return std::all_of(values.begin(), values.end(), [](const Vector3d& v) { return v.allFinite(); });
}

constexpr std::size_t kBlockValues = 7;
constexpr std::size_t kEffectValues = sizeof(EffectValues) / sizeof(double);

}  // namespace

ReferenceTissue::ReferenceTissue(std::shared_ptr<const ReferenceTissueModel> model)
    : model_(std::move(model)), effects_(model_), factor_(model_->order) {
  inner_.resize((model_->elements.size() + Pack::kLanes - 1) / Pack::kLanes);
  direction_.setZero(model_->unknowns + 9 * static_cast<Eigen::Index>(model_->elements.size()));
  set_parameters(0, {});
  reset(0, Vector3d::Zero());
}

void ReferenceTissue::reset(int, const Vector3d& offset) {
  release(0);
  const std::size_t n = model_->nodes.size();
  state_.x.resize(n);
  for (std::size_t i = 0; i < n; ++i) state_.x[i] = model_->body.X_WB * model_->nodes[i] + offset;
  state_.v.assign(n, Vector3d::Zero());
  state_.x_before = state_.x;
  state_.v_before = state_.v;
  state_.step_before = 0;
  state_.bubble.assign(model_->elements.size(), {});
  contact_forces_.assign(static_cast<std::size_t>(bodies()), Vector3d::Zero());
  held_force_.setZero();
  effects_.reset(offset);
  failure_.clear();
  tangent_.usable = false;
}

void ReferenceTissue::set_parameters(int, const LaneParameters& parameters) {
  effects_.set(parameters.effects ? *parameters.effects : model_->effects);
  parameters_ = parameters;
  tangent_.usable = false;
  gravity_ =
      parameters_.gravity_scale * tilted_gravity(effects_.values(), model_->surroundings.gravity);
}

void ReferenceTissue::begin_step(std::span<const ToolMotion> motion) {
  motion_ = motion[0];
  slip();
}

void ReferenceTissue::begin_substep(std::span<const ToolMotion> /*motion*/, int substep) {
  substep_ = substep;
}

void ReferenceTissue::solve_substep() {
  const auto substeps = static_cast<double>(model_->substeps());
  if (failure_.empty()) advance(substep_ / substeps, (substep_ + 1.0) / substeps, 0);
}

// Each implicit step ends by itself (finish), since a substep may take several.
void ReferenceTissue::end_substep(bool /*last*/) {}

/// One implicit step over the shares from ... to of the control step, in halves where it does not
/// converge.
bool ReferenceTissue::advance(double from, double to, int depth) {
  const State start = state_;
  const Terms terms = make_terms(from, to);
  ++implicit_steps_;
  effects_.begin(terms.h, state_.x, state_.v, terms.x_tilde, terms.beta);
  const bool carried = tangent_.usable;
  bool solved = solve(terms);
  if (!solved && carried) {  // once more without the factor of the last step
    tangent_.usable = false;
    solved = solve(terms);
  }
  if (solved) {
    finish(terms);
    return true;
  }
  state_ = start;
  tangent_.usable = false;
  if (depth == kMaxHalvings) {
    failure_ = fmt::format("Newton did not converge in {} iterations with a step of {:.3g} s",
                           model_->numerics.max_newton(), terms.h);
    return false;
  }
  const double middle = 0.5 * (from + to);
  return advance(from, middle, depth + 1) && advance(middle, to, depth + 1);
}

// BDF2 with steps h and h0 = h / r:  x = x~ + beta v,  v = v~ + beta a  where
//   x~ = (1 + r)^2 / (1 + 2 r) x_n - r^2 / (1 + 2 r) x_{n-1},   beta = h (1 + r) / (1 + 2 r).
// Without history r = 0: backward Euler.
ReferenceTissue::Terms ReferenceTissue::make_terms(double from, double to) const {
  Terms terms;
  terms.h = (to - from) * model_->control_period;
  const bool second_order =
      model_->numerics.integrator() == pb::INTEGRATOR_BDF2 && state_.step_before > 0;
  const double r = second_order ? terms.h / state_.step_before : 0;
  const double now = (1 + r) * (1 + r) / (1 + 2 * r);
  const double before = r * r / (1 + 2 * r);
  terms.beta = terms.h * (1 + r) / (1 + 2 * r);
  terms.x_tilde.resize(state_.x.size());
  terms.v_tilde.resize(state_.x.size());
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    terms.x_tilde[i] = now * state_.x[i] - before * state_.x_before[i];
    terms.v_tilde[i] = now * state_.v[i] - before * state_.v_before[i];
  }
  terms.tip = motion_.from + to * (motion_.to - motion_.from);
  terms.tool_velocity = (motion_.to - motion_.from) / model_->control_period;
  if (grasp_) {
    terms.target = grasp_->offset;
    terms.target.col(0) += terms.tip;
  }
  return terms;
}

void ReferenceTissue::finish(const Terms& terms) {
  std::swap(state_.x_before, state_.x);
  std::swap(state_.v_before, state_.v);
  state_.step_before = terms.h;
  state_.x = trial_x_;
  state_.bubble = trial_bubble_;
  state_.pull = trial_pull_;
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    if (model_->unknown[i] >= 0) state_.v[i] = (state_.x[i] - terms.x_tilde[i]) / terms.beta;
  }
  held_force_ = state_.pull.col(0);
  effects_.remember(state_.x,
                    [this](std::size_t batch) { return gather(batch, state_.x, state_.bubble); });
  collect_contact_forces(terms);
}

// ---- points -----------------------------------------------------------------------------------

Vector3d ReferenceTissue::point(const BodyPoint& point) const {
  Vector3d p = Vector3d::Zero();
  for (const BodyPoint::Share& share : point.shares) {
    const auto e = static_cast<std::size_t>(share.element);
    const std::array<double, 8> N = hex_functions(share.xi);
    for (int a = 0; a < 8; ++a)
      p += N[a] * state_.x[static_cast<std::size_t>(model_->elements[e].node[a])];
    if (point.fixed) continue;
    for (int k = 0; k < 3; ++k) {
      const double parabola = 1 - share.xi[k] * share.xi[k];
      for (int axis = 0; axis < 3; ++axis) p[axis] += parabola * state_.bubble[e][3 * k + axis];
    }
  }
  return p / static_cast<double>(point.shares.size());
}

Vector3d ReferenceTissue::position(int, int particle) const {
  return point(model_->particle_points[static_cast<std::size_t>(particle)]);
}

Vector3d ReferenceTissue::velocity(int, int particle) const {
  const BodyPoint& point = model_->particle_points[static_cast<std::size_t>(particle)];
  Vector3d v = Vector3d::Zero();
  for (const BodyPoint::Share& share : point.shares) {
    const ReferenceElement& element = model_->elements[static_cast<std::size_t>(share.element)];
    const std::array<double, 8> N = hex_functions(share.xi);
    for (int a = 0; a < 8; ++a) v += N[a] * state_.v[static_cast<std::size_t>(element.node[a])];
  }
  return v / static_cast<double>(point.shares.size());
}

void ReferenceTissue::set_position(int, int particle, const Vector3d& p) {
  move_particle(particle, p - position(0, particle), state_.x);
}

void ReferenceTissue::set_velocity(int, int particle, const Vector3d& v) {
  move_particle(particle, v - velocity(0, particle), state_.v);
}

/// Least change of the nodal field whose interpolation at the particle changes by `by`.
void ReferenceTissue::move_particle(int particle, const Vector3d& by, Nodes& field) {
  const BodyPoint& point = model_->particle_points[static_cast<std::size_t>(particle)];
  std::vector<std::pair<int, double>> weights;  // of free nodes, repeated nodes merged
  for (const BodyPoint::Share& share : point.shares) {
    const std::array<double, 8> N = hex_functions(share.xi);
    for (int a = 0; a < 8; ++a) {
      const int node = model_->elements[static_cast<std::size_t>(share.element)].node[a];
      if (model_->unknown[static_cast<std::size_t>(node)] < 0) continue;
      const double weight = N[a] / static_cast<double>(point.shares.size());
      const auto same = std::find_if(weights.begin(), weights.end(),
                                     [node](const auto& w) { return w.first == node; });
      if (same == weights.end()) {
        weights.emplace_back(node, weight);
      } else {
        same->second += weight;
      }
    }
  }
  double squares = 0;
  for (const auto& [node, weight] : weights) squares += weight * weight;
  if (!(squares > 1e-12)) return;
  for (const auto& [node, weight] : weights)
    field[static_cast<std::size_t>(node)] += weight / squares * by;
  state_.step_before = 0;
}

void ReferenceTissue::set_nodes(const std::function<Vector3d(int node)>& position,
                                const std::function<Vector3d(int node)>& velocity) {
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    if (model_->unknown[i] < 0) continue;
    state_.x[i] = position(static_cast<int>(i));
    state_.v[i] = velocity(static_cast<int>(i));
  }
  state_.step_before = 0;
  state_.bubble.assign(model_->elements.size(), {});
}

void ReferenceTissue::find_nearest(std::span<const Vector3d> points,
                                   std::span<Nearest> nearest) const {
  OMENTUM_CHECK(points.size() == 1 && nearest.size() == 1);
  double least = 0;
  for (int i = 0; i < particles(); ++i) {
    const double distance2 = (position(0, i) - points[0]).squaredNorm();
    if (i == 0 || distance2 < least) {
      least = distance2;
      nearest[0].particle = i;
    }
  }
  nearest[0].distance = std::sqrt(least);
}

const double* ReferenceTissue::surface_positions() {
  surface_.resize(3 * static_cast<std::size_t>(particles()));
  for (int i = 0; i < particles(); ++i) {
    const Vector3d p = position(0, i);
    for (int axis = 0; axis < 3; ++axis) surface_[static_cast<std::size_t>(3 * i + axis)] = p[axis];
  }
  return surface_.data();
}

// ---- what is known about the state
// ---------------------------------------------------------------

bool ReferenceTissue::healthy(int) const {
  return failure_.empty() && is_finite(state_.x) && is_finite(state_.v);
}

ReferenceTissue::Energy ReferenceTissue::energy() const {
  Energy energy;
  HexForce hex;
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    hex_force(model_->material.law(), gather(batch, state_.x, state_.bubble), hex);
    const std::size_t first = Pack::kLanes * batch;
    const std::size_t count = std::min<std::size_t>(Pack::kLanes, model_->elements.size() - first);
    for (std::size_t lane = 0; lane < count; ++lane)
      energy.elastic += hex.energy.lane(static_cast<int>(lane));
  }
  const Vector3d g = gravity_;
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    energy.kinetic += 0.5 * model_->mass[i] * state_.v[i].squaredNorm();
    energy.gravity -= model_->mass[i] * g.dot(state_.x[i]);
  }
  return energy;
}

// ---- saving -------------------------------------------------------------------------------------

// Layout, all doubles: nodes x, v, x_before, v_before; step_before; parabolas; four lane
// parameters; held force; contact forces; 1 if healthy; 1 if holding + 2 if there are effects + 4
// if the next step begins with the factor of the last; when holding patch centre, radius, the
// targets and the pull on them; with effects their values, slip and memory; of the factor's tangent
// inertia, nodes, parabolas, number of blocks, each block with its node before its lower triangle.
std::vector<double> ReferenceTissue::pack_state() const {
  std::vector<double> values;
  for (const Nodes* nodes : {&state_.x, &state_.v, &state_.x_before, &state_.v_before}) {
    for (const Vector3d& p : *nodes) values.insert(values.end(), p.data(), p.data() + 3);
  }
  values.push_back(state_.step_before);
  for (const auto& b : state_.bubble) values.insert(values.end(), b.begin(), b.end());
  values.insert(values.end(), {parameters_.stiffness_scale, parameters_.gravity_scale,
                               parameters_.damping_scale, parameters_.friction_scale});
  values.insert(values.end(), held_force_.data(), held_force_.data() + 3);
  for (const Vector3d& f : contact_forces_) values.insert(values.end(), f.data(), f.data() + 3);
  values.push_back(failure_.empty() ? 1 : 0);
  const bool has_effects = !(effects_.values() == EffectValues{});
  values.push_back((grasp_ ? 1 : 0) + (has_effects ? 2 : 0) + (tangent_.usable ? 4 : 0));
  if (grasp_) {
    values.insert(values.end(), {grasp_->centre.x(), grasp_->centre.y(), grasp_->radius});
    for (const Targets* rows : {&grasp_->offset, &state_.pull})
      values.insert(values.end(), rows->data(), rows->data() + rows->size());
  }
  if (has_effects) {
    const auto* first = reinterpret_cast<const double*>(&effects_.values());
    values.insert(values.end(), first, first + kEffectValues);
    values.push_back(slipped_);
    effects_.save(values);
  }
  if (tangent_.usable) save_tangent(values);
  return values;
}

void ReferenceTissue::save_tangent(std::vector<double>& values) const {
  values.push_back(tangent_.inertia);
  for (const Vector3d& p : tangent_.x) values.insert(values.end(), p.data(), p.data() + 3);
  for (const auto& b : tangent_.bubble) values.insert(values.end(), b.begin(), b.end());
  const auto is_zero = [](const Eigen::Matrix3d& block) { return block.isZero(0); };
  const std::vector<Eigen::Matrix3d>& blocks = tangent_.node_blocks;
  values.push_back(static_cast<double>(blocks.size()) -
                   static_cast<double>(std::count_if(blocks.begin(), blocks.end(), is_zero)));
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    const Eigen::Matrix3d& b = blocks[i];
    if (!is_zero(b)) {
      values.insert(values.end(),
                    {static_cast<double>(i), b(0, 0), b(1, 0), b(1, 1), b(2, 0), b(2, 1), b(2, 2)});
    }
  }
}

void ReferenceTissue::load_tangent(const double* next) {
  const auto take = [&next](double* to, std::size_t count) {
    std::copy(next, next + count, to);
    next += count;
  };
  take(&tangent_.inertia, 1);
  tangent_.x.resize(state_.x.size());
  for (Vector3d& p : tangent_.x) take(p.data(), 3);
  tangent_.bubble.resize(state_.bubble.size());
  for (auto& b : tangent_.bubble) take(b.data(), b.size());
  tangent_.node_blocks.assign(state_.x.size(), Eigen::Matrix3d::Zero());
  const auto count = static_cast<std::size_t>(*next++);
  for (std::size_t k = 0; k < count; ++k, next += kBlockValues) {
    tangent_.node_blocks[static_cast<std::size_t>(next[0])] << next[1], next[2], next[4], next[2],
        next[3], next[5], next[4], next[5], next[6];
  }
  tangent_.usable = true;
}

void ReferenceTissue::save(int, Bytes& out) const {
  const std::vector<double> values = pack_state();
  const auto bytes = std::as_bytes(std::span<const double>(values));
  out.insert(out.end(), bytes.begin(), bytes.end());
}

Result<std::size_t> ReferenceTissue::load(int, std::span<const std::byte> state) {
  const std::size_t n = state_.x.size();
  const std::size_t base =
      12 * n + 1 + 9 * state_.bubble.size() + 4 + 3 + 3 * contact_forces_.size() + 2;
  constexpr std::size_t kGraspValues = 3 + 2 * 3 * GraspPatch::kRows;
  if (state.size() < base * sizeof(double)) {
    return Failure{fmt::format("reference tissue state of {} bytes, needed at least {}",
                               state.size(), base * sizeof(double))};
  }
  std::vector<double> values(base);
  std::memcpy(values.data(), state.data(), base * sizeof(double));
  const double kind = values.back();
  if (!(kind >= 0 && kind <= 7 && kind == std::floor(kind)))
    return Failure{fmt::format("reference tissue state: kind is {}, allowed 0 ... 7", kind)};
  const bool holds = (static_cast<int>(kind) & 1) != 0;
  const bool has_effects = (static_cast<int>(kind) & 2) != 0;
  const bool has_tangent = (static_cast<int>(kind) & 4) != 0;
  const auto grow = [&](std::size_t by) {
    if (state.size() < (values.size() + by) * sizeof(double)) return false;
    values.resize(values.size() + by);
    std::memcpy(values.data(), state.data(), values.size() * sizeof(double));
    return true;
  };
  if (holds && !grow(kGraspValues)) {
    return Failure{fmt::format("reference tissue state of {} bytes with a grasp, needed {}",
                               state.size(), (base + kGraspValues) * sizeof(double))};
  }
  LaneParameters parameters;
  parameters.effects = EffectValues{};
  const std::size_t effects_at = values.size();
  if (has_effects) {
    if (!grow(kEffectValues + 1)) return Failure{"reference tissue state ends in its effects"};
    std::memcpy(static_cast<void*>(&*parameters.effects), &values[effects_at],
                sizeof(EffectValues));
    if (!usable(*parameters.effects, model_->material.poisson_ratio(), model_->body.particles))
      return Failure{"reference tissue state holds effects out of range"};
    if (!grow(effects_.saved_size(*parameters.effects)))
      return Failure{"reference tissue state ends in the memory of its effects"};
  }
  if (!effects_.fits(*parameters.effects))
    return Failure{"reference tissue state holds effects of another mesh"};
  const std::size_t tangent_at = values.size();
  if (has_tangent) {
    if (!grow(1 + 3 * n + 9 * state_.bubble.size() + 1))
      return Failure{"reference tissue state ends in its tangent"};
    const double count = values.back();
    if (!(count >= 0 && count <= static_cast<double>(n)) ||
        !grow(kBlockValues * static_cast<std::size_t>(count)))
      return Failure{"reference tissue state ends in the blocks of its tangent"};
    for (std::size_t at = values.size() - kBlockValues * static_cast<std::size_t>(count);
         at < values.size(); at += kBlockValues) {
      if (!(values[at] >= 0 && values[at] < static_cast<double>(n)))
        return Failure{fmt::format("reference tissue state: block of node {}", values[at])};
    }
  }
  for (const double v : values) {
    if (!std::isfinite(v)) return Failure{"reference tissue state holds a non-finite number"};
  }
  if (values[base - 2] != 0 && values[base - 2] != 1)
    return Failure{
        fmt::format("reference tissue state: flag is {}, allowed 0, 1", values[base - 2])};
  if (!(values[12 * n] >= 0))
    return Failure{fmt::format("reference tissue state: last step {} s", values[12 * n])};
  if (holds) {
    const double* grasp = &values[base];
    const bool inside = grasp[0] >= model_->lines[0].front() &&
                        grasp[0] <= model_->lines[0].back() && grasp[1] >= model_->clamp_edge &&
                        grasp[1] <= model_->lines[1].back();
    if (!inside || !(grasp[2] > 0 && grasp[2] <= 1)) {
      return Failure{fmt::format("reference tissue state: patch at ({}, {}) m of radius {} m",
                                 grasp[0], grasp[1], grasp[2])};
    }
  }

  const double* next = values.data();
  const auto take = [&next](double* to, std::size_t count) {
    std::copy(next, next + count, to);
    next += count;
  };
  for (Nodes* nodes : {&state_.x, &state_.v, &state_.x_before, &state_.v_before}) {
    for (Vector3d& p : *nodes) take(p.data(), 3);
  }
  take(&state_.step_before, 1);
  for (auto& b : state_.bubble) take(b.data(), b.size());
  for (double* p : {&parameters.stiffness_scale, &parameters.gravity_scale,
                    &parameters.damping_scale, &parameters.friction_scale}) {
    take(p, 1);
  }
  set_parameters(0, parameters);
  if (has_effects) {
    slipped_ = values[effects_at + kEffectValues];
    effects_.load(std::span(values).subspan(effects_at + kEffectValues + 1));
  }
  take(held_force_.data(), 3);
  for (Vector3d& f : contact_forces_) take(f.data(), 3);
  failure_ = *next == 1 ? "" : "the saved state had failed";
  next += 2;
  grasp_.reset();
  state_.pull.setZero();
  if (!has_effects) slipped_ = 0;
  if (holds) {
    grasp_ = make_grasp({next[0], next[1]}, next[2]);
    next += 3;
    for (Targets* rows : {&grasp_->offset, &state_.pull})
      take(rows->data(), static_cast<std::size_t>(rows->size()));
  }
  factored_ = constrained_ = false;
  if (has_tangent) load_tangent(&values[tangent_at]);
  return values.size() * sizeof(double);
}

std::uint64_t ReferenceTissue::hash(int) const {
  Bytes bytes;
  save(0, bytes);
  return fnv1a64(bytes);
}

}  // namespace omentum
