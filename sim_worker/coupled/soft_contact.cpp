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
  const auto W = static_cast<std::size_t>(lanes_);
  const auto n = static_cast<std::size_t>(nodes_);
  for (int i = 0; i < model->nodes(); ++i) {
    if (model->on_surface[static_cast<std::size_t>(i)] != 0) skin_.push_back(i);
  }
  start_.resize(W);
  plane_.assign(4 * n * W, Real{0});
  for (auto* v : {&motion_, &force_, &before_, &direction_, &direction_part_, &direction_way_})
    v->assign(3 * n * W, Real{0});
  for (auto* v : {&work_, &share_, &cross_, &turn_, &direction_work_}) v->assign(W, Real{0});
  for (auto* v : {&load_, &push_}) v->assign(3 * W * model->mesh.nodes.size(), Real{0});
  solid_.set_load(load_.data());
  args_.active = true;
  args_.plane = plane_.data();
  args_.motion = motion_.data();
  args_.force = force_.data();
  args_.force_before = before_.data();
  args_.work = work_.data();
  args_.share = share_.data();
  args_.cross = cross_.data();
  args_.turn = turn_.data();
  args_.direction = direction_.data();
  args_.direction_part = direction_part_.data();
  args_.direction_way = direction_way_.data();
  args_.direction_work = direction_work_.data();
}

/// Positions of the skin in one lane, at the start of the substep or as they are now.
template <typename Real>
void SoftContact<Real>::take_vertices(int lane, bool moved) {
  const Real* const x = solid_.substep_positions();
  const Real* const d = solid_.substep_displacements();
  for (const std::int32_t i : skin_) {
    for (int axis = 0; axis < 3; ++axis) {
      const std::size_t k = index(i, axis, lane);
      vertex_[static_cast<std::size_t>(i)][axis] = static_cast<double>(moved ? x[k] + d[k] : x[k]);
    }
  }
}

template <typename Real>
void SoftContact<Real>::find_normals() {
  for (const std::int32_t i : skin_) normal_[static_cast<std::size_t>(i)].setZero();
  for (const Eigen::Vector3i& corner : solid_.model().mesh.surface) {
    const Vector3d& a = vertex_[static_cast<std::size_t>(corner[0])];
    const Vector3d area = (vertex_[static_cast<std::size_t>(corner[1])] - a)
                              .cross(vertex_[static_cast<std::size_t>(corner[2])] - a);
    for (const int k : corner) normal_[static_cast<std::size_t>(k)] += area;
  }
  for (const std::int32_t i : skin_) normal_[static_cast<std::size_t>(i)].normalize();
}

template <typename Real>
void SoftContact<Real>::start_step(std::span<const ToolMotion> motion, const Real* x, const Real* v,
                                   std::span<const std::uint32_t> free,
                                   std::span<std::uint32_t> near) {
  solid_.start_step(motion);
  const double period = solid_.model().control_period;
  const double fall = period * solid_.model().surroundings.gravity.norm();
  const auto speed_of = [&](const Real* of, int i, int lane) {
    double squared = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const auto component = static_cast<double>(of[index(i, axis, lane)]);
      squared += component * component;
    }
    return std::sqrt(squared);
  };
  std::fill(near.begin(), near.end(), 0);
  for (int lane = 0; lane < lanes_; ++lane) {
    LaneStart& start = start_[static_cast<std::size_t>(lane)];
    start.near.clear();
    start.skin.clear();
    take_vertices(lane, false);
    search_.fit(vertex_);
    double fastest = 0;
    for (const std::int32_t i : skin_) {
      fastest = std::max(fastest, solid_.velocity(lane, i).norm());
      start.skin.push_back(vertex_[static_cast<std::size_t>(i)]);
    }
    int last = -1;  // of the node before, which is next to this one but at the ends of rows
    for (int i = 0; i < nodes_; ++i) {
      if ((free[static_cast<std::size_t>(i)] >> lane & 1U) == 0) continue;
      const Vector3d q = place_of(x, i, lane);
      // Weight moves one towards the other where something holds the other up.
      const double reach = radius_ + kMargin + period * (speed_of(v, i, lane) + fastest + fall);
      const TrianglePoint found = search_.find(q, vertex_, reach, last);
      last = found.triangle;
      if (found.triangle < 0) continue;
      near[static_cast<std::size_t>(i)] |= 1U << lane;
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
    const Vector3d& start = start_[static_cast<std::size_t>(lane)].skin[k];
    squared =
        std::max(squared, (vertex_[static_cast<std::size_t>(skin_[k])] - start).squaredNorm());
  }
  return std::sqrt(squared);
}

template <typename Real>
void SoftContact<Real>::spread(std::uint32_t lanes, const Real* before,
                               AlignedVector<Real>& load) const {
  for (const std::int32_t k : skin_) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int lane = 0; lane < lanes_; ++lane) {
        if ((lanes >> lane & 1U) != 0) load[index(k, axis, lane)] = Real{0};
      }
    }
  }
  for (int lane = 0; lane < lanes_; ++lane) {
    if ((lanes >> lane & 1U) == 0) continue;
    for (const Candidate& candidate : start_[static_cast<std::size_t>(lane)].near) {
      const int i = candidate.node;
      std::array<Real, 3> force{};
      for (int axis = 0; axis < 3; ++axis) {
        const std::size_t at = index(i, axis, lane);
        force[static_cast<std::size_t>(axis)] =
            before == nullptr ? force_[at] : force_[at] - before[at];
      }
      if (force == std::array<Real, 3>{}) continue;
      const Eigen::Vector3i& corner = search_.triangle(candidate.point.triangle);
      for (int c = 0; c < 3; ++c) {
        const auto share = static_cast<Real>(candidate.point.share[c]);
        for (int axis = 0; axis < 3; ++axis)
          load[index(corner[c], axis, lane)] -= share * force[static_cast<std::size_t>(axis)];
      }
    }
  }
}

template <typename Real>
void SoftContact<Real>::start_substep(std::span<const ToolMotion> motion, int substep,
                                      const Real* x) {
  solid_.start_substep(motion, substep);
  for (int lane = 0; lane < lanes_; ++lane) {
    take_vertices(lane, false);
    for (Candidate& candidate : start_[static_cast<std::size_t>(lane)].near) {
      if (force(lane, candidate.node).isZero(0)) continue;
      const Vector3d q = place_of(x, candidate.node, lane);
      candidate.point = search_.walk(q, vertex_, candidate.point.triangle);
    }
  }
  spread(~0U, nullptr, load_);
  changed_ = 0;
  placed_ = false;
  solid_.solve_substep(~0U);
}

/// Plane and motion of the near point of one node at q.
template <typename Real>
void SoftContact<Real>::place_node(Candidate& candidate, int lane, const Vector3d& q) {
  const Real* const moved = solid_.substep_displacements();
  const int i = candidate.node;
  TrianglePoint& found = candidate.point;
  found = placed_ ? search_.nearest(q, vertex_, found.triangle)
                  : search_.walk(q, vertex_, found.triangle);
  const Eigen::Vector3i& corner = search_.triangle(found.triangle);
  Vector3d p = Vector3d::Zero();
  Vector3d way = Vector3d::Zero();
  for (int c = 0; c < 3; ++c) {
    const auto node = static_cast<std::size_t>(corner[c]);
    p += found.share[c] * vertex_[node];
    if (!placed_) candidate.normal += found.share[c] * normal_[node];
    for (int axis = 0; axis < 3; ++axis) {
      way[axis] += found.share[c] * static_cast<double>(moved[index(corner[c], axis, lane)]);
    }
  }
  if (!placed_) candidate.normal.normalize();
  if (candidate.normal.isZero(0)) candidate.normal = search_.normal(found.triangle, vertex_);
  const double side = search_.is_behind(q, vertex_, found) ? -1 : 1;
  plane_[slot(4 * i, lane)] = static_cast<Real>(side * (q - p).norm());
  for (int axis = 0; axis < 3; ++axis) {
    plane_[slot(4 * i + 1 + axis, lane)] = static_cast<Real>(candidate.normal[axis]);
    motion_[index(i, axis, lane)] = static_cast<Real>(way[axis]);
  }
}

// The first one in a substep looks around. What moves after it moves little: near points then stay
// on their triangles, which costs the square of that way over twice the distance, and keep their
// normals; a node that was far gets that of its triangle.
template <typename Real>
void SoftContact<Real>::place(const Real* x, const Real* d, std::uint32_t lanes) {
  for (int lane = 0; lane < lanes_; ++lane) {
    if ((lanes >> lane & 1U) == 0) continue;
    take_vertices(lane, true);
    if (!placed_) find_normals();
    const double skin_moved = largest_motion(lane);
    for (Candidate& candidate : start_[static_cast<std::size_t>(lane)].near) {
      const int i = candidate.node;
      Vector3d q;
      for (int axis = 0; axis < 3; ++axis) {
        const std::size_t k = index(i, axis, lane);
        q[axis] = static_cast<double>(x[k] + d[k]);
      }
      if (!placed_) candidate.normal.setZero();
      const double moved = skin_moved + (q - candidate.place).norm();
      if (candidate.gap - moved > radius_ + kNear && force(lane, i).isZero(0)) {
        plane_[slot(4 * i, lane)] = static_cast<Real>(kFar);
      } else {
        place_node(candidate, lane, q);
      }
    }
  }
  placed_ = true;
}

template <typename Real>
void SoftContact<Real>::answer(std::uint32_t lanes) {
  spread(lanes, before_.data(), push_);
  solid_.answer(push_.data(), work_.data(), cross_.data());
}

template <typename Real>
void SoftContact<Real>::take(std::uint32_t lanes) {
  solid_.take_answer(turn_.data(), share_.data(), lanes);
  changed_ |= lanes;
}

template <typename Real>
void SoftContact<Real>::finish_substep(bool last) {
  if (changed_ != 0) {
    spread(changed_, nullptr, load_);
    solid_.solve_substep(changed_);
  }
  solid_.finish_substep(last);
}

template <typename Real>
Vector3d SoftContact<Real>::force(int lane, int node) const {
  return {static_cast<double>(force_[index(node, 0, lane)]),
          static_cast<double>(force_[index(node, 1, lane)]),
          static_cast<double>(force_[index(node, 2, lane)])};
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
  for (std::size_t k = static_cast<std::size_t>(lane); k < force_.size();
       k += static_cast<std::size_t>(lanes_)) {
    force_[k] = Real{0};
  }
}

template <typename Real>
bool SoftContact<Real>::healthy(int lane) const {
  for (std::size_t k = static_cast<std::size_t>(lane); k < force_.size();
       k += static_cast<std::size_t>(lanes_)) {
    if (!std::isfinite(force_[k])) return false;
  }
  return solid_.healthy(lane);
}

// State of a lane: forces on the sheet's nodes, then the solid.
template <typename Real>
void SoftContact<Real>::save(int lane, Bytes& out) const {
  for (std::size_t k = static_cast<std::size_t>(lane); k < force_.size();
       k += static_cast<std::size_t>(lanes_)) {
    const auto* const bytes = reinterpret_cast<const std::byte*>(&force_[k]);
    out.insert(out.end(), bytes, bytes + sizeof(Real));
  }
  solid_.save(lane, out);
}

template <typename Real>
Result<std::size_t> SoftContact<Real>::load(int lane, std::span<const std::byte> state) {
  std::vector<Real> force(static_cast<std::size_t>(3 * nodes_));
  const std::size_t size = force.size() * sizeof(Real);
  if (state.size() < size) {
    return Failure{fmt::format("state of {} bytes, needed at least {}", state.size(), size)};
  }
  std::memcpy(force.data(), state.data(), size);
  if (!std::all_of(force.begin(), force.end(), [](Real f) { return std::isfinite(f); }))
    return Failure{"state of the soft body holds a non-finite force"};
  const Result<std::size_t> used = solid_.load(lane, state.subspan(size));
  if (!used) return Failure{used.error()};
  for (std::size_t k = 0; k < force.size(); ++k) {
    force_[k * static_cast<std::size_t>(lanes_) + static_cast<std::size_t>(lane)] = force[k];
  }
  return size + used.value();
}

template class SoftContact<float>;
template class SoftContact<double>;

}  // namespace omentum
