#include "sim_worker/coupled/soft_contact.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/check.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kMargin = 2e-3;  // [m] as for rigid shapes: elastic motion of one control step
// A node that is further off than this [m] cannot touch before it is placed again; its triangle is
// not looked for. 0.5 mm in one pass are 125 mm/s.
constexpr double kNear = 0.5e-3;
constexpr double kFar = 1;  // [m] distance of such a node

/// Added in the precision of the lanes.
template <typename Real>
Vector3d sum_of(const LaneArray<Real>& a, const LaneArray<Real>& b, int i, int lane) {
  Vector3d sum;
  for (int k = 0; k < 3; ++k) sum[k] = static_cast<double>(a(i, k, lane) + b(i, k, lane));
  return sum;
}

/// Squares added in order, unlike norm(): part of the results.
double length_of(const Vector3d& v) {
  return std::sqrt(v.x() * v.x() + v.y() * v.y() + v.z() * v.z());
}

}  // namespace

template <typename Real>
SoftContact<Real>::SoftContact(std::shared_ptr<const SolidTissueModel> model,
                               const LaneKernel<Real>& kernel, int sheet_nodes, double sheet_radius)
    : solid_(model, kernel),
      lanes_(kernel.lanes),
      nodes_(sheet_nodes),
      radius_(sheet_radius),
      search_(model->mesh.surface, model->mesh.nodes),
      vertex_(model->mesh.nodes.size(), Vector3d::Zero()),
      normal_(vertex_) {
  for (int i = 0; i < model->nodes(); ++i) {
    if (model->on_surface[i] != 0) skin_.push_back(i);
  }
  start_.resize(lanes_);
  change_.assign(model->nodes(), 3, lanes_);
  solid_.set_load(load_.assign(model->nodes(), 3, lanes_));
  args_.active = true;
  args_.plane = plane_.assign(nodes_, 4, lanes_);
  args_.motion = motion_.assign(nodes_, 3, lanes_);
  args_.force = force_.assign(nodes_, 3, lanes_);
  args_.force_before = before_.assign(nodes_, 3, lanes_);
  args_.work = work_.assign(1, 1, lanes_);
  args_.step_length = step_length_.assign(1, 1, lanes_);
  args_.cross = cross_.assign(1, 1, lanes_);
  args_.beta = beta_.assign(1, 1, lanes_);
  args_.direction = direction_.assign(nodes_, 3, lanes_);
  args_.direction_part = direction_part_.assign(nodes_, 3, lanes_);
  args_.direction_displacement = direction_displacement_.assign(nodes_, 3, lanes_);
  args_.direction_work = direction_work_.assign(1, 1, lanes_);
}

/// Positions of the skin in one lane, at the start of the substep or as they are now.
template <typename Real>
void SoftContact<Real>::take_vertices(int lane, bool moved) {
  const LaneArray<Real>& x = solid_.substep_positions();
  for (const std::int32_t i : skin_) {
    vertex_[i] = moved ? sum_of(x, solid_.substep_displacements(), i, lane) : x.vector(i, lane);
  }
}

template <typename Real>
void SoftContact<Real>::find_normals() {
  for (const std::int32_t i : skin_) normal_[i].setZero();
  for (const Eigen::Vector3i& corner : solid_.model().mesh.surface) {
    const Vector3d& a = vertex_[corner[0]];
    const Vector3d area = (vertex_[corner[1]] - a).cross(vertex_[corner[2]] - a);
    for (const int k : corner) normal_[k] += area;
  }
  for (const std::int32_t i : skin_) normal_[i].normalize();
}

template <typename Real>
void SoftContact<Real>::find_near(const LaneArray<Real>& x, const LaneArray<Real>& v,
                                  std::span<const std::uint32_t> free,
                                  std::span<std::uint32_t> near) {
  const double period = solid_.model().control_period;
  const double fall = period * solid_.model().surroundings.gravity.norm();
  std::fill(near.begin(), near.end(), 0);
  for (int lane = 0; lane < lanes_; ++lane) {
    LaneStart& start = start_[lane];
    start.near.clear();
    start.skin.clear();
    take_vertices(lane, false);
    search_.fit(vertex_);
    double fastest = 0;
    for (const std::int32_t i : skin_) {
      fastest = std::max(fastest, solid_.velocity(lane, i).norm());
      start.skin.push_back(vertex_[i]);
    }
    int last = -1;  // of the node before, which is next to this one but at the ends of rows
    for (int i = 0; i < nodes_; ++i) {
      if ((free[i] >> lane & 1U) == 0) continue;
      const Vector3d q = x.vector(i, lane);
      // Gravity brings sheet and body together where one of them is supported.
      const double reach =
          radius_ + kMargin + period * (length_of(v.vector(i, lane)) + fastest + fall);
      const TrianglePoint found = search_.find(q, vertex_, reach, last);
      last = found.triangle;
      if (found.triangle < 0) continue;
      near[i] |= 1U << lane;
      const double side = search_.is_behind(q, vertex_, found) ? -1 : 1;
      start.near.push_back({i, side * std::sqrt(found.squared), q, found, Vector3d::Zero()});
    }
  }
}

/// Of a node of the skin since the start of the control step [m], at vertex_.
template <typename Real>
double SoftContact<Real>::largest_motion(int lane) const {
  double squared = 0;
  for (std::size_t k = 0; k < skin_.size(); ++k) {
    const Vector3d& start = start_[lane].skin[k];
    squared = std::max(squared, (vertex_[skin_[k]] - start).squaredNorm());
  }
  return std::sqrt(squared);
}

template <typename Real>
void SoftContact<Real>::spread(std::uint32_t lanes, const LaneArray<Real>* before,
                               LaneArray<Real>& load) const {
  for (int lane = 0; lane < lanes_; ++lane) {
    if ((lanes >> lane & 1U) == 0) continue;
    for (const std::int32_t k : skin_) {
      for (int axis = 0; axis < 3; ++axis) load(k, axis, lane) = Real{0};
    }
    for (const Candidate& candidate : start_[lane].near) {
      const int i = candidate.node;
      std::array<Real, 3> force{};
      for (int axis = 0; axis < 3; ++axis) {
        force[axis] =
            force_(i, axis, lane) - (before == nullptr ? Real{0} : (*before)(i, axis, lane));
      }
      if (force == std::array<Real, 3>{}) continue;
      const Eigen::Vector3i& corner = search_.triangle(candidate.point.triangle);
      for (int c = 0; c < 3; ++c) {
        const auto weight = static_cast<Real>(candidate.point.share[c]);
        for (int axis = 0; axis < 3; ++axis) load(corner[c], axis, lane) -= weight * force[axis];
      }
    }
  }
}

template <typename Real>
void SoftContact<Real>::begin_substep(const LaneArray<Real>& x) {
  for (int lane = 0; lane < lanes_; ++lane) {
    take_vertices(lane, false);
    for (Candidate& candidate : start_[lane].near) {
      if (force(lane, candidate.node).isZero(0)) continue;
      const Vector3d q = x.vector(candidate.node, lane);
      candidate.point = search_.walk(q, vertex_, candidate.point.triangle);
    }
  }
  spread(~0U, nullptr, load_);
  changed_ = 0;
  placed_ = false;
}

/// Plane and motion of the near point of one node at q.
template <typename Real>
void SoftContact<Real>::place_node(Candidate& candidate, int lane, const Vector3d& q) {
  const LaneArray<Real>& moved = solid_.substep_displacements();
  const int i = candidate.node;
  TrianglePoint& found = candidate.point;
  found = placed_ ? search_.nearest(q, vertex_, found.triangle)
                  : search_.walk(q, vertex_, found.triangle);
  const Eigen::Vector3i& corner = search_.triangle(found.triangle);
  Vector3d p = Vector3d::Zero();
  Vector3d displacement = Vector3d::Zero();
  for (int c = 0; c < 3; ++c) {
    p += found.share[c] * vertex_[corner[c]];
    if (!placed_) candidate.normal += found.share[c] * normal_[corner[c]];
    displacement += found.share[c] * moved.vector(corner[c], lane);
  }
  if (!placed_) candidate.normal.normalize();
  if (candidate.normal.isZero(0)) candidate.normal = search_.normal(found.triangle, vertex_);
  const double side = search_.is_behind(q, vertex_, found) ? -1 : 1;
  plane_(i, 0, lane) = static_cast<Real>(side * (q - p).norm());
  for (int axis = 0; axis < 3; ++axis)
    plane_(i, 1 + axis, lane) = static_cast<Real>(candidate.normal[axis]);
  motion_.set_vector(i, lane, displacement);
}

// The first call in a substep searches the neighbouring triangles. Later displacements are small:
// near points then stay on their triangles, with an error of displacement^2 / (2 distance), and
// keep their normals; a node that was far gets that of its triangle.
template <typename Real>
void SoftContact<Real>::place(const LaneArray<Real>& x, const LaneArray<Real>& d,
                              std::uint32_t lanes) {
  for (int lane = 0; lane < lanes_; ++lane) {
    if ((lanes >> lane & 1U) == 0) continue;
    take_vertices(lane, true);
    if (!placed_) find_normals();
    const double skin_moved = largest_motion(lane);
    for (Candidate& candidate : start_[lane].near) {
      const int i = candidate.node;
      const Vector3d q = sum_of(x, d, i, lane);
      if (!placed_) candidate.normal.setZero();
      const double moved = skin_moved + (q - candidate.place).norm();
      if (candidate.gap - moved > radius_ + kNear && force(lane, i).isZero(0)) {
        plane_(i, 0, lane) = static_cast<Real>(kFar);
        if (placed_) continue;
        // Normal and motion are multiplied by zero forces: what a lane that broke down left there
        // need not be finite.
        for (int axis = 0; axis < 3; ++axis) plane_(i, 1 + axis, lane) = Real{0};
        motion_.set_vector(i, lane, Vector3d::Zero());
      } else {
        place_node(candidate, lane, q);
      }
    }
  }
  placed_ = true;
}

template <typename Real>
void SoftContact<Real>::response(std::uint32_t lanes) {
  spread(lanes, &before_, change_);
  solid_.response(change_.data(), work_.data(), cross_.data());
}

template <typename Real>
void SoftContact<Real>::take(std::uint32_t lanes) {
  solid_.take_response(beta_.data(), step_length_.data(), lanes);
  changed_ |= lanes;
}

template <typename Real>
void SoftContact<Real>::settle() {
  if (changed_ == 0) return;
  spread(changed_, nullptr, load_);
  solid_.solve_lanes(changed_);
}

template <typename Real>
Vector3d SoftContact<Real>::force(int lane, int node) const {
  return force_.vector(node, lane);
}

// A rigid disc on a half-space, 2 E a / (1 - nu^2) [Johnson85, section 3.4], of the radius that the
// mesh resolves.
template <typename Real>
double SoftContact<Real>::held_stiffness() const {
  const pb::Material& material = solid_.model().material;
  const double nu = material.poisson_ratio();
  return 2 * material.young_modulus_pa() * solid_.model().spacing / (1 - nu * nu);
}

template <typename Real>
double SoftContact<Real>::distance(int lane, const Vector3d& p) {
  take_vertices(lane, false);
  search_.fit(vertex_);
  const TrianglePoint found = search_.find(p, vertex_, std::numeric_limits<double>::infinity());
  return search_.is_behind(p, vertex_, found) ? 0 : std::sqrt(found.squared);
}

template <typename Real>
void SoftContact<Real>::reset(int lane) {
  solid_.reset(lane, Vector3d::Zero());
  force_.fill_lane(lane, Real{0});
}

template <typename Real>
bool SoftContact<Real>::healthy(int lane) const {
  for (int k = 0; k < force_.in_lane(); ++k) {
    if (!std::isfinite(force_.lane_value(k, lane))) return false;
  }
  return solid_.healthy(lane);
}

// State of a lane: forces on the sheet's nodes, then the solid.
template <typename Real>
void SoftContact<Real>::save(int lane, Bytes& out) const {
  StateWriter(out).add_lane(force_, lane);
  solid_.save(lane, out);
}

template <typename Real>
Result<std::size_t> SoftContact<Real>::load(int lane, std::span<const std::byte> bytes) {
  StateReader state(bytes);
  std::vector<Real> force(3 * nodes_);
  if (!state.read_all(std::span(force)))
    return Failure{fmt::format("state of {} bytes ends in the forces of the body", bytes.size())};
  if (!all_finite(std::span<const Real>(force)))
    return Failure{"state of the soft body holds a non-finite force"};
  const Result<std::size_t> used = solid_.load(lane, bytes.subspan(state.used()));
  if (!used) return Failure{used.error()};
  for (int k = 0; k < force_.in_lane(); ++k) force_.lane_value(k, lane) = force[k];
  return state.used() + used.value();
}

template class SoftContact<float>;
template class SoftContact<double>;

}  // namespace omentum
