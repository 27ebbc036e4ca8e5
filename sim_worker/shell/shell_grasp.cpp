// The grasp of the elastic shell: the patch in the jaws (docs/tissue.md 8), its slip and its
// rows in the solve. What the lane kernel does with them is hold_patch() in shell_kernel.inl.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

#include "sim_worker/shell/shell_tissue.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {

using Eigen::Vector3d;

template <typename Real>
Vector3d ShellTissue<Real>::point_of_sheet(int lane, const Eigen::Vector2d& X) const {
  const ShellTissueModel::NodeWeights at = model_->locate(X);
  Vector3d p = Vector3d::Zero();
  for (std::size_t k = 0; k < at.node.size(); ++k) p += at.weight[k] * position(lane, at.node[k]);
  return p;
}

template <typename Real>
std::pair<Vector3d, double> ShellTissue<Real>::nearest_point(int lane, const Vector3d& tip) const {
  std::vector<Vector3d> places;
  for (int i = 0; i < particles(); ++i) places.push_back(position(lane, i));
  if (model_->is_mesh()) return nearest_on_mesh(model_->mesh, model_->body.particles, places, tip);
  std::size_t nearest = 0;
  for (std::size_t i = 1; i < places.size(); ++i) {
    if ((places[i] - tip).squaredNorm() < (places[nearest] - tip).squaredNorm()) nearest = i;
  }
  const SheetPoint point =
      nearest_on_sheet([&](const Eigen::Vector2d& X) { return point_of_sheet(lane, X); },
                       model_->sheet(), model_->body.particles[nearest].template head<2>(), tip);
  return {{point.X.x(), point.X.y(), 0}, point.distance};
}

template <typename Real>
void ShellTissue<Real>::hold(int lane, const Vector3d& tip, double radius, bool collapse) {
  release(lane);
  const EffectValues& effects = effects_.values(lane);
  radius += effects.grasp_radius;
  const auto [centre, distance] = nearest_point(
      lane, tip + model_->body.X_WB.linear() * Vector3d(effects.grasp_x, effects.grasp_y, 0));
  if (!(distance < radius)) return;
  Held held;
  held.centre = centre;
  held.radius = std::sqrt(radius * radius - distance * distance);
  if (!model_->can_hold(held.centre, held.radius)) return;
  held.patch = model_->make_patch(held.centre, held.radius);
  if (held.patch.node.empty()) return;
  for (std::size_t k = 0; k < held.patch.node.size(); ++k) {
    held.target += (position(lane, held.patch.node[k]) - tip) *
                   held.patch.weight.row(static_cast<Eigen::Index>(k));
  }
  held.target = jaw_rotation(effects, model_->surroundings.shaft_axis) * Targets(held.target);
  if (collapse) held.target.col(0).setZero();
  grip(lane, std::move(held));
}

template <typename Real>
void ShellTissue<Real>::grip(int lane, Held held) {
  Held& mine = held_[lane];
  mine = std::move(held);
  for (const std::int32_t i : mine.patch.inside) this->set_free(i, lane, false);
  make_patch(lane);
}

template <typename Real>
void ShellTissue<Real>::release(int lane) {
  Held& held = held_[lane];
  slipped_[lane] = 0;
  if (!(held.radius > 0)) return;
  for (const std::int32_t i : held.patch.inside) this->set_free(i, lane, true);
  clear_patch(lane);
  held = {};
}

/// Arrays for patches of `count` nodes; what they held has to be made again.
template <typename Real>
void ShellTissue<Real>::make_room(int count) {
  constexpr int kChunk = 32;  // covers the patches of a 3 mm sheet: growing is rare
  const int room = (count + kChunk - 1) / kChunk * kChunk;
  args_.patch_room = room;
  args_.patch_node = patch_node_.assign(room, 1, lanes());
  args_.patch_weight = patch_weight_.assign(room, kPatchRows, lanes());
}

// Response columns U = A^-1 C^T and the inverse of C U + compliance, in double, once per grasp.
template <typename Real>
void ShellTissue<Real>::make_patch(int lane) {
  const Held& held = held_[lane];
  const auto count = static_cast<int>(held.patch.node.size());
  if (count > args_.patch_room) {
    make_room(count);
    const std::uint32_t others = held_lanes_ & ~(1U << lane);
    for (int other = 0; other < lanes(); ++other) {
      if ((others >> other & 1U) != 0) make_patch(other);
    }
  }
  clear_patch(lane);
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(kPatchRows, particles());
  for (int k = 0; k < count; ++k) {
    const std::int32_t node = held.patch.node[k];
    patch_node_(k, lane) = node;
    for (int row = 0; row < kPatchRows; ++row) {
      patch_weight_(k, row, lane) = static_cast<Real>(held.patch.weight(k, row));
      if (!this->is_fixed(node)) rows(row, node) = held.patch.weight(k, row);
    }
  }
  Eigen::MatrixXd response = rows;
  factor_of(key_[lane]).shared->solve(response);
  Eigen::Matrix3d system = rows * response.transpose();
  system(0, 0) += effects_.values(lane).grasp_compliance;
  const Eigen::Matrix3d inverse = system.llt().solve(Eigen::Matrix3d::Identity());
  for (int row = 0; row < kPatchRows; ++row) {
    for (int k = 0; k < kPatchRows; ++k)
      patch_inverse_(row, k, lane) = static_cast<Real>(inverse(row, k));
    for (int i = 0; i < particles(); ++i)
      patch_response_(i, row, lane) = static_cast<Real>(response(row, i));
    patch_offset_.set_vector(row, lane, held.target.col(row));
  }
  held_lanes_ |= 1U << lane;
  args_.patch_size = std::max(args_.patch_size, count);
}

template <typename Real>
void ShellTissue<Real>::clear_patch(int lane) {
  for (auto* array :
       {&patch_weight_, &patch_offset_, &patch_inverse_, &patch_response_, &patch_force_})
    array->fill_lane(lane, Real{0});
  patch_node_.fill_lane(lane, 0);
  held_lanes_ &= ~(1U << lane);
  args_.patch_size = 0;
  for (int other = 0; other < lanes(); ++other) {
    if ((held_lanes_ >> other & 1U) == 0) continue;
    args_.patch_size = std::max(args_.patch_size, static_cast<int>(held_[other].patch.node.size()));
  }
}

template <typename Real>
void ShellTissue<Real>::shift_held(int lane, const Vector3d& by) {
  Held& held = held_[lane];
  if (!(held.radius > 0)) return;
  held.target.col(0) += by;
  patch_offset_.set_vector(0, lane, held.target.col(0));
}

/// Before a control step: slip of the grasps. A body that is held beside the sheet slips with it,
/// under the load of both.
template <typename Real>
void ShellTissue<Real>::slip_grasps() {
  for (int lane = 0; lane < lanes(); ++lane) {
    const EffectValues& effects = effects_.values(lane);
    if (!(effects.slip_speed > 0)) continue;
    Tissue<Real>* body = surface_ != nullptr ? &surface_->body() : nullptr;
    if (body != nullptr && body->held(lane).empty()) body = nullptr;
    if (!(held_[lane].radius > 0) && body == nullptr) continue;
    Vector3d load = this->held_force(lane);
    double stiffness = model_->membrane_stiffness() * parameters_[lane].stiffness_scale;
    if (body != nullptr) {
      load += body->held_force(lane);
      stiffness += surface_->held_stiffness();
    }
    const Vector3d slip = slip_of(effects, load, stiffness, model_->control_period);
    slipped_[lane] += slip.norm();
    if (effects.slip_loss > 0 && slipped_[lane] > effects.slip_loss) {
      release(lane);
      if (body != nullptr) body->release(lane);
    } else {
      shift_held(lane, slip);
      if (body != nullptr) body->shift_held(lane, slip);
    }
  }
}

#define OMENTUM_INSTANTIATE(Real)                                                             \
  template void ShellTissue<Real>::slip_grasps();                                             \
  template void ShellTissue<Real>::hold(int, const Vector3d&, double, bool);                  \
  template void ShellTissue<Real>::grip(int, Held);                                           \
  template void ShellTissue<Real>::release(int);                                              \
  template void ShellTissue<Real>::make_room(int);                                            \
  template void ShellTissue<Real>::make_patch(int);                                           \
  template void ShellTissue<Real>::clear_patch(int);                                          \
  template Vector3d ShellTissue<Real>::point_of_sheet(int, const Eigen::Vector2d&) const;     \
  template std::pair<Vector3d, double> ShellTissue<Real>::nearest_point(int, const Vector3d&) \
      const;                                                                                  \
  template void ShellTissue<Real>::shift_held(int, const Vector3d&)
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
