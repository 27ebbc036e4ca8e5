#include "sim_worker/reference_tissue.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/rigid_gap.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kStandardGravity = 9.80665;  // [m/s^2]
// Contact pressure per depth [Pa/m] and half width of its smooth start [m]: see the class comment.
// Stiff against the sheet's inertia per area (rho t / h^2, 7500 Pa/m), soft enough for rounding.
constexpr double kContactStiffness = 2e8;
constexpr double kContactStart = 2e-6;
// The friction limit follows the normal force in the first iterations of a step and is then frozen,
// so that the end of the iteration minimises one function: Newton converges quadratically there.
constexpr int kFrictionUpdates = 6;
constexpr int kMaxHalvings = 5;
constexpr int kMaxLineSearch = 14;
constexpr int kMaxShifts = 8;

struct Pressure {
  double energy, force, stiffness;
};

// Spring of unit stiffness whose force starts smoothly (C1) at depth -s: u = depth + s,
// u^2 / (4 s) up to u = 2 s, then u - s, which is the depth itself.
Pressure contact_pressure(double gap) {
  constexpr double s = kContactStart;
  const double u = s - gap;
  if (!(u > 0)) return {0, 0, 0};
  if (u < 2 * s) return {u * u * u / (12 * s), u * u / (4 * s), u / (2 * s)};
  return {0.5 * (u - s) * (u - s) + s * s / 6, u - s, 1};
}

struct FrictionLaw {
  double energy, force, slope;
};

// Share of the friction limit at y = speed / slip speed: 2 y - y^2 below 1, and its integral.
FrictionLaw friction_law(double y) {
  if (y >= 1) return {y - 1.0 / 3, 1, 0};
  return {y * y - y * y * y / 3, 2 * y - y * y, 2 - 2 * y};
}

bool is_finite(const std::vector<Vector3d>& values) {
  return std::all_of(values.begin(), values.end(), [](const Vector3d& v) { return v.allFinite(); });
}

Pack load_pack(const std::array<double, Pack::kLanes>& values) {
  return Pack(_mm256_loadu_pd(values.data()));
}

}  // namespace

ReferenceTissue::ReferenceTissue(std::shared_ptr<const ReferenceTissueModel> model)
    : model_(std::move(model)), factor_(model_->unknowns, model_->bandwidth) {
  inner_.resize((model_->elements.size() + Pack::kLanes - 1) / Pack::kLanes);
  direction_.setZero(model_->unknowns);
  reset(0, Vector3d::Zero());
}

int ReferenceTissue::bodies() const {
  return static_cast<int>(model_->contact_bodies.size()) + (model_->tool_contact ? 1 : 0);
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
  failure_.clear();
}

void ReferenceTissue::set_parameters(int, const LaneParameters& parameters) {
  parameters_ = parameters;
}

void ReferenceTissue::step(std::span<const ToolMotion> motion) {
  OMENTUM_CHECK(motion.size() == 1);
  const int substeps = static_cast<int>(model_->substeps());
  for (int k = 0; k < substeps && failure_.empty(); ++k) {
    advance(motion[0], static_cast<double>(k) / substeps, (k + 1.0) / substeps, 0);
  }
}

/// One implicit step over the shares from ... to of the control step, in halves where it does not
/// converge.
bool ReferenceTissue::advance(const ToolMotion& motion, double from, double to, int depth) {
  const State start = state_;
  const Terms terms = make_terms(motion, from, to);
  ++implicit_steps_;
  if (solve(terms)) {
    finish(terms);
    return true;
  }
  state_ = start;
  if (depth == kMaxHalvings) {
    failure_ = fmt::format("Newton did not converge in {} iterations with a step of {:.3g} s",
                           model_->numerics.max_newton(), terms.h);
    return false;
  }
  const double middle = 0.5 * (from + to);
  return advance(motion, from, middle, depth + 1) && advance(motion, middle, to, depth + 1);
}

// BDF2 with steps h and h0 = h / r:  x = x~ + beta v,  v = v~ + beta a  where
//   x~ = (1 + r)^2 / (1 + 2 r) x_n - r^2 / (1 + 2 r) x_{n-1},   beta = h (1 + r) / (1 + 2 r).
// Without history r = 0: backward Euler.
ReferenceTissue::Terms ReferenceTissue::make_terms(const ToolMotion& motion, double from,
                                                   double to) const {
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
  terms.tip = motion.from + to * (motion.to - motion.from);
  terms.tool_velocity = (motion.to - motion.from) / model_->control_period;
  if (grasp_) {
    terms.target = grasp_->offset;
    terms.target.col(0) += terms.tip;
  }
  return terms;
}

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
  for (int iteration = 0; iteration < static_cast<int>(model_->numerics.max_newton());
       ++iteration) {
    if (iteration > 0 && residual.norm <= tolerance) return true;
    ++newton_iterations_;
    if (!newton_direction(terms, residual) || !search_line(terms, residual)) return false;
    if (iteration < kFrictionUpdates && !friction_.empty()) {
      update_friction(terms, trial_x_);
      evaluate(terms, trial_x_, trial_bubble_, residual);
    }
  }
  return residual.norm <= tolerance;
}

void ReferenceTissue::finish(const Terms& terms) {
  std::swap(state_.x_before, state_.x);
  std::swap(state_.v_before, state_.v);
  state_.step_before = terms.h;
  state_.x = trial_x_;
  state_.bubble = trial_bubble_;
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    if (model_->unknown[i] >= 0) state_.v[i] = (state_.x[i] - terms.x_tilde[i]) / terms.beta;
  }
  held_force_.setZero();
  if (grasp_) {
    held_force_ = (patch_rows(state_.x) - terms.target).col(0) / model_->grasp_compliance;
  }
  std::fill(contact_forces_.begin(), contact_forces_.end(), Vector3d::Zero());
  std::vector<Contact> contacts;
  find_contacts(terms, state_.x, contacts);
  for (const Contact& c : contacts)
    contact_forces_[static_cast<std::size_t>(c.body)] += c.force * c.normal;
  const double slip = model_->numerics.friction_slip_speed_m_per_s();
  for (const FrictionPoint& f : friction_) {
    const Vector3d v = slip_velocity(terms, f, state_.x[static_cast<std::size_t>(f.node)]);
    const double speed = v.norm();
    if (speed > 0)
      contact_forces_[static_cast<std::size_t>(f.body)] -=
          f.limit * friction_law(speed / slip).force / speed * v;
  }
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
  shape.mu = Pack(model_->lame.mu * parameters_.stiffness_scale);
  shape.lambda = Pack(model_->lame.lambda * parameters_.stiffness_scale);
  return shape;
}

void ReferenceTissue::find_contacts(const Terms& terms, const Nodes& x,
                                    std::vector<Contact>& contacts) const {
  contacts.clear();
  const int rigid = static_cast<int>(model_->contact_bodies.size());
  const Vector3d shaft = terms.tip + model_->tool_start * model_->shaft_axis;
  const Vector3d shaft_end = shaft + model_->tool_length * model_->shaft_axis;
  for (const FaceNode& face : model_->face_nodes) {
    for (int body = 0; body < bodies(); ++body) {
      const Vector3d& p = x[static_cast<std::size_t>(face.node)];
      const Gap gap = body < rigid
                          ? rigid_gap(model_->contact_bodies[static_cast<std::size_t>(body)], p)
                          : capsule_gap(shaft, shaft_end, model_->tool_radius, p);
      const Pressure pressure = contact_pressure(gap.distance);
      if (!(pressure.force > 0)) continue;
      const double k = kContactStiffness * face.area;
      contacts.push_back({face.node, body, gap.normal, k * pressure.force, k * pressure.stiffness,
                          k * pressure.energy});
    }
  }
}

void ReferenceTissue::update_friction(const Terms& terms, const Nodes& x) {
  friction_.clear();
  std::vector<Contact> contacts;
  find_contacts(terms, x, contacts);
  const double slip = model_->numerics.friction_slip_speed_m_per_s();
  for (const Contact& c : contacts) {
    FrictionPoint point;
    point.node = c.node;
    point.body = c.body;
    point.normal = c.normal;
    const bool is_tool = c.body == static_cast<int>(model_->contact_bodies.size());
    point.body_velocity = is_tool ? terms.tool_velocity : Vector3d::Zero();
    Vector3d v = state_.v[static_cast<std::size_t>(c.node)] - point.body_velocity;
    v -= v.dot(c.normal) * c.normal;
    const double mu = v.norm() > slip ? model_->dynamic_friction : model_->static_friction;
    point.limit = mu * parameters_.friction_scale * c.force;
    if (point.limit > 0) friction_.push_back(point);
  }
}

/// Velocity of the node at x along the surface it touches.
Vector3d ReferenceTissue::slip_velocity(const Terms& terms, const FrictionPoint& point,
                                        const Vector3d& x) {
  const Vector3d v =
      (x - terms.x_tilde[static_cast<std::size_t>(point.node)]) / terms.beta - point.body_velocity;
  return v - v.dot(point.normal) * point.normal;
}

ReferenceTissue::Targets ReferenceTissue::patch_rows(const Nodes& x) const {
  Targets rows = Targets::Zero();
  const GraspPatch& patch = grasp_->patch;
  for (std::size_t k = 0; k < patch.node.size(); ++k) {
    rows +=
        x[static_cast<std::size_t>(patch.node[k])] * patch.weight.row(static_cast<Eigen::Index>(k));
  }
  return rows;
}

/// Incremental potential of the step and its derivative. Where the nodes are clamped nothing is
/// counted.
void ReferenceTissue::evaluate(const Terms& terms, const Nodes& x, const Bubbles& bubble,
                               Residual& out) const {
  out.energy = 0;
  out.scale = 0;
  out.force.setZero(model_->unknowns);
  out.bubble_force.resize(bubble.size());
  const auto add = [&](int node, const Vector3d& force) {
    const int row = model_->unknown[static_cast<std::size_t>(node)];
    if (row >= 0) out.force.segment<3>(row) += force;
  };

  const auto count_energy = [&out](double energy) {
    out.energy += energy;
    out.scale += std::fabs(energy);
  };

  HexForce hex;
  std::array<double, Pack::kLanes> lanes{};
  for (std::size_t batch = 0; batch < inner_.size(); ++batch) {
    hex_force(model_->material.law(), gather(batch, x, bubble), hex);
    const std::size_t first = Pack::kLanes * batch;
    const std::size_t count = std::min<std::size_t>(Pack::kLanes, model_->elements.size() - first);
    hex.energy.store(lanes.data());
    for (std::size_t lane = 0; lane < count; ++lane) count_energy(lanes[lane]);
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
  const Vector3d g = parameters_.gravity_scale * model_->gravity;
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (model_->unknown[i] < 0) continue;
    const Vector3d d = x[i] - terms.x_tilde[i];
    const Vector3d drive = terms.v_tilde[i] / beta + g;
    count_energy(model_->mass[i] * (0.5 * inertia * d.squaredNorm() - drive.dot(d)));
    add(static_cast<int>(i), model_->mass[i] * (inertia * d - drive));
  }

  std::vector<Contact> contacts;
  find_contacts(terms, x, contacts);
  for (const Contact& c : contacts) {
    count_energy(c.energy);
    add(c.node, -c.force * c.normal);
  }
  const double slip = model_->numerics.friction_slip_speed_m_per_s();
  for (const FrictionPoint& f : friction_) {
    const Vector3d v = slip_velocity(terms, f, x[static_cast<std::size_t>(f.node)]);
    const double speed = v.norm();
    const FrictionLaw law = friction_law(speed / slip);
    count_energy(f.limit * beta * slip * law.energy);
    if (speed > 0) add(f.node, f.limit * law.force / speed * v);
  }

  if (grasp_) {
    const Targets miss = patch_rows(x) - terms.target;
    const Targets force = miss / model_->grasp_compliance;
    count_energy(0.5 * miss.cwiseProduct(force).sum());
    const GraspPatch& patch = grasp_->patch;
    for (std::size_t k = 0; k < patch.node.size(); ++k)
      add(patch.node[k], force * patch.weight.row(static_cast<Eigen::Index>(k)).transpose());
  }

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
  std::vector<Contact> contacts;
  find_contacts(terms, trial_x_, contacts);
  for (const Contact& c : contacts) {
    const int row = model_->unknown[static_cast<std::size_t>(c.node)];
    add_block(row, row, c.stiffness * c.normal * c.normal.transpose());
  }
  const double slip = model_->numerics.friction_slip_speed_m_per_s();
  for (const FrictionPoint& f : friction_) {
    const auto i = static_cast<std::size_t>(f.node);
    const Matrix3d tangential = Matrix3d::Identity() - f.normal * f.normal.transpose();
    const Vector3d v = slip_velocity(terms, f, trial_x_[i]);
    const double speed = v.norm();
    const FrictionLaw law = friction_law(speed / slip);
    Matrix3d block = 2 / slip * tangential;  // limit at rest
    if (speed > 1e-6 * slip) {
      const Vector3d along = v / speed;
      block = law.force / speed * (tangential - along * along.transpose()) +
              law.slope / slip * along * along.transpose();
    }
    add_block(model_->unknown[i], model_->unknown[i], f.limit / beta * block);
  }
}

/// Newton step of nodes and parabolas. With C the rows of the grasp and c its compliance the matrix
/// is A + C^T C / c; by Woodbury's identity, with A = L L^T, Y = L^-1 C^T, y = -L^-1 force:
/// dx = L^-T (y - Y (c I + Y^T Y)^-1 Y^T y).
bool ReferenceTissue::newton_direction(const Terms& terms, const Residual& residual) {
  double shift = 0;
  assemble(terms, shift);
  for (int attempt = 0; !factor_.factor(); ++attempt) {
    if (attempt == kMaxShifts) return false;
    shift = shift == 0 ? 1 : 10 * shift;
    assemble(terms, shift);
  }
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
  if (grasp_) {
    const GraspPatch& patch = grasp_->patch;
    constexpr int kColumns = 3 * GraspPatch::kRows;
    MatrixXd Y = MatrixXd::Zero(model_->unknowns, kColumns);
    int top = model_->unknowns;
    for (std::size_t k = 0; k < patch.node.size(); ++k) {
      const int row = model_->unknown[static_cast<std::size_t>(patch.node[k])];
      if (row < 0) continue;
      top = std::min(top, row);
      for (int r = 0; r < GraspPatch::kRows; ++r) {
        for (int axis = 0; axis < 3; ++axis)
          Y(row + axis, 3 * r + axis) += patch.weight(static_cast<Eigen::Index>(k), r);
      }
    }
    factor_.solve_lower(Y, std::min(top, model_->unknowns - 1));
    MatrixXd S = Y.transpose() * Y;
    S.diagonal().array() += model_->grasp_compliance;
    const VectorXd multipliers = S.ldlt().solve(Y.transpose() * direction_);
    direction_ -= Y * multipliers;
  }
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

// ---- grasp ------------------------------------------------------------------------------------

/// Rest coordinates of the mid-surface point nearest to the tip and its distance: Gauss-Newton on
/// the bilinear mid-surface from the nearest particle. Nothing where that is clamped.
std::optional<std::pair<Vector2d, double>> ReferenceTissue::nearest_point(
    const Vector3d& tip) const {
  std::array<Nearest, 1> nearest{};
  find_nearest(std::array<Vector3d, 1>{tip}, nearest);
  const auto at = [&](const Vector2d& X) {
    const BodyPoint::Share share = model_->locate({X.x(), X.y(), 0}).shares.front();
    const ReferenceElement& element = model_->elements[static_cast<std::size_t>(share.element)];
    const std::array<double, 8> N = hex_functions(share.xi);
    Vector3d p = Vector3d::Zero();
    for (int a = 0; a < 8; ++a) p += N[a] * state_.x[static_cast<std::size_t>(element.node[a])];
    return p;
  };
  const Vector2d low(model_->lines[0].front(), model_->lines[1].front());
  const Vector2d high(model_->lines[0].back(), model_->lines[1].back());
  Vector2d X = model_->body.particles[static_cast<std::size_t>(nearest[0].particle)].head<2>();
  Vector3d miss = at(X) - tip;
  constexpr double kDifference = 1e-6;  // [m]: far below an element, far above rounding
  for (int iteration = 0; iteration < 40; ++iteration) {
    Eigen::Matrix<double, 3, 2> J;
    for (int axis = 0; axis < 2; ++axis) {
      Vector2d back = X;
      Vector2d forth = X;
      back[axis] = std::max(low[axis], X[axis] - kDifference);
      forth[axis] = std::min(high[axis], X[axis] + kDifference);
      J.col(axis) = (at(forth) - at(back)) / (forth[axis] - back[axis]);
    }
    const Vector2d d = -(J.transpose() * J).ldlt().solve(J.transpose() * miss);
    double share = 1;
    bool moved = false;
    for (int halving = 0; halving < 20 && !moved; ++halving, share *= 0.5) {
      const Vector2d next = (X + share * d).cwiseMax(low).cwiseMin(high);
      const Vector3d next_miss = at(next) - tip;
      if (!(next_miss.squaredNorm() < miss.squaredNorm())) continue;
      moved = (next - X).norm() > 1e-12;
      X = next;
      miss = next_miss;
    }
    if (!moved) break;
  }
  if (!(X.y() > model_->clamp_edge) && model_->unknown.front() < 0) return std::nullopt;
  return std::make_pair(X, miss.norm());
}

ReferenceTissue::Grasp ReferenceTissue::make_grasp(const Vector2d& centre, double radius) const {
  Grasp grasp;
  grasp.centre = centre;
  grasp.radius = radius;
  grasp.patch = model_->make_patch(centre, radius);
  return grasp;
}

void ReferenceTissue::hold(int, const Vector3d& tip, double radius, bool collapse) {
  release(0);
  const auto nearest = nearest_point(tip);
  if (!nearest || !(nearest->second < radius)) return;
  const double patch_radius = std::sqrt(radius * radius - nearest->second * nearest->second);
  if (!(patch_radius > 1e-5)) return;  // [m]: the sphere only grazes the sheet
  grasp_ = make_grasp(nearest->first, patch_radius);
  grasp_->offset = patch_rows(state_.x);
  grasp_->offset.col(0) -= tip;
  if (collapse) grasp_->offset.col(0).setZero();
}

void ReferenceTissue::release(int) {
  grasp_.reset();
  held_force_.setZero();
}

std::span<const std::int32_t> ReferenceTissue::held(int) const {
  if (!grasp_) return {};
  return grasp_->patch.particles;
}

void ReferenceTissue::shift_held(int, const Vector3d& by) {
  if (grasp_) grasp_->offset.col(0) += by;
}

Vector3d ReferenceTissue::held_force(int) const { return held_force_; }

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
  const Vector3d g = parameters_.gravity_scale * model_->gravity;
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    energy.kinetic += 0.5 * model_->mass[i] * state_.v[i].squaredNorm();
    energy.gravity -= model_->mass[i] * g.dot(state_.x[i]);
  }
  return energy;
}

double ReferenceTissue::penetration() const {
  double depth = 0;
  for (const FaceNode& face : model_->face_nodes) {
    for (const RigidShape& body : model_->contact_bodies) {
      const Vector3d& p = state_.x[static_cast<std::size_t>(face.node)];
      depth = std::max(depth, -rigid_gap(body, p).distance);
    }
  }
  return depth;
}

// ---- saving -------------------------------------------------------------------------------------

// Layout, all doubles: nodes x, v, x_before, v_before; step_before; parabolas; four lane
// parameters; held force; contact forces; 1 if healthy; 1 if holding, then patch centre, radius and
// the targets.
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
  values.push_back(grasp_ ? 1 : 0);
  if (grasp_) {
    values.insert(values.end(), {grasp_->centre.x(), grasp_->centre.y(), grasp_->radius});
    values.insert(values.end(), grasp_->offset.data(),
                  grasp_->offset.data() + grasp_->offset.size());
  }
  return values;
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
  constexpr std::size_t kGraspValues = 3 + 3 * GraspPatch::kRows;
  if (state.size() < base * sizeof(double)) {
    return Failure{fmt::format("reference tissue state of {} bytes, needed at least {}",
                               state.size(), base * sizeof(double))};
  }
  std::vector<double> values(base);
  std::memcpy(values.data(), state.data(), base * sizeof(double));
  const bool holds = values.back() == 1;
  if (holds) {
    if (state.size() < (base + kGraspValues) * sizeof(double)) {
      return Failure{fmt::format("reference tissue state of {} bytes with a grasp, needed {}",
                                 state.size(), (base + kGraspValues) * sizeof(double))};
    }
    values.resize(base + kGraspValues);
    std::memcpy(values.data(), state.data(), values.size() * sizeof(double));
  }
  for (const double v : values) {
    if (!std::isfinite(v)) return Failure{"reference tissue state holds a non-finite number"};
  }
  for (const std::size_t flag : {base - 2, base - 1}) {
    if (values[flag] != 0 && values[flag] != 1)
      return Failure{fmt::format("reference tissue state: flag is {}, allowed 0, 1", values[flag])};
  }
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
  for (double* p : {&parameters_.stiffness_scale, &parameters_.gravity_scale,
                    &parameters_.damping_scale, &parameters_.friction_scale}) {
    take(p, 1);
  }
  take(held_force_.data(), 3);
  for (Vector3d& f : contact_forces_) take(f.data(), 3);
  failure_ = *next == 1 ? "" : "the saved state had failed";
  next += 2;
  grasp_.reset();
  if (holds) {
    grasp_ = make_grasp({next[0], next[1]}, next[2]);
    next += 3;
    take(grasp_->offset.data(), static_cast<std::size_t>(grasp_->offset.size()));
  }
  return values.size() * sizeof(double);
}

std::uint64_t ReferenceTissue::hash(int) const {
  Bytes bytes;
  save(0, bytes);
  return fnv1a64(bytes);
}

}  // namespace omentum
