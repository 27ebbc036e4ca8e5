// Contact and friction of the reference solid: see the class comment of ReferenceTissue.
#include <algorithm>
#include <cmath>
#include <utility>

#include "sim_worker/geometry/rigid_gap.h"
#include "sim_worker/reference/reference_tissue.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Half width of the smooth start of contact [m].
constexpr double kContactStart = 2e-6;

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

// Friction over its limit at y = speed / slip speed: 2 y - y^2 below 1; its integral and slope.
FrictionLaw friction_law(double y) {
  if (y >= 1) return {y - 1.0 / 3, 1, 0};
  return {y * y - y * y * y / 3, 2 * y - y * y, 2 - 2 * y};
}

/// The contact of a node with a body in a list sorted by node and body, from `next` on, which goes
/// there; null where they do not touch.
template <typename Contact>
const Contact* contact_of(int node, int body, const std::vector<Contact>& contacts,
                          typename std::vector<Contact>::const_iterator& next) {
  const auto wanted = std::pair(node, body);
  while (next != contacts.end() && std::pair(next->node, next->body) < wanted) ++next;
  const bool touches = next != contacts.end() && std::pair(next->node, next->body) == wanted;
  return touches ? &*next : nullptr;
}

}  // namespace

int ReferenceTissue::bodies() const {
  return static_cast<int>(model_->surroundings.bodies.size()) +
         (model_->surroundings.tool_contact ? 1 : 0);
}

std::vector<ReferenceTissue::Contact> ReferenceTissue::find_contacts(const Terms& terms,
                                                                     const Nodes& x) const {
  std::vector<Contact> contacts;
  const int rigid = static_cast<int>(model_->surroundings.bodies.size());
  const Vector3d shaft = model_->surroundings.capsule_at(terms.tip);
  const Vector3d shaft_end =
      shaft + model_->surroundings.tool_length * model_->surroundings.shaft_axis;
  for (const FaceNode& face : model_->face_nodes) {
    if (has_pad() && grasp_->in_pad[face.node] != 0) continue;  // between the jaws
    for (int body = 0; body < bodies(); ++body) {
      const Vector3d& p = x[face.node];
      const Gap gap = body < rigid
                          ? rigid_gap(model_->surroundings.bodies[body], p)
                          : capsule_gap(shaft, shaft_end, model_->surroundings.tool_radius, p);
      const Pressure pressure = contact_pressure(gap.distance + model_->face_inset);
      if (!(pressure.force > 0)) continue;
      const double k = model_->numerics.contact_stiffness_pa_per_m() * face.area;
      contacts.push_back({face.node, body, gap.normal, k * pressure.force, k * pressure.stiffness,
                          k * pressure.energy});
    }
  }
  return contacts;
}

ReferenceTissue::FrictionPoint ReferenceTissue::friction_point(const Terms& terms,
                                                               const Contact& contact) const {
  FrictionPoint point;
  point.node = contact.node;
  point.body = contact.body;
  point.normal = contact.normal;
  const bool is_tool = contact.body == static_cast<int>(model_->surroundings.bodies.size());
  point.body_velocity = is_tool ? terms.tool_velocity : Vector3d::Zero();
  Vector3d v = state_.v[contact.node] - point.body_velocity;
  v -= v.dot(contact.normal) * contact.normal;
  const double mu = v.norm() > terms.slip_speed ? model_->surroundings.dynamic_friction
                                                : model_->surroundings.static_friction;
  point.coefficient = mu * parameters_.friction_scale * (1 + effects_.values().friction_change);
  point.pressed = contact.force;
  point.limit = point.coefficient * point.pressed;
  return point;
}

void ReferenceTissue::update_friction(const Terms& terms, const Nodes& x) {
  friction_.clear();
  for (const Contact& contact : find_contacts(terms, x)) {
    friction_.push_back(friction_point(terms, contact));
    if (!(friction_.back().limit > 0)) friction_.pop_back();
  }
}

/// Friction where the base has it, with this tissue's coefficient and the normal force of the base:
/// what its own differs from that by is a load of the columns (add_limit_loads).
void ReferenceTissue::follow_friction(const Terms& terms, const ReferenceTissue& base) {
  friction_.clear();
  const std::vector<Contact> contacts = find_contacts(terms, trial_x_);
  auto next = contacts.begin();
  for (const FrictionPoint& f : base.friction_) {
    const Contact* own = contact_of(f.node, f.body, contacts, next);
    friction_.push_back(
        friction_point(terms, own != nullptr ? *own : Contact{f.node, f.body, f.normal}));
    friction_.back().limit = friction_.back().coefficient * f.pressed;
  }
}

/// Velocity of the node at x along the surface it touches.
Vector3d ReferenceTissue::slip_velocity(const Terms& terms, const FrictionPoint& point,
                                        const Vector3d& x) {
  const Vector3d v = (x - terms.x_tilde[point.node]) / terms.beta - point.body_velocity;
  return v - v.dot(point.normal) * point.normal;
}

void ReferenceTissue::add_contact(const Terms& terms, const Nodes& x, Residual& out) const {
  for (const Contact& c : find_contacts(terms, x)) {
    out.count_energy(c.energy);
    add_force(c.node, -c.force * c.normal, out);
  }
  const double slip = terms.slip_speed;
  for (const FrictionPoint& f : friction_) {
    const Vector3d v = slip_velocity(terms, f, x[f.node]);
    const double speed = v.norm();
    const FrictionLaw law = friction_law(speed / slip);
    out.count_energy(f.limit * terms.beta * slip * law.energy);
    if (speed > 0) add_force(f.node, f.limit * law.force / speed * v, out);
  }
}

void ReferenceTissue::contact_stiffness(
    const Terms& terms, const std::function<void(int, const Matrix3d&)>& add) const {
  for (const Contact& c : find_contacts(terms, trial_x_)) {
    const Matrix3d turning = c.force * normal_turn(terms, c.body, trial_x_[c.node]);
    add(c.node, c.stiffness * c.normal * c.normal.transpose() - turning);
  }
  friction_stiffness(terms, add);
}

/// By the nodes; by x~ it is minus that.
void ReferenceTissue::friction_stiffness(
    const Terms& terms, const std::function<void(int, const Matrix3d&)>& add) const {
  const double slip = terms.slip_speed;
  for (const FrictionPoint& f : friction_) {
    const Matrix3d tangential = Matrix3d::Identity() - f.normal * f.normal.transpose();
    const Vector3d v = slip_velocity(terms, f, trial_x_[f.node]);
    const double speed = v.norm();
    const FrictionLaw law = friction_law(speed / slip);
    Matrix3d block = 2 / slip * tangential;  // at zero speed
    if (speed > 1e-6 * slip) {
      const Vector3d along = v / speed;
      block = law.force / speed * (tangential - along * along.transpose()) +
              law.slope / slip * along * along.transpose();
    }
    add(f.node, f.limit / terms.beta * block);
  }
}

/// How the normal of a body turns with the node it touches [1/m]: zero where it is flat.
Matrix3d ReferenceTissue::normal_turn(const Terms& terms, int body, const Vector3d& p) const {
  constexpr double kStep = 1e-6;  // [m] far below a radius, far above rounding
  const Surroundings& around = model_->surroundings;
  const bool rigid = body < static_cast<int>(around.bodies.size());
  if (rigid && around.bodies[body].kind == RigidShape::Kind::kHalfSpace) return Matrix3d::Zero();
  const Vector3d shaft = around.capsule_at(terms.tip);
  const Vector3d shaft_end = shaft + around.tool_length * around.shaft_axis;
  const auto normal_at = [&](const Vector3d& at) {
    return rigid ? rigid_gap(around.bodies[body], at).normal
                 : capsule_gap(shaft, shaft_end, around.tool_radius, at).normal;
  };
  Matrix3d turn;
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3d d = kStep * Vector3d::Unit(axis);
    turn.col(axis) = (normal_at(p + d) - normal_at(p - d)) / (2 * kStep);
  }
  return 0.5 * (turn + turn.transpose());
}

/// Of a sphere that is not there yet: the faces' contact where the base enters it, of unit
/// stiffness and without friction.
void ReferenceTissue::add_obstacle_load(const ColumnParameter& sphere, Eigen::Index k,
                                        RightSides& nodes) const {
  RigidShape body;
  body.X_WS.translation() = sphere.centre;
  body.size.setConstant(sphere.radius);
  for (const FaceNode& face : model_->face_nodes) {
    if (has_pad() && grasp_->in_pad[face.node] != 0) continue;  // as in find_contacts()
    const Gap gap = rigid_gap(body, trial_x_[face.node]);
    const double depth = contact_pressure(gap.distance + model_->face_inset).force;
    if (depth > 0)
      nodes.col(k).segment<3>(model_->unknown[face.node]) += depth * face.area * gap.normal;
  }
}

/// What the limits of friction do that follow the normal forces: those of columns s, and those that
/// the parameters change where nothing moves.
void ReferenceTissue::add_limit_loads(const Terms& terms, const RightSides& s,
                                      RightSides& loads) const {
  const double slip = terms.slip_speed;
  const std::vector<Contact> contacts = find_contacts(terms, trial_x_);
  auto next = contacts.begin();
  for (std::size_t i = 0; i < friction_.size(); ++i) {
    const FrictionPoint& f = friction_[i];
    const Contact* contact = contact_of(f.node, f.body, contacts, next);
    const int row = model_->unknown[f.node];
    const Vector3d v = slip_velocity(terms, f, trial_x_[f.node]);
    const double speed = v.norm();
    if (contact == nullptr || row < 0 || !(speed > 0)) continue;
    const Vector3d along = friction_law(speed / slip).force / speed * v;
    loads.middleRows<3>(row) +=
        f.coefficient * along *
        (contact->stiffness * contact->normal.transpose() * s.middleRows<3>(row) -
         columns_->pressed.row(static_cast<Eigen::Index>(i)));
  }
}

void ReferenceTissue::collect_contact_forces(const Terms& terms) {
  std::fill(contact_forces_.begin(), contact_forces_.end(), Vector3d::Zero());
  for (const Contact& c : find_contacts(terms, state_.x))
    contact_forces_[c.body] += c.force * c.normal;
  const double slip = terms.slip_speed;
  for (const FrictionPoint& f : friction_) {
    const Vector3d v = slip_velocity(terms, f, state_.x[f.node]);
    const double speed = v.norm();
    if (speed > 0)
      contact_forces_[f.body] -= f.limit * friction_law(speed / slip).force / speed * v;
  }
}

double ReferenceTissue::penetration() const {
  double depth = 0;
  for (const FaceNode& face : model_->face_nodes) {
    for (const RigidShape& body : model_->surroundings.bodies)
      depth = std::max(depth, -rigid_gap(body, state_.x[face.node]).distance - model_->face_inset);
  }
  return depth;
}

}  // namespace omentum
