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
  held.patch = model_->make_grip(held.centre, held.radius);
  if (held.patch.node.empty()) return;
  if (model_->surroundings.grip.pad) {
    take_pad(lane, tip, collapse, held);
    grip(lane, std::move(held));
    return;
  }
  for (std::size_t k = 0; k < held.patch.node.size(); ++k) {
    held.target += (position(lane, held.patch.node[k]) - tip) *
                   held.patch.weight.row(static_cast<Eigen::Index>(k));
  }
  held.target = jaw_rotation(effects, model_->surroundings.shaft_axis) * Targets(held.target);
  if (collapse) held.target.col(0).setZero();
  grip(lane, std::move(held));
}

/// Places of the nodes of a pad from their middle, and of that from the tip.
template <typename Real>
void ShellTissue<Real>::take_pad(int lane, const Vector3d& tip, bool collapse, Held& held) const {
  const Eigen::Matrix3d jaw = jaw_rotation(effects_.values(lane), model_->surroundings.shaft_axis);
  const auto count = static_cast<Eigen::Index>(held.patch.node.size());
  Vector3d centre = Vector3d::Zero();
  double whole = 0;
  held.arm.resize(3, count);
  for (Eigen::Index k = 0; k < count; ++k) {
    held.arm.col(k) = position(lane, held.patch.node[k]) - tip;
    centre += held.patch.area[k] * held.arm.col(k);
    whole += held.patch.area[k];
  }
  centre /= whole;
  held.arm = jaw * Eigen::Matrix3Xd(held.arm.colwise() - centre);
  if (!collapse) held.target.col(0) = jaw * centre;
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

/// Rows of the jaws of a lane and how the sheet responds to them. A node that a pad holds in part
/// hangs on a spring of E t where that part is one half; both faces are on beds.
template <typename Real>
ShellJaws ShellTissue<Real>::make_jaws(int lane) const {
  constexpr double kRigidBed = 1e12;  // [N/m^3], as in the reference
  const Held& held = held_[lane];
  const EffectValues& effects = effects_.values(lane);
  const Grip& grip = model_->surroundings.grip;
  const auto count = static_cast<Eigen::Index>(held.patch.node.size());
  ShellJaws::Rows rows;
  rows.node = held.patch.node;
  rows.offset = held.target.col(0);
  rows.give = effects.grasp_compliance;
  const double turn = effects.grasp_turn > 0 ? effects.grasp_turn : grip.turn_compliance;
  if (turn > 0) rows.turn_stiffness = Eigen::Matrix3d::Identity() / turn;
  if (!grip.pad) {
    rows.weight = held.patch.weight;
    rows.place = Eigen::Vector3d(1, 0, 0);
    rows.compliance = Eigen::Vector3d::Zero();
    rows.arm = held.target;
    rows.arm.col(0).setZero();
  } else {
    rows.weight = Eigen::MatrixXd::Identity(count, count);
    rows.place = Eigen::VectorXd::Ones(count);
    rows.arm = held.arm;
    rows.compliance.resize(count);
    const double bed = grip.stiffness > 0 ? grip.stiffness : kRigidBed;
    Eigen::Matrix3d gyration = Eigen::Matrix3d::Zero();
    double whole = 0;
    for (Eigen::Index k = 0; k < count; ++k) {
      const double area = held.patch.area[k];
      const double part = held.patch.hold[k];
      rows.compliance[k] =
          1 / (2 * bed * area) + (1 - part) / (part * model_->membrane_stiffness());
      const Vector3d a = rows.arm.col(k);
      gyration += area * (a.squaredNorm() * Eigen::Matrix3d::Identity() - a * a.transpose());
      whole += area;
    }
    if (!(turn > 0) && rows.give > 0) rows.turn_stiffness = gyration / (whole * rows.give);
  }
  Eigen::MatrixXd response = Eigen::MatrixXd::Zero(rows.count(), particles());
  for (std::size_t k = 0; k < rows.node.size(); ++k) {
    if (!this->is_fixed(rows.node[k]))
      response.col(rows.node[k]) = rows.weight.row(static_cast<Eigen::Index>(k)).transpose();
  }
  model_->factor(key_[lane])->solve(response);
  return {std::move(rows), std::move(response)};
}

/// The jaws of a lane on the sheet at x + d.
template <typename Real>
void ShellTissue<Real>::hold_jaws(int lane) {
  ShellJaws& jaws = *held_[lane].jaws;
  const ShellJaws::Rows& rows = jaws.rows();
  Eigen::Matrix3Xd places = Eigen::Matrix3Xd::Zero(3, rows.count());
  for (std::size_t k = 0; k < rows.node.size(); ++k) {
    const std::int32_t i = rows.node[k];
    for (int axis = 0; axis < 3; ++axis) {
      const Real p = (x_(i, axis, lane) - tip_(0, axis, lane)) + d_(i, axis, lane);
      places.row(axis) += static_cast<double>(p) * rows.weight.row(static_cast<Eigen::Index>(k));
    }
  }
  const Eigen::Matrix3Xd change = jaws.hold(places);
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::RowVectorXd moved = change.row(axis) * jaws.response();
    for (int i = 0; i < particles(); ++i) {
      if (!this->is_fixed(i)) d_(i, axis, lane) -= static_cast<Real>(moved[i]);
    }
    patch_force_(0, axis, lane) = static_cast<Real>(jaws.force().row(axis).dot(rows.place));
  }
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
  Held& held = held_[lane];
  if (model_->surroundings.grip.pad || effects_.values(lane).grasp_turn > 0) {
    clear_patch(lane);
    held.jaws = make_jaws(lane);
    jaw_lanes_ |= 1U << lane;
    return;
  }
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
  jaw_lanes_ &= ~(1U << lane);
  held_[lane].jaws.reset();
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
  if (held.jaws) {
    held.jaws->shift(by);
  } else {
    patch_offset_.set_vector(0, lane, held.target.col(0));
  }
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
    const Vector3d slip = slip_of(effects, load, stiffness, slipped_[lane], model_->control_period);
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
  template ShellJaws ShellTissue<Real>::make_jaws(int) const;                                 \
  template void ShellTissue<Real>::hold_jaws(int);                                            \
  template void ShellTissue<Real>::take_pad(int, const Vector3d&, bool, Held&) const;         \
  template Vector3d ShellTissue<Real>::point_of_sheet(int, const Eigen::Vector2d&) const;     \
  template std::pair<Vector3d, double> ShellTissue<Real>::nearest_point(int, const Vector3d&) \
      const;                                                                                  \
  template void ShellTissue<Real>::shift_held(int, const Vector3d&)
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
