#include "sim_worker/reference/reference_tissue.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kMaxHalvings = 5;

bool is_finite(const std::vector<Vector3d>& values) {
  return std::all_of(values.begin(), values.end(), [](const Vector3d& v) { return v.allFinite(); });
}

}  // namespace

ReferenceTissue::ReferenceTissue(std::shared_ptr<const ReferenceTissueModel> model)
    : model_(std::move(model)), effects_(model_), factor_(model_->order) {
  set_parameters(0, {});
  reset(0, Vector3d::Zero());
}

void ReferenceTissue::reset(int, const Vector3d& offset) {
  release(0);
  offset_ = offset;
  const std::size_t n = model_->nodes.size();
  state_.x.resize(n);
  for (std::size_t i = 0; i < n; ++i) state_.x[i] = model_->body.X_WB * model_->nodes[i] + offset;
  state_.v.assign(n, Vector3d::Zero());
  state_.x_before = state_.x;
  state_.v_before = state_.v;
  state_.step_before = 0;
  state_.mode.assign(model_->elements.size(), {});
  contact_forces_.assign(bodies(), Vector3d::Zero());
  held_force_.setZero();
  effects_.reset(offset);
  failure_.clear();
  tangent_.usable = false;
  if (columns_) carry_columns(columns_->parameters);
}

void ReferenceTissue::set_parameters(int, const LaneParameters& parameters) {
  effects_.set(parameters.effects ? *parameters.effects : model_->effects);
  parameters_ = parameters;
  tangent_.usable = false;
  gravity_ =
      parameters_.gravity_scale * tilted_gravity(effects_.values(), model_->surroundings.gravity);
  for_each_follower([&](ReferenceTissue& follower) {
    LaneParameters own = parameters;
    own.effects = follower.model_->effects;
    follower.set_parameters(0, own);
  });
}

void ReferenceTissue::begin_step(std::span<const ToolMotion> motion) {
  motion_ = motion[0];
  slip();
  for_each_follower([&](ReferenceTissue& follower) {
    follower.follow(*this);
    follower.begin_step(motion);
  });
}

void ReferenceTissue::begin_substep(std::span<const ToolMotion> /*motion*/, int substep) {
  substep_ = substep;
}

void ReferenceTissue::solve_substep() {
  const double substeps = model_->substeps();
  if (failure_.empty()) advance(substep_ / substeps, (substep_ + 1.0) / substeps, 0);
}

// A substep may take several implicit steps; each ends in finish().
void ReferenceTissue::end_substep(bool /*last*/) {}

/// One implicit step over the fractions from ... to of the control step, in halves where it does
/// not converge.
bool ReferenceTissue::advance(double from, double to, int depth) {
  const State start = state_;
  const Terms terms = make_terms(from, to);
  pad_centre_ = terms.target.col(0);
  // The pose of jaws that turn is that of the start of the step.
  if (has_pad() || effects_.values().grasp_turn > 0) constrained_ = false;
  ++implicit_steps_;
  effects_.begin(terms.h, state_.x, state_.v, terms.x_tilde, terms.beta);
  bool solved = solve(terms, true);
  if (!solved) {  // once more from where the tissue is, without the factor of the last step
    tangent_.usable = false;
    solved = solve(terms, false);
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
  terms.end = to;
  terms.slip_speed = friction_smoothing_ * model_->numerics.friction_slip_speed_m_per_s();
  terms.now = now;
  terms.before = before;
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

/// No speed, and no history that a second-order step would take one from.
void ReferenceTissue::stop() {
  for (Nodes* speeds : {&state_.v, &state_.v_before})
    std::fill(speeds->begin(), speeds->end(), Vector3d::Zero());
  state_.x_before = state_.x;
  state_.step_before = 0;
  if (!columns_) return;
  columns_->v.setZero();
  columns_->v_before.setZero();
  columns_->x_before = columns_->x;
}

// Steps of backward Euler, each from rest: what oscillates with angular frequency w is nearer to
// rest by 1 / (1 + (w h)^2) after each. Long ones where the tissue allows them: it may fall first.
double ReferenceTissue::settle(const Vector3d& tip) {
  constexpr double kLongest = 1, kShortest = 1e-4;  // [s]
  constexpr double kSpeed = 1e-5;                   // [m/s] friction of slow tissue creeps
  constexpr double kMostSmoothing = 1e4;
  constexpr int kMaxSteps = 1000;
  motion_ = {tip, tip};
  stop_clock(0, true);
  double h = model_->substep();
  double speed = 0;
  for (int step = 0; step < kMaxSteps && h >= kShortest; ++step) {
    stop();
    failure_.clear();
    const Nodes before = state_.x;
    if (!advance(0, h / model_->control_period, kMaxHalvings)) {
      h /= 4;
      // Large cells may not come to rest under sharp friction. Where nothing moves there is none,
      // however smooth it is, so the way there may be smoother.
      if (h < kShortest && friction_smoothing_ < kMostSmoothing) {
        friction_smoothing_ *= 10;
        h = model_->substep();
      }
      continue;
    }
    speed = 0;
    for (std::size_t i = 0; i < before.size(); ++i)
      speed = std::max(speed, (state_.x[i] - before[i]).norm() / h);
    if (speed <= kSpeed && h == kLongest) break;
    h = std::min(1.5 * h, kLongest);
  }
  friction_smoothing_ = 1;
  stop();
  stop_clock(0, false);
  return speed;
}

void ReferenceTissue::start_moving(const Vector3d& velocity) {
  for (std::size_t i = 0; i < state_.v.size(); ++i) {
    if (model_->unknown[i] >= 0) state_.v[i] = velocity;
  }
  state_.step_before = 0;
  if (!columns_) return;
  for (Eigen::Index k = 0; k < columns_->count(); ++k) {
    const ColumnParameter& p = columns_->parameters[k];
    if (p.kind != ColumnKind::kStartVelocity) continue;
    for (const int row : model_->unknown) {
      if (row >= 0) columns_->v(row + p.axis, k) = 1;
    }
  }
  for_each_follower([&](ReferenceTissue& follower) { follower.start_moving(velocity); });
}

void ReferenceTissue::stop_clock(int, bool stopped) {
  effects_.stop_clock(stopped);
  for_each_follower([stopped](ReferenceTissue& follower) { follower.stop_clock(0, stopped); });
}

void ReferenceTissue::finish(const Terms& terms) {
  if (columns_) advance_columns(terms);
  std::swap(state_.x_before, state_.x);
  std::swap(state_.v_before, state_.v);
  state_.step_before = terms.h;
  state_.x = trial_x_;
  state_.mode = trial_mode_;
  state_.multiplier = trial_multiplier_;
  state_.turn = trial_turn_;
  if (has_pad()) remember_pad(terms);
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    if (model_->unknown[i] >= 0) state_.v[i] = (state_.x[i] - terms.x_tilde[i]) / terms.beta;
  }
  held_force_ = state_.multiplier.col(0);
  effects_.remember(state_.x,
                    [this](std::size_t batch) { return gather(batch, state_.x, state_.mode); });
  collect_contact_forces(terms);
}

/// Four elements; the last batch repeats its last element.
HexShape ReferenceTissue::gather(std::size_t batch, const Nodes& x, const Modes& mode) const {
  std::array<std::size_t, Pack::kLanes> index{};
  std::array<const ReferenceElement*, Pack::kLanes> element{};
  for (int lane = 0; lane < Pack::kLanes; ++lane) {
    index[lane] = std::min(Pack::kLanes * batch + lane, model_->elements.size() - 1);
    element[lane] = &model_->elements[index[lane]];
  }
  const auto pack = [](const auto& value_of) {
    std::array<double, Pack::kLanes> values{};
    for (int lane = 0; lane < Pack::kLanes; ++lane) values[lane] = value_of(lane);
    return Pack::load(values.data());
  };
  HexShape shape;
  for (int c = 0; c < 24; ++c)
    shape.x[c] = pack([&](int lane) { return x[element[lane]->node[c / 3]][c % 3]; });
  for (int k = 0; k < 9; ++k) shape.mode[k] = pack([&](int lane) { return mode[index[lane]][k]; });
  for (int axis = 0; axis < 3; ++axis)
    shape.size[axis] = pack([&](int lane) { return element[lane]->size[axis]; });
  shape.mu = Pack(model_->lame.mu * parameters_.stiffness_scale);
  shape.lambda = Pack(model_->lame.lambda * parameters_.stiffness_scale);
  if (!model_->stiffness.empty()) shape.stiffness = &model_->stiffness[batch];
  shape.effects = effects_.of_batch(batch);
  return shape;
}

// ---- points -----------------------------------------------------------------------------------

std::array<Vector3d, 8> ReferenceTissue::nodes_of(int element) const {
  std::array<Vector3d, 8> x;
  for (int a = 0; a < 8; ++a) x[a] = state_.x[model_->elements[element].node[a]];
  return x;
}

Vector3d ReferenceTissue::point(const BodyPoint& point) const {
  Vector3d p = Vector3d::Zero();
  for (const BodyPoint::Location& at : point.locations) {
    const std::array<double, 8> N = hex_functions(at.xi);
    const std::array<Vector3d, 8> x = nodes_of(at.element);
    for (int a = 0; a < 8; ++a) p += N[a] * x[a];
    if (point.fixed) continue;
    const Vector3d& size = model_->elements[at.element].size;
    p += HexBow(size, x, state_.mode[at.element], at.xi).value();
  }
  return p / static_cast<double>(point.locations.size());
}

Vector3d ReferenceTissue::position(int, int particle) const {
  return point(model_->particle_points[particle]);
}

Vector3d ReferenceTissue::velocity(int, int particle) const {
  return point_velocity(model_->particle_points[particle]);
}

Vector3d ReferenceTissue::point_velocity(const BodyPoint& point) const {
  Vector3d v = Vector3d::Zero();
  for (const BodyPoint::Location& at : point.locations) {
    const ReferenceElement& element = model_->elements[at.element];
    const std::array<double, 8> N = hex_functions(at.xi);
    for (int a = 0; a < 8; ++a) v += N[a] * state_.v[element.node[a]];
  }
  return v / static_cast<double>(point.locations.size());
}

void ReferenceTissue::set_position(int, int particle, const Vector3d& p) {
  move_particle(particle, p - position(0, particle), state_.x);
}

void ReferenceTissue::set_velocity(int, int particle, const Vector3d& v) {
  move_particle(particle, v - velocity(0, particle), state_.v);
}

/// Least change of the nodal field whose interpolation at the particle changes by `by`.
void ReferenceTissue::move_particle(int particle, const Vector3d& by, Nodes& field) {
  const BodyPoint& point = model_->particle_points[particle];
  std::vector<std::pair<int, double>> weights;  // of free nodes
  for (const BodyPoint::Location& at : point.locations) {
    const std::array<double, 8> N = hex_functions(at.xi);
    for (int a = 0; a < 8; ++a) {
      const int node = model_->elements[at.element].node[a];
      if (model_->unknown[node] < 0) continue;
      auto same = std::ranges::find(weights, node, &std::pair<int, double>::first);
      if (same == weights.end()) same = weights.insert(same, {node, 0});
      same->second += N[a] / static_cast<double>(point.locations.size());
    }
  }
  double squares = 0;
  for (const auto& [node, weight] : weights) squares += weight * weight;
  if (!(squares > 1e-12)) return;
  for (const auto& [node, weight] : weights) field[node] += weight / squares * by;
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
  state_.mode.assign(model_->elements.size(), {});
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
  surface_.resize(3 * particles());
  for (int i = 0; i < particles(); ++i) Vector3d::Map(&surface_[3 * i]) = position(0, i);
  return surface_.data();
}

bool ReferenceTissue::healthy(int) const {
  return failure_.empty() && is_finite(state_.x) && is_finite(state_.v);
}

std::string ReferenceTissue::failure(int lane) const {
  return failure_.empty() ? Tissue<double>::failure(lane) : failure_;
}

ReferenceTissue::Energy ReferenceTissue::energy() const {
  Energy energy;
  HexForce hex;
  for (std::size_t batch = 0; batch < model_->batches(); ++batch) {
    hex_force(model_->material.law(), gather(batch, state_.x, state_.mode), hex);
    for (int lane = 0; lane < elements_in(batch); ++lane) energy.elastic += hex.energy.lane(lane);
  }
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    energy.kinetic += 0.5 * model_->mass[i] * state_.v[i].squaredNorm();
    energy.gravity -= model_->mass[i] * gravity_.dot(state_.x[i]);
  }
  return energy;
}

}  // namespace omentum
