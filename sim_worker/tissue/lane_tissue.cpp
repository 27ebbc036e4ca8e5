#include "sim_worker/tissue/lane_tissue.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <type_traits>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Displacement of a particle within a control step by elastic forces, beyond its speed and gravity,
// at most, in the sheets and solids in use [m].
constexpr double kElasticMotion = 2e-3;

/// Lanes without infinity or NaN among the numbers of an array of this many lanes: the bits of
/// every other number's size are less than those of infinity.
template <int kWidth, typename Real>
std::uint32_t finite_lanes_of(const LaneArray<Real>& array) {
  using Word = std::conditional_t<sizeof(Real) == 4, std::int32_t, std::int64_t>;
  std::array<Word, kWidth> largest{};
  const Real* number = array.data();
  for (int k = 0; k < array.in_lane(); ++k, number += kWidth) {
    for (int lane = 0; lane < kWidth; ++lane) {
      const Word size = std::bit_cast<Word>(number[lane]) & std::numeric_limits<Word>::max();
      largest[lane] = std::max(largest[lane], size);
    }
  }
  std::uint32_t finite = 0;
  for (int lane = 0; lane < kWidth; ++lane) {
    if (largest[lane] < std::bit_cast<Word>(std::numeric_limits<Real>::infinity()))
      finite |= 1U << lane;
  }
  return finite;
}

template <typename Real>
std::uint32_t finite_lanes(const LaneArray<Real>& array, int lanes) {
  if (lanes == 16) return finite_lanes_of<16>(array);
  return lanes == 8 ? finite_lanes_of<8>(array) : finite_lanes_of<1>(array);
}

}  // namespace

template <typename Real>
LaneTissue<Real>::LaneTissue(const TissueModel& model, const LaneKernel<Real>& kernel)
    : body_(model.body),
      surroundings_(model.surroundings),
      control_period_(model.control_period),
      substeps_(static_cast<int>(model.substeps())),
      kernel_(kernel),
      shapes_(make_kernel_shapes<Real>(model.surroundings)) {
  const int n = particles();
  const int W = kernel_.lanes;
  for (auto* v : {&x_, &v_}) v->assign(n, 3, W);
  for (auto* v : {&held_force_, &gravity_, &tip_, &capsule_motion_}) v->assign(1, 3, W);
  capsule_.assign(2, 3, W);
  for (int lane = 0; lane < W; ++lane) capsule_.set_vector(1, lane, surroundings_.shaft_axis);
  for (auto* v :
       {&stiffness_, &keep_, &static_friction_, &dynamic_friction_, &radius_, &capsule_sweep_})
    v->assign(1, 1, W);
  parameters_.assign(W, LaneParameters{1, 1, 1, 1, EffectValues{}});
  slipped_.assign(W, 0);
  free_mask_.assign(body_.particles.size(), 0);
  candidates_.assign(body_.particles.size() * kMaxShapes, 0);
  candidate_any_.assign(body_.particles.size(), 0);
}

template <typename Real>
void LaneTissue<Real>::set_position(int lane, int particle, const Vector3d& p) {
  x_.set_vector(particle, lane, p);
  forget_health();
}

template <typename Real>
void LaneTissue<Real>::set_velocity(int lane, int particle, const Vector3d& v) {
  v_.set_vector(particle, lane, v);
  forget_health();
}

template <typename Real>
void LaneTissue<Real>::place_at_rest(int lane, const Vector3d& offset) {
  for (int i = 0; i < particles(); ++i) {
    set_position(lane, i, body_.X_WB * body_.particles[i] + offset);
    set_velocity(lane, i, Vector3d::Zero());
    if (!is_fixed(i)) set_free(i, lane, true);
  }
  held_force_.fill_lane(lane, Real{0});
  forget_health();
}

template <typename Real>
void LaneTissue<Real>::set_surroundings(int lane, const LaneParameters& parameters,
                                        const EffectValues& effects) {
  OMENTUM_CHECK(usable(parameters),
                "stiffness {}, gravity {}, damping {}, friction {}, thickness {}",
                parameters.stiffness_scale, parameters.gravity_scale, parameters.damping_scale,
                parameters.friction_scale, parameters.thickness_scale);
  LaneParameters& mine = parameters_[lane];
  mine = parameters;
  mine.effects = effects;
  const Vector3d gravity = tilted_gravity(effects, surroundings_.gravity);
  for (int axis = 0; axis < 3; ++axis)
    gravity_(0, axis, lane) = static_cast<Real>(gravity[axis] * parameters.gravity_scale);
  const double friction = parameters.friction_scale * (1 + effects.friction_change);
  static_friction_[lane] = static_cast<Real>(surroundings_.static_friction * friction);
  dynamic_friction_[lane] = static_cast<Real>(surroundings_.dynamic_friction * friction);
  radius_[lane] = static_cast<Real>(body_.particle_radius * parameters.thickness_scale);
}

template <typename Real>
LaneArgs<Real> LaneTissue<Real>::lane_args() {
  return {x_.data(),
          v_.data(),
          free_mask_.data(),
          stiffness_.data(),
          gravity_.data(),
          keep_.data(),
          static_friction_.data(),
          dynamic_friction_.data(),
          radius_.data(),
          candidates_.data(),
          candidate_any_.data(),
          shapes_.count,
          shapes_.shape.data(),
          capsule_.data(),
          capsule_motion_.data()};
}

template <typename Real>
void LaneTissue<Real>::find_candidates(std::span<const ToolMotion> motion,
                                       const std::vector<std::uint32_t>& free_mask) {
  forget_health();
  for (int lane = 0; lane < lanes(); ++lane) {
    const ToolMotion& m = motion[lane];
    double sweep = (m.to - m.from).norm();
    Vector3d axis = surroundings_.shaft_axis;
    if (m.axis) {
      axis = m.axis->from;
      sweep += (surroundings_.tool_start + surroundings_.tool_length) * (m.axis->to - axis).norm();
    }
    capsule_.set_vector(0, lane, surroundings_.capsule_at(m.from, axis));
    capsule_.set_vector(1, lane, axis);
    capsule_sweep_[lane] = static_cast<Real>(sweep);
  }
  kernel_.find_candidates({particles(), x_.data(), v_.data(), free_mask.data(), gravity_.data(),
                           radius_.data(), static_cast<Real>(control_period_),
                           static_cast<Real>(kElasticMotion), shapes_.count, shapes_.shape.data(),
                           capsule_.data(), capsule_sweep_.data(), candidates_.data(),
                           candidate_any_.data()});
}

template <typename Real>
void LaneTissue<Real>::place_tool(std::span<const ToolMotion> motion, int substep) {
  const double fraction = (substep + 1.0) / substeps_;
  for (int lane = 0; lane < lanes(); ++lane) {
    const ToolMotion& m = motion[lane];
    const Vector3d tip = m.from + fraction * (m.to - m.from);
    tip_.set_vector(0, lane, tip);
    Vector3d axis = surroundings_.shaft_axis;
    Vector3d motion_of_foot = m.to - m.from;
    if (m.axis) {
      axis = (m.axis->from + fraction * (m.axis->to - m.axis->from)).normalized();
      motion_of_foot += surroundings_.tool_start * (m.axis->to - m.axis->from);
      capsule_.set_vector(1, lane, axis);
    }
    capsule_.set_vector(0, lane, surroundings_.capsule_at(tip, axis));
    capsule_motion_.set_vector(0, lane, motion_of_foot / substeps_);
  }
}

template <typename Real>
void LaneTissue<Real>::find_nearest(std::span<const Vector3d> points,
                                    std::span<Nearest> nearest) const {
  constexpr int kMaxLanes = 16;
  const auto W = static_cast<std::size_t>(lanes());
  OMENTUM_CHECK(points.size() == W && nearest.size() == W && lanes() <= kMaxLanes);
  std::array<Real, 3 * kMaxLanes> point{};
  std::array<Real, kMaxLanes> distance2{};
  std::array<Real, kMaxLanes> found{};
  for (std::size_t lane = 0; lane < W; ++lane) {
    for (std::size_t axis = 0; axis < 3; ++axis)
      point[axis * W + lane] = static_cast<Real>(points[lane][static_cast<Eigen::Index>(axis)]);
  }
  kernel_.nearest_particle({particles(), x_.data(), point.data(), distance2.data(), found.data()});
  for (std::size_t lane = 0; lane < W; ++lane) {
    nearest[lane] = {static_cast<int>(found[lane]),
                     std::sqrt(static_cast<double>(distance2[lane]))};
  }
}

template <typename Real>
Vector3d LaneTissue<Real>::held_force(int lane) const {
  return this->held(lane).empty() ? Vector3d::Zero() : held_force_.vector(0, lane);
}

template <typename Real>
bool LaneTissue<Real>::healthy(int lane) const {
  if (!health_known_) {
    healthy_lanes_ = ~0U;
    for (const LaneArray<Real>* array : watched_arrays())
      healthy_lanes_ &= finite_lanes(*array, lanes());
    health_known_ = true;
  }
  return (healthy_lanes_ >> lane & 1U) != 0;
}

template <typename Real>
std::uint64_t LaneTissue<Real>::hash(int lane) const {
  Bytes bytes;
  this->save(lane, bytes);
  return fnv1a64(bytes);
}

// ---- state --------------------------------------------------------------------------------------

template <typename Real>
void LaneTissue<Real>::save_lane(int lane, bool has_grasp, StateWriter& state) const {
  for (const LaneArray<Real>* array : saved_arrays()) state.add_lane(*array, lane);
  const LaneParameters& p = parameters_[lane];
  for (const double scale : {p.stiffness_scale, p.gravity_scale, p.damping_scale, p.friction_scale})
    state.add(scale);
  const bool has_effects = !(effects_of(lane) == EffectValues{});
  const bool has_thickness = p.thickness_scale != 1;
  state.add((has_effects ? kEffectsFollow : 0U) | (has_grasp ? kGraspFollows : 0U) |
            (has_thickness ? kThicknessFollows : 0U));
  if (has_thickness) state.add(p.thickness_scale);
  if (!has_effects) return;
  state.add(effects_of(lane));
  state.add(slipped_[lane]);
}

template <typename Real>
Result<typename LaneTissue<Real>::SavedLane> LaneTissue<Real>::read_lane(StateReader& state) const {
  SavedLane saved;
  std::size_t count = 0;
  for (const LaneArray<Real>* array : saved_arrays())
    count += static_cast<std::size_t>(array->in_lane());
  saved.numbers.resize(count);
  std::array<double, 4> scales{};
  std::uint32_t parts = 0;
  if (!state.read_all(std::span(saved.numbers)) || !state.read_all(std::span(scales)) ||
      !state.read(parts)) {
    return Failure{fmt::format("tissue state is shorter than its {} numbers", count)};
  }
  if (!all_finite(std::span<const Real>(saved.numbers)))
    return Failure{"tissue state holds a non-finite number"};
  if ((parts & ~(kEffectsFollow | kGraspFollows | kThicknessFollows)) != 0)
    return Failure{fmt::format("tissue state with parts {:#x}, allowed 0 ... 7", parts)};
  double thickness = 1;
  if ((parts & kThicknessFollows) != 0) {
    if (!state.read(thickness)) return Failure{"tissue state ends in its thickness"};
    if (thickness == 1) return Failure{"tissue state holds a thickness that is the scene's"};
  }
  EffectValues effects;
  if ((parts & kEffectsFollow) != 0) {
    if (!state.read(effects) || !state.read(saved.slipped))
      return Failure{"tissue state ends in its effects"};
    if (effects == EffectValues{}) return Failure{"tissue state holds effects that are none"};
    if (!(saved.slipped >= 0 && saved.slipped <= 1))
      return Failure{"tissue state holds a bad slip"};
  }
  saved.parameters = {scales[0], scales[1], scales[2], scales[3], effects, thickness};
  if (!usable(saved.parameters)) return Failure{"tissue state holds lane parameters out of range"};
  if (!allows(effects)) return Failure{"tissue state holds effects out of range"};
  saved.has_grasp = (parts & kGraspFollows) != 0;
  return saved;
}

template <typename Real>
void LaneTissue<Real>::load_lane(int lane, const SavedLane& saved) {
  std::size_t next = 0;
  forget_health();
  for (const LaneArray<Real>* array : saved_arrays()) {
    auto& mine = const_cast<LaneArray<Real>&>(*array);  // NOLINT: of this object
    for (int k = 0; k < mine.in_lane(); ++k) mine.lane_value(k, lane) = saved.numbers[next++];
  }
}

template class LaneTissue<float>;
template class LaneTissue<double>;

}  // namespace omentum
