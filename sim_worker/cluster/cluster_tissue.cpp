#include "sim_worker/cluster/cluster_tissue.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

namespace omentum {

using Eigen::Vector3d;

/// Squares about the particles, each of its share of the sheet.
template <typename Real>
auto ClusterLaneEffects<Real>::node_parts(const ClusterTissueModel& model)
    -> std::vector<NodePart> {
  const double area = model.body.particle_mass / model.areal_density;
  const Eigen::Vector2d half = Eigen::Vector2d::Constant(0.5 * std::sqrt(area));
  std::vector<NodePart> parts;
  for (const Vector3d& p : model.body.particles)
    parts.push_back({area, Eigen::AlignedBox2d(p.head<2>() - half, p.head<2>() + half)});
  return parts;
}

template <typename Real>
ClusterLaneEffects<Real>::ClusterLaneEffects(std::shared_ptr<const ClusterTissueModel> model,
                                             int lanes)
    : LaneEffects<Real>(model->body, model->effects, model->is_anchor,
                        {0, 0, 0, static_cast<int>(model->body.particles.size())},
                        node_parts(*model), lanes),
      model_(std::move(model)) {
  for (int lane = 0; lane < lanes; ++lane) set(lane, model_->effects);
}

template <typename Real>
ClusterTissue<Real>::ClusterTissue(std::shared_ptr<const ClusterTissueModel> model,
                                   const LaneKernel<Real>& kernel)
    : Base(*model, kernel),
      model_(std::move(model)),
      clusters_(kernel_of<ClusterKernel<Real>>(kernel.lanes)),
      effects_(model_, kernel.lanes) {
  const int n = particles();
  const int clusters = model_->clusters.count();
  const int W = lanes();
  load_model();
  held_mask_.assign(n, 0);
  held_.resize(W);
  self_pairs_.resize(W);
  surface_.assign(static_cast<int>(model_->body.surface_vertices.size()), 3, W);

  static_cast<LaneArgs<Real>&>(args_) = this->lane_args();
  args_.particles = n;
  args_.clusters = clusters;
  args_.xs = xs_.assign(n, 3, W);
  args_.q = q_.assign(clusters, 4, W);
  if (!model_->body.surface_is_particles) args_.goal = goal_.assign(clusters, 13, W);
  args_.goal_sum = goal_sum_.assign(n, 4, W);
  if (model_->parameters.plastic_creep() > 0)
    args_.plastic_rest = plastic_rest_.assign(static_cast<int>(rest_.size() / 3), 3, W);
  if (!model_->links.empty() || model_->parameters.self_collision())
    args_.pair_sum = pair_sum_.assign(n, 4, W);
  args_.held_mask = held_mask_.data();
  const auto lists = static_cast<std::size_t>(shapes_.count) + 1;
  near_.resize(lists * candidate_any_.size());
  near_count_.resize(lists);
  args_.near = near_.data();
  args_.near_count = near_count_.data();
  args_.h = static_cast<Real>(model_->substep());
  args_.max_speed = static_cast<Real>(model_->parameters.max_speed_m_per_s());
  args_.plastic_threshold = static_cast<Real>(model_->parameters.plastic_threshold_m2());
  args_.plastic_creep = static_cast<Real>(model_->parameters.plastic_creep());
  args_.bond_gain = bond_gain_.assign(1, 1, W);

  for (int lane = 0; lane < W; ++lane) {
    set_parameters(lane, {});
    reset(lane, Vector3d::Zero());
  }
}

/// The model in the kernel's precision.
template <typename Real>
void ClusterTissue<Real>::load_model() {
  bool planar = model_->parameters.plastic_creep() == 0;
  for (const Vector3d& r0 : model_->rest) {
    planar = planar && r0.z() == 0;
    for (int k = 0; k < 3; ++k) rest_.push_back(static_cast<Real>(r0[k]));
  }
  particle_memberships_.assign(particles(), Real{0});
  particle_weight_.assign(particles(), Real{0});
  for (int c = 0; c < model_->clusters.count(); ++c) {
    std::array<Real, 3> sum{};
    const auto weight = static_cast<Real>(model_->cluster_weight[c]);
    for (int m = model_->clusters.begin[c]; m < model_->clusters.begin[c + 1]; ++m) {
      for (int k = 0; k < 3; ++k) sum[k] += rest_[3 * m + k];
      const int i = model_->clusters.member[m];
      particle_memberships_[i] += 1;
      particle_weight_[i] += weight;
    }
    rest_sum_.insert(rest_sum_.end(), sum.begin(), sum.end());
    cluster_weight_.push_back(weight);
  }
  order_memberships();
  const auto relaxation = static_cast<Real>(model_->parameters.relaxation());
  for (const Real memberships : particle_memberships_)
    particle_scale_.push_back(Real{1} / std::max(memberships / relaxation, Real{1}));
  for (const double r : model_->link_rest) link_rest_.push_back(static_cast<Real>(r));
  for (const double w : model_->skin_weight) skin_weight_.push_back(static_cast<Real>(w));
  for (const Vector3d& o : model_->skin_offset) {
    for (int k = 0; k < 3; ++k) skin_offset_.push_back(static_cast<Real>(o[k]));
  }
  args_.cluster_begin = model_->clusters.begin.data();
  args_.cluster_member = model_->clusters.member.data();
  args_.rest = rest_.data();
  args_.rest_sum = rest_sum_.data();
  args_.cluster_weight = cluster_weight_.data();
  args_.turn = turn_.data();
  args_.turn_begin = turn_begin_.data();
  args_.loose = static_cast<std::int32_t>(loose_.size());
  args_.loose_particle = loose_.data();
  args_.particle_memberships = particle_memberships_.data();
  args_.particle_weight = particle_weight_.data();
  args_.particle_scale = particle_scale_.data();
  args_.planar = planar;
  args_.rotation_iterations = static_cast<std::int32_t>(model_->parameters.rotation_iterations());
}

/// Groups the memberships of each cluster by their turn among those of the particle
/// (cluster_kernel.h).
template <typename Real>
void ClusterTissue<Real>::order_memberships() {
  const Clusters& clusters = model_->clusters;
  std::vector<int> done(particles(), 0);
  turn_begin_.push_back(0);
  for (int c = 0; c < clusters.count(); ++c) {
    std::array<std::vector<std::int32_t>, 4> group;
    for (int m = clusters.begin[c]; m < clusters.begin[c + 1]; ++m) {
      const int i = clusters.member[m];
      const bool first = done[i]++ == 0;
      const bool last = static_cast<Real>(done[i]) == particle_memberships_[i];
      const std::size_t turn = last ? (first ? 0 : 3) : (first ? 1 : 2);
      group[turn].push_back(m);
    }
    for (const auto& memberships : group) {
      turn_.insert(turn_.end(), memberships.begin(), memberships.end());
      turn_begin_.push_back(static_cast<std::int32_t>(turn_.size()));
    }
  }
  for (int i = 0; i < particles(); ++i) {
    if (done[i] == 0) loose_.push_back(i);
  }
}

template <typename Real>
void ClusterTissue<Real>::set_parameters(int lane, const LaneParameters& parameters) {
  const EffectValues effects = parameters.effects.value_or(model_->effects);
  this->set_surroundings(lane, parameters, effects);
  effects_.set(lane, effects);
  args_.effects = effects_.args();
  bond_gain_[lane] = static_cast<Real>(model_->substep() * model_->substep() /
                                       (model_->areal_density * parameters.thickness_scale));
  const double k =
      std::min(1.0, model_->parameters.cluster_stiffness() * parameters.stiffness_scale);
  const double damping = model_->parameters.damping_per_s() * parameters.damping_scale;
  stiffness_[lane] = static_cast<Real>(k);
  keep_[lane] = static_cast<Real>(1.0 - std::min(1.0, damping * model_->substep()));
}

template <typename Real>
void ClusterTissue<Real>::reset(int lane, const Vector3d& offset) {
  release(lane);
  this->place_at_rest(lane, offset);
  effects_.reset(lane);
  const Eigen::Quaterniond q_WB(model_->body.X_WB.linear());
  const std::array<double, 4> q = {q_WB.x(), q_WB.y(), q_WB.z(), q_WB.w()};
  for (int c = 0; c < args_.clusters; ++c) {
    for (int k = 0; k < 4; ++k) q_(c, k, lane) = static_cast<Real>(q[k]);
  }
  for (int k = 0; k < plastic_rest_.in_lane(); ++k) plastic_rest_.lane_value(k, lane) = rest_[k];
}

/// Particles that may reach each shape, and any, in this control step.
template <typename Real>
void ClusterTissue<Real>::list_near() {
  std::fill(near_count_.begin(), near_count_.end(), 0);
  const auto append = [&](std::size_t list, std::int32_t i) {
    near_[list * candidate_any_.size() + static_cast<std::size_t>(near_count_[list]++)] = i;
  };
  const std::size_t shapes = near_count_.size() - 1;
  for (std::int32_t i = 0; i < particles(); ++i) {
    if (candidate_any_[i] == 0) continue;
    for (std::size_t k = 0; k < shapes; ++k) {
      if ((candidate_any_[i] >> k & 1U) != 0) append(k, i);
    }
    append(shapes, i);
  }
}

template <typename Real>
void ClusterTissue<Real>::begin_step(std::span<const ToolMotion> motion) {
  this->find_candidates(motion, free_mask_);
  list_near();
}

template <typename Real>
void ClusterTissue<Real>::begin_substep(std::span<const ToolMotion> motion, int substep) {
  this->place_tool(motion, substep);
  if (substep == 0) clusters_.predict(args_);
  for (int lane = 0; lane < lanes(); ++lane) {
    const Held& held = held_[lane];
    for (std::size_t j = 0; j < held.particles.size(); ++j) {
      for (int axis = 0; axis < 3; ++axis) {
        xs_(held.particles[j], axis, lane) = tip_(0, axis, lane) + held.offsets[j][axis];
      }
    }
  }
  last_ = substep + 1 == this->substeps_;
  if (last_) held_force_.fill(Real{0});
  args_.held_force = last_ ? held_force_.data() : nullptr;
  if (args_.effects.bonds != 0) clusters_.pull_bonds(args_);
  if (model_->parameters.self_collision()) find_self_contacts();
}

template <typename Real>
void ClusterTissue<Real>::solve_substep() {
  const std::uint32_t iterations = model_->parameters.iterations();
  for (std::uint32_t k = 0; k < iterations; ++k) {
    if (args_.pair_sum != nullptr) add_pair_corrections();
    args_.after = k + 1 < iterations ? AfterMatch::kIterate
                  : last_            ? AfterMatch::kFinish
                                     : AfterMatch::kPredict;
    clusters_.match_clusters(args_);
  }
}

template <typename Real>
void ClusterTissue<Real>::hold(int lane, const Vector3d& tip, double radius, bool collapse) {
  Held held;
  for (int i = 0; i < particles(); ++i) {
    const Vector3d offset = this->position(lane, i) - tip;
    if (offset.norm() > radius || this->is_fixed(i)) continue;
    held.particles.push_back(i);
    const Vector3d kept = collapse ? Vector3d::Zero() : offset;
    held.offsets.push_back(
        {static_cast<Real>(kept.x()), static_cast<Real>(kept.y()), static_cast<Real>(kept.z())});
  }
  release(lane);
  take(lane, std::move(held));
}

template <typename Real>
void ClusterTissue<Real>::take(int lane, Held held) {
  for (const std::int32_t i : held.particles) {
    this->set_free(i, lane, false);
    this->set_bit(held_mask_[i], lane, true);
  }
  held_[lane] = std::move(held);
}

template <typename Real>
void ClusterTissue<Real>::release(int lane) {
  Held& held = held_[lane];
  for (const std::int32_t i : held.particles) {
    this->set_free(i, lane, true);
    this->set_bit(held_mask_[i], lane, false);
  }
  held = {};
}

template <typename Real>
void ClusterTissue<Real>::shift_held(int lane, const Vector3d& by) {
  for (auto& offset : held_[lane].offsets) {
    for (int axis = 0; axis < 3; ++axis) offset[axis] += static_cast<Real>(by[axis]);
  }
}

template <typename Real>
void ClusterTissue<Real>::turn_held(int lane, const Eigen::Matrix3d& R) {
  for (auto& offset : held_[lane].offsets) {
    const Vector3d turned = R * Vector3d(offset[0], offset[1], offset[2]);
    for (int axis = 0; axis < 3; ++axis) offset[axis] = static_cast<Real>(turned[axis]);
  }
}

template <typename Real>
Vector3d ClusterTissue<Real>::held_force(int lane) const {
  // The correction d that a held particle does not make is an impulse m d / h in a substep of h:
  // a force m d / h^2, to which its weight adds.
  const auto count = static_cast<double>(held(lane).size());
  if (count == 0) return Vector3d::Zero();
  const double h = model_->substep();
  const double mass = model_->body.particle_mass * this->thickness_scale(lane);
  return mass * held_force_.vector(0, lane) / (h * h) + mass * count * gravity_.vector(0, lane);
}

template <typename Real>
int ClusterTissue<Real>::surface_vertices() const {
  return model_->body.surface_is_particles ? particles()
                                           : static_cast<int>(model_->body.surface_vertices.size());
}

template <typename Real>
const Real* ClusterTissue<Real>::surface_positions() {
  if (model_->body.surface_is_particles) return x_.data();
  kernel_.skin_surface({surface_vertices(), model_->skin_cluster.data(), skin_weight_.data(),
                        skin_offset_.data(), goal_.data(), cluster_weight_.data(),
                        surface_.data()});
  return surface_.data();
}

// ---- state bytes of a grasp: number of particles, their indices, their offsets from the tip
// ------

template <typename Real>
std::vector<const LaneArray<Real>*> ClusterTissue<Real>::saved_arrays() const {
  return {&x_, &v_, &q_, &plastic_rest_, &held_force_};
}

template <typename Real>
bool ClusterTissue<Real>::allows(const EffectValues& effects) const {
  return usable(effects, 0, {}) && effects == effects_of_model(effects, kClusterModel);
}

template <typename Real>
void ClusterTissue<Real>::save(int lane, Bytes& out) const {
  StateWriter state(out);
  const Held& held = held_[lane];
  const bool has_grasp = !held.particles.empty();
  this->save_lane(lane, has_grasp, state);
  if (has_grasp) {
    state.add(static_cast<std::uint32_t>(held.particles.size()));
    state.add_all(std::span<const std::int32_t>(held.particles));
    state.add_all(std::span<const std::array<Real, 3>>(held.offsets));
  }
  effects_.save(lane, state);
}

template <typename Real>
Result<typename ClusterTissue<Real>::Held> ClusterTissue<Real>::read_grasp(
    StateReader& state) const {
  Held held;
  std::uint32_t count = 0;
  if (!state.read(count) || count > static_cast<std::uint32_t>(particles()) || count == 0)
    return Failure{fmt::format("tissue state with {} held particles of {}", count, particles())};
  held.particles.resize(count);
  held.offsets.resize(count);
  if (!state.read_all(std::span(held.particles)) || !state.read_all(std::span(held.offsets)))
    return Failure{"tissue state ends in its grasp"};
  for (std::size_t k = 0; k < count; ++k) {
    const std::int32_t i = held.particles[k];
    if (i < 0 || i >= particles() || this->is_fixed(i))
      return Failure{
          fmt::format("tissue state holds particle {}, not a free one of {}", i, particles())};
    if (!all_finite(std::span<const Real>(held.offsets[k])))
      return Failure{fmt::format("tissue state holds particle {} at a non-finite offset", i)};
  }
  return held;
}

template <typename Real>
Result<std::size_t> ClusterTissue<Real>::load(int lane, std::span<const std::byte> bytes) {
  StateReader state(bytes);
  const Result<SavedLane> saved = this->read_lane(state);
  if (!saved) return Failure{saved.error()};
  Held held;
  if (saved.value().has_grasp) {
    Result<Held> read = read_grasp(state);
    if (!read) return Failure{read.error()};
    held = std::move(read).value();
  }
  const LaneParameters& parameters = saved.value().parameters;
  const Result<std::vector<Real>> memory = effects_.read(*parameters.effects, state);
  if (!memory) return Failure{memory.error()};
  reset(lane, Vector3d::Zero());
  set_parameters(lane, parameters);
  this->load_lane(lane, saved.value());
  take(lane, std::move(held));
  effects_.load(lane, memory.value());
  return state.used();
}

template class ClusterTissue<float>;
template class ClusterTissue<double>;

}  // namespace omentum
