#include "sim_worker/cluster/cluster_tissue.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/tissue/kernel_shape.h"

namespace omentum {

using Eigen::Vector3d;

template <typename Real>
ClusterTissue<Real>::ClusterTissue(std::shared_ptr<const ClusterTissueModel> model,
                                   const LaneKernel<Real>& kernel)
    : model_(std::move(model)),
      kernel_(kernel),
      clusters_(kernel_of<ClusterKernel<Real>>(kernel.lanes)) {
  const int n = particles();
  const int clusters = model_->clusters.count();
  const auto W = static_cast<std::size_t>(kernel_.lanes);
  const auto count = static_cast<std::size_t>(n);

  bool planar = model_->parameters.plastic_creep() == 0;
  for (const Vector3d& r0 : model_->rest) {
    planar = planar && r0.z() == 0;
    for (int k = 0; k < 3; ++k) rest_.push_back(static_cast<Real>(r0[k]));
  }
  particle_memberships_.assign(count, Real{0});
  particle_weight_.assign(count, Real{0});
  for (int c = 0; c < clusters; ++c) {
    std::array<Real, 3> sum{};
    const auto weight = static_cast<Real>(model_->cluster_weight[static_cast<std::size_t>(c)]);
    const int begin = model_->clusters.begin[static_cast<std::size_t>(c)];
    const int end = model_->clusters.begin[static_cast<std::size_t>(c) + 1];
    for (int m = begin; m < end; ++m) {
      for (std::size_t k = 0; k < 3; ++k) sum[k] += rest_[3 * static_cast<std::size_t>(m) + k];
      const auto i = static_cast<std::size_t>(model_->clusters.member[static_cast<std::size_t>(m)]);
      first_of_particle_.push_back(particle_memberships_[i] == 0 ? 1 : 0);
      particle_memberships_[i] += 1;
      particle_weight_[i] += weight;
    }
    rest_sum_.insert(rest_sum_.end(), sum.begin(), sum.end());
    cluster_weight_.push_back(weight);
  }
  const auto relaxation = static_cast<Real>(model_->parameters.relaxation());
  for (const Real memberships : particle_memberships_) {
    particle_scale_.push_back(Real{1} / std::max(memberships / relaxation, Real{1}));
  }
  for (const double r : model_->link_rest) link_rest_.push_back(static_cast<Real>(r));

  for (auto* v : {&x_, &v_, &xs_}) v->assign(3 * count * W, Real{0});
  q_.assign(static_cast<std::size_t>(4 * clusters) * W, Real{0});
  goal_.assign(static_cast<std::size_t>(13 * clusters) * W, Real{0});
  pull_.assign(4 * count * W, Real{0});
  if (model_->parameters.plastic_creep() > 0) plastic_rest_.assign(rest_.size() * W, Real{0});
  if (!model_->links.empty() || model_->parameters.self_collision())
    extra_.assign(4 * count * W, Real{0});
  free_mask_.assign(count, 0);
  held_mask_.assign(count, 0);
  candidates_.assign(count * kMaxShapes, 0);
  candidate_any_.assign(count, 0);
  held_.resize(W);
  self_pairs_.resize(W);
  held_force_.assign(3 * W, Real{0});
  capsule_.assign(3 * W, Real{0});
  capsule_motion_.assign(3 * W, Real{0});
  capsule_sweep_.assign(W, Real{0});
  stiffness_.assign(W, Real{0});
  gravity_.assign(3 * W, Real{0});
  keep_.assign(W, Real{0});
  static_friction_.assign(W, Real{0});
  dynamic_friction_.assign(W, Real{0});
  for (const double w : model_->skin_weight) skin_weight_.push_back(static_cast<Real>(w));
  for (const Vector3d& o : model_->skin_offset) {
    for (int k = 0; k < 3; ++k) skin_offset_.push_back(static_cast<Real>(o[k]));
  }
  surface_.assign(3 * model_->body.surface_vertices.size() * W, Real{0});

  args_.particles = n;
  args_.clusters = clusters;
  args_.cluster_begin = model_->clusters.begin.data();
  args_.cluster_member = model_->clusters.member.data();
  args_.rest = rest_.data();
  args_.rest_sum = rest_sum_.data();
  args_.cluster_weight = cluster_weight_.data();
  args_.first_of_particle = first_of_particle_.data();
  args_.particle_memberships = particle_memberships_.data();
  args_.particle_weight = particle_weight_.data();
  args_.particle_scale = particle_scale_.data();
  args_.planar = planar;
  args_.rotation_iterations = static_cast<std::int32_t>(model_->parameters.rotation_iterations());
  args_.x = x_.data();
  args_.v = v_.data();
  args_.xs = xs_.data();
  args_.q = q_.data();
  args_.goal = goal_.data();
  args_.pull = pull_.data();
  args_.plastic_rest = plastic_rest_.empty() ? nullptr : plastic_rest_.data();
  args_.free_mask = free_mask_.data();
  args_.held_mask = held_mask_.data();
  args_.candidates = candidates_.data();
  args_.candidate_any = candidate_any_.data();
  args_.extra = extra_.empty() ? nullptr : extra_.data();
  args_.stiffness = stiffness_.data();
  args_.gravity = gravity_.data();
  args_.keep = keep_.data();
  args_.static_friction = static_friction_.data();
  args_.dynamic_friction = dynamic_friction_.data();
  args_.h = static_cast<Real>(model_->substep());
  args_.max_speed = static_cast<Real>(model_->parameters.max_speed_m_per_s());
  args_.particle_radius = static_cast<Real>(model_->body.particle_radius);
  args_.plastic_threshold = static_cast<Real>(model_->parameters.plastic_threshold_m2());
  args_.plastic_creep = static_cast<Real>(model_->parameters.plastic_creep());
  shapes_ = make_kernel_shapes<Real>(model_->surroundings);
  args_.shapes = shapes_.count;
  args_.shape = shapes_.shape.data();
  args_.capsule = capsule_.data();
  args_.capsule_motion = capsule_motion_.data();
  // 2 mm beyond what speed and gravity explain: the elastic corrections of one control step of the
  // sheets in use.
  candidate_args_ = {n,
                     x_.data(),
                     v_.data(),
                     free_mask_.data(),
                     gravity_.data(),
                     args_.particle_radius,
                     static_cast<Real>(model_->control_period),
                     static_cast<Real>(2e-3),
                     args_.shapes,
                     args_.shape,
                     capsule_.data(),
                     capsule_sweep_.data(),
                     candidates_.data(),
                     candidate_any_.data()};

  for (int lane = 0; lane < lanes(); ++lane) {
    set_parameters(lane, {});
    reset(lane, Vector3d::Zero());
  }
}

template <typename Real>
void ClusterTissue<Real>::set_parameters(int lane, const LaneParameters& parameters) {
  const auto W = static_cast<std::size_t>(lanes());
  const auto l = static_cast<std::size_t>(lane);
  const double k =
      std::min(1.0, model_->parameters.cluster_stiffness() * parameters.stiffness_scale);
  const double damping = model_->parameters.damping_per_s() * parameters.damping_scale;
  stiffness_[l] = static_cast<Real>(k);
  keep_[l] = static_cast<Real>(1.0 - std::min(1.0, damping * model_->substep()));
  const EffectValues& effects = parameters.effects ? *parameters.effects : model_->effects;
  const Vector3d gravity = tilted_gravity(effects, model_->surroundings.gravity);
  for (int axis = 0; axis < 3; ++axis) {
    gravity_[static_cast<std::size_t>(axis) * W + l] =
        static_cast<Real>(gravity[axis] * parameters.gravity_scale);
  }
  const double friction = parameters.friction_scale * (1 + effects.friction_change);
  static_friction_[l] = static_cast<Real>(model_->surroundings.static_friction * friction);
  dynamic_friction_[l] = static_cast<Real>(model_->surroundings.dynamic_friction * friction);
}

template <typename Real>
void ClusterTissue<Real>::reset(int lane, const Vector3d& offset) {
  release(lane);
  const std::uint32_t bit = 1U << lane;
  for (int i = 0; i < particles(); ++i) {
    const auto p = static_cast<std::size_t>(i);
    const Vector3d p_W = model_->body.X_WB * model_->body.particles[p] + offset;
    set_position(lane, i, p_W);
    set_velocity(lane, i, Vector3d::Zero());
    if (model_->body.fixed[p] == 0) free_mask_[p] |= bit;
  }
  const Eigen::Quaterniond q_WB(model_->body.X_WB.linear());
  const std::array<double, 4> q = {q_WB.x(), q_WB.y(), q_WB.z(), q_WB.w()};
  for (int c = 0; c < args_.clusters; ++c) {
    for (int k = 0; k < 4; ++k) {
      q_[static_cast<std::size_t>((4 * c + k) * lanes() + lane)] =
          static_cast<Real>(q[static_cast<std::size_t>(k)]);
    }
  }
  if (!plastic_rest_.empty()) {
    for (std::size_t m = 0; m < rest_.size(); ++m) {
      plastic_rest_[m * static_cast<std::size_t>(lanes()) + static_cast<std::size_t>(lane)] =
          rest_[m];
    }
  }
  for (int axis = 0; axis < 3; ++axis)
    held_force_[static_cast<std::size_t>(axis * lanes() + lane)] = Real{0};
}

// One control step. The tool moves on a straight line over the substeps; held particles follow it.
template <typename Real>
void ClusterTissue<Real>::step(std::span<const ToolMotion> motion) {
  OMENTUM_CHECK(static_cast<int>(motion.size()) == lanes());
  const int substeps = static_cast<int>(model_->parameters.substeps());
  const int iterations = static_cast<int>(model_->parameters.iterations());
  const auto place_capsule = [&](double share) {
    for (int lane = 0; lane < lanes(); ++lane) {
      const ToolMotion& m = motion[static_cast<std::size_t>(lane)];
      const Vector3d base = m.from + share * (m.to - m.from) +
                            model_->surroundings.tool_start * model_->surroundings.shaft_axis;
      for (int axis = 0; axis < 3; ++axis) {
        const auto k = static_cast<std::size_t>(axis * lanes() + lane);
        capsule_[k] = static_cast<Real>(base[axis]);
        capsule_motion_[k] = static_cast<Real>((m.to[axis] - m.from[axis]) / substeps);
      }
      capsule_sweep_[static_cast<std::size_t>(lane)] = static_cast<Real>((m.to - m.from).norm());
    }
  };

  place_capsule(0);
  kernel_.find_candidates(candidate_args_);
  for (int substep = 0; substep < substeps; ++substep) {
    const double share = (substep + 1.0) / substeps;
    place_capsule(share);
    clusters_.predict(args_);
    place_held(motion, share);
    const bool last = substep + 1 == substeps;
    if (last) std::fill(held_force_.begin(), held_force_.end(), Real{0});
    args_.held_force = last ? held_force_.data() : nullptr;
    if (model_->parameters.self_collision()) find_self_contacts();
    for (int iteration = 0; iteration < iterations; ++iteration) {
      clusters_.match_clusters(args_);
      if (args_.extra != nullptr) {
        std::fill(extra_.begin(), extra_.end(), Real{0});
        accumulate_links();
        accumulate_self_contacts();
      }
      clusters_.apply_corrections(args_);
    }
    clusters_.finish_substep(args_);
  }
}

template <typename Real>
void ClusterTissue<Real>::place_held(std::span<const ToolMotion> motion, double share) {
  for (int lane = 0; lane < lanes(); ++lane) {
    const Held& held = held_[static_cast<std::size_t>(lane)];
    if (held.particles.empty()) continue;
    const ToolMotion& m = motion[static_cast<std::size_t>(lane)];
    const Vector3d tip = m.from + share * (m.to - m.from);
    for (std::size_t j = 0; j < held.particles.size(); ++j) {
      for (int axis = 0; axis < 3; ++axis) {
        at(xs_, held.particles[j], axis, lane) =
            static_cast<Real>(tip[axis]) + held.offsets[j][static_cast<std::size_t>(axis)];
      }
    }
  }
}

template <typename Real>
void ClusterTissue<Real>::hold(int lane, const Vector3d& tip, double radius, bool collapse) {
  release(lane);
  Held& held = held_[static_cast<std::size_t>(lane)];
  const std::uint32_t bit = 1U << lane;
  for (int i = 0; i < particles(); ++i) {
    const auto p = static_cast<std::size_t>(i);
    const Vector3d offset = position(lane, i) - tip;
    if (offset.norm() > radius || model_->body.fixed[p] != 0) continue;
    held.particles.push_back(i);
    const Vector3d kept = collapse ? Vector3d::Zero() : offset;
    held.offsets.push_back(
        {static_cast<Real>(kept.x()), static_cast<Real>(kept.y()), static_cast<Real>(kept.z())});
    free_mask_[p] &= ~bit;
    held_mask_[p] |= bit;
  }
}

template <typename Real>
void ClusterTissue<Real>::release(int lane) {
  Held& held = held_[static_cast<std::size_t>(lane)];
  const std::uint32_t bit = 1U << lane;
  for (const std::int32_t i : held.particles) {
    held_mask_[static_cast<std::size_t>(i)] &= ~bit;
    free_mask_[static_cast<std::size_t>(i)] |= bit;
  }
  held.particles.clear();
  held.offsets.clear();
}

template <typename Real>
void ClusterTissue<Real>::shift_held(int lane, const Vector3d& by) {
  for (auto& offset : held_[static_cast<std::size_t>(lane)].offsets) {
    for (int axis = 0; axis < 3; ++axis)
      offset[static_cast<std::size_t>(axis)] += static_cast<Real>(by[axis]);
  }
}

template <typename Real>
Vector3d ClusterTissue<Real>::held_force(int lane) const {
  // Each refused correction d of a held particle is an impulse m d / h over h: force m d / h^2; its
  // weight adds.
  const Held& held = held_[static_cast<std::size_t>(lane)];
  const double h = model_->substep();
  const double mass = model_->body.particle_mass;
  Vector3d force = Vector3d::Zero();
  for (int axis = 0; axis < 3; ++axis) {
    const auto k = static_cast<std::size_t>(axis * lanes() + lane);
    force[axis] =
        mass * static_cast<double>(held_force_[k]) / (h * h) +
        mass * static_cast<double>(held.particles.size()) * static_cast<double>(gravity_[k]);
  }
  return held.particles.empty() ? Vector3d::Zero() : force;
}

template <typename Real>
Vector3d ClusterTissue<Real>::position(int lane, int particle) const {
  const auto k = static_cast<std::size_t>(3 * particle * lanes() + lane);
  const auto W = static_cast<std::size_t>(lanes());
  return {static_cast<double>(x_[k]), static_cast<double>(x_[k + W]),
          static_cast<double>(x_[k + 2 * W])};
}

template <typename Real>
Vector3d ClusterTissue<Real>::velocity(int lane, int particle) const {
  const auto k = static_cast<std::size_t>(3 * particle * lanes() + lane);
  const auto W = static_cast<std::size_t>(lanes());
  return {static_cast<double>(v_[k]), static_cast<double>(v_[k + W]),
          static_cast<double>(v_[k + 2 * W])};
}

template <typename Real>
void ClusterTissue<Real>::set_position(int lane, int particle, const Vector3d& p) {
  for (int axis = 0; axis < 3; ++axis) at(x_, particle, axis, lane) = static_cast<Real>(p[axis]);
}

template <typename Real>
void ClusterTissue<Real>::set_velocity(int lane, int particle, const Vector3d& v) {
  for (int axis = 0; axis < 3; ++axis) at(v_, particle, axis, lane) = static_cast<Real>(v[axis]);
}

template <typename Real>
void ClusterTissue<Real>::find_nearest(std::span<const Vector3d> points,
                                       std::span<Nearest> nearest) const {
  find_nearest_in_lanes(kernel_, particles(), x_.data(), points, nearest);
}

template <typename Real>
int ClusterTissue<Real>::surface_vertices() const {
  return model_->body.surface_is_particles ? particles()
                                           : static_cast<int>(model_->body.surface_vertices.size());
}

template <typename Real>
const Real* ClusterTissue<Real>::surface_positions() {
  if (model_->body.surface_is_particles) return x_.data();
  const SkinArgs<Real> args{
      surface_vertices(), model_->skin_cluster.data(), skin_weight_.data(), skin_offset_.data(),
      goal_.data(),       cluster_weight_.data(),      surface_.data()};
  kernel_.skin_surface(args);
  return surface_.data();
}

template <typename Real>
bool ClusterTissue<Real>::healthy(int lane) const {
  for (std::size_t k = static_cast<std::size_t>(lane); k < x_.size();
       k += static_cast<std::size_t>(lanes())) {
    if (!std::isfinite(x_[k]) || !std::isfinite(v_[k])) return false;
  }
  return true;
}

// Links: usual weighted projection times stiffness, both orders of the pair counted as FleX cooks
// them; a negative stiffness only pulls (tether). Evaluated on x*, added to `extra` with the count.
template <typename Real>
void ClusterTissue<Real>::accumulate_links() {
  const int W = lanes();
  const auto stiffness = static_cast<Real>(std::fabs(model_->parameters.link_stiffness()));
  const bool one_sided = model_->parameters.link_stiffness() < 0;
  for (std::size_t k = 0; k < model_->links.size(); ++k) {
    const auto [i, j] = model_->links[k];
    for (int lane = 0; lane < W; ++lane) {
      const std::uint32_t bit = 1U << lane;
      const Real wi = (free_mask_[static_cast<std::size_t>(i)] & bit) != 0 ? Real{1} : Real{0};
      const Real wj = (free_mask_[static_cast<std::size_t>(j)] & bit) != 0 ? Real{1} : Real{0};
      if (wi + wj == Real{0}) continue;
      std::array<Real, 3> d{};
      for (int axis = 0; axis < 3; ++axis) {
        d[static_cast<std::size_t>(axis)] = at(xs_, i, axis, lane) - at(xs_, j, axis, lane);
      }
      const Real length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
      const Real stretch = length - link_rest_[k];
      if (!(length > Real{0}) || (one_sided && stretch < Real{0})) continue;
      const Real scale = Real{2} * stiffness * stretch / ((wi + wj) * length);
      for (int axis = 0; axis < 3; ++axis) {
        const Real step = scale * d[static_cast<std::size_t>(axis)];
        extra_[static_cast<std::size_t>((4 * i + axis) * W + lane)] -= wi * step;
        extra_[static_cast<std::size_t>((4 * j + axis) * W + lane)] += wj * step;
      }
      extra_[static_cast<std::size_t>((4 * i + 3) * W + lane)] += Real{2};
      extra_[static_cast<std::size_t>((4 * j + 3) * W + lane)] += Real{2};
    }
  }
}

// Candidate pairs of this substep, per lane: nearer than one and a half rest distances now, farther
// apart than the rest distance in the rest shape (the filter of the seed). Sorted cells, so the
// order of pairs is the same everywhere.
template <typename Real>
void ClusterTissue<Real>::find_self_contacts() {
  const double rest = 2 * model_->body.particle_radius;
  const double reach = 1.5 * rest;
  const auto& body = model_->body.particles;
  // Numbers of the three axes in one integer that sorts as they do: a cell and its two neighbours
  // along z are one range.
  constexpr std::uint64_t kOrigin = 1U << 20;
  struct Cell {
    std::uint64_t key;
    std::int32_t particle;
    bool operator<(const Cell& o) const {
      return key != o.key ? key < o.key : particle < o.particle;
    }
  };
  std::vector<Cell> cells;
  cells.reserve(body.size());
  for (int lane = 0; lane < lanes(); ++lane) {
    auto& pairs = self_pairs_[static_cast<std::size_t>(lane)];
    pairs.clear();
    cells.clear();
    for (int i = 0; i < particles(); ++i) {
      std::uint64_t key = 0;
      bool near = true;
      for (int axis = 0; axis < 3; ++axis) {
        const double u = std::floor(static_cast<double>(at(xs_, i, axis, lane)) / reach);
        near = near && std::fabs(u) < kOrigin - 1;
        if (near) key = key << 21 | (kOrigin + static_cast<std::uint64_t>(std::int64_t(u)));
      }
      // A diverged particle has no neighbours; its lane is reported as failed after the step.
      if (near) cells.push_back({key, i});
    }
    std::sort(cells.begin(), cells.end());
    std::array<std::size_t, 9> first{};  // of each column of neighbours; they only move forward
    for (const Cell& cell : cells) {
      for (std::size_t column = 0; column < first.size(); ++column) {
        const std::uint64_t lowest =
            cell.key + ((column / 3) << 42) + ((column % 3) << 21) - (1ULL << 42 | 1ULL << 21 | 1);
        while (first[column] < cells.size() && cells[first[column]].key < lowest) ++first[column];
        for (std::size_t k = first[column]; k < cells.size() && cells[k].key <= lowest + 2; ++k) {
          const std::int32_t other = cells[k].particle;
          if (other <= cell.particle) continue;
          Vector3d d;
          for (int axis = 0; axis < 3; ++axis) {
            d[axis] = static_cast<double>(at(xs_, cell.particle, axis, lane) -
                                          at(xs_, other, axis, lane));
          }
          if (!(d.norm() < reach)) continue;
          // 1 %: pairs that rest at the rest distance stay filtered whatever the rounding of the
          // pitch.
          if ((body[static_cast<std::size_t>(cell.particle)] -
               body[static_cast<std::size_t>(other)])
                  .norm() <= 1.01 * rest) {
            continue;
          }
          pairs.push_back({cell.particle, other});
        }
      }
    }
  }
}

template <typename Real>
void ClusterTissue<Real>::accumulate_self_contacts() {
  const int W = lanes();
  const auto rest = static_cast<Real>(2 * model_->body.particle_radius);
  for (int lane = 0; lane < W; ++lane) {
    const std::uint32_t bit = 1U << lane;
    for (const auto& [i, j] : self_pairs_[static_cast<std::size_t>(lane)]) {
      const Real wi = (free_mask_[static_cast<std::size_t>(i)] & bit) != 0 ? Real{1} : Real{0};
      const Real wj = (free_mask_[static_cast<std::size_t>(j)] & bit) != 0 ? Real{1} : Real{0};
      std::array<Real, 3> d{};
      for (int axis = 0; axis < 3; ++axis) {
        d[static_cast<std::size_t>(axis)] = at(xs_, i, axis, lane) - at(xs_, j, axis, lane);
      }
      const Real length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
      if (!(length < rest) || !(length > Real{0}) || wi + wj == Real{0}) continue;
      const Real scale = (length - rest) / ((wi + wj) * length);
      for (int axis = 0; axis < 3; ++axis) {
        const Real step = scale * d[static_cast<std::size_t>(axis)];
        extra_[static_cast<std::size_t>((4 * i + axis) * W + lane)] -= wi * step;
        extra_[static_cast<std::size_t>((4 * j + axis) * W + lane)] += wj * step;
      }
      extra_[static_cast<std::size_t>((4 * i + 3) * W + lane)] += Real{1};
      extra_[static_cast<std::size_t>((4 * j + 3) * W + lane)] += Real{1};
    }
  }
}

template <typename Real>
void ClusterTissue<Real>::save(int lane, Bytes& out) const {
  const auto add = [&out](const void* data, std::size_t size) {
    const auto* bytes = static_cast<const std::byte*>(data);
    out.insert(out.end(), bytes, bytes + size);
  };
  const auto add_lane = [&](const AlignedVector<Real>& values) {
    for (std::size_t k = static_cast<std::size_t>(lane); k < values.size();
         k += static_cast<std::size_t>(lanes())) {
      add(&values[k], sizeof(Real));
    }
  };
  add_lane(x_);
  add_lane(v_);
  add_lane(q_);
  add_lane(plastic_rest_);
  add_lane(held_force_);
  for (const auto* p : {&stiffness_, &gravity_, &keep_, &static_friction_, &dynamic_friction_})
    add_lane(*p);
  const Held& held = held_[static_cast<std::size_t>(lane)];
  const auto count = static_cast<std::uint32_t>(held.particles.size());
  add(&count, sizeof count);
  add(held.particles.data(), count * sizeof(std::int32_t));
  add(held.offsets.data(), count * sizeof(held.offsets[0]));
}

template <typename Real>
Result<std::size_t> ClusterTissue<Real>::load(int lane, std::span<const std::byte> state) {
  const std::array<AlignedVector<Real>*, 10> arrays = {
      &x_,         &v_,       &q_,    &plastic_rest_,    &held_force_,
      &stiffness_, &gravity_, &keep_, &static_friction_, &dynamic_friction_};
  std::size_t reals = 0;
  for (const auto* a : arrays) reals += a->size() / static_cast<std::size_t>(lanes());
  const std::size_t fixed_size = reals * sizeof(Real) + sizeof(std::uint32_t);
  if (state.size() < fixed_size) {
    return Failure{
        fmt::format("tissue state of {} bytes, needed at least {}", state.size(), fixed_size)};
  }
  std::uint32_t count = 0;
  std::memcpy(&count, state.data() + reals * sizeof(Real), sizeof count);
  const std::size_t total =
      fixed_size + std::size_t{count} * (sizeof(std::int32_t) + 3 * sizeof(Real));
  if (count > static_cast<std::uint32_t>(particles()) || state.size() < total) {
    return Failure{fmt::format("tissue state of {} bytes with {} held particles, needed {}",
                               state.size(), count, total)};
  }
  std::vector<Real> values(reals);
  std::memcpy(values.data(), state.data(), reals * sizeof(Real));
  for (const Real v : values) {
    if (!std::isfinite(v)) return Failure{"tissue state holds a non-finite number"};
  }
  Held held;
  held.particles.resize(count);
  held.offsets.resize(count);
  if (count > 0) {  // memcpy must not get the null pointer of an empty vector
    std::memcpy(held.particles.data(), state.data() + fixed_size, count * sizeof(std::int32_t));
    std::memcpy(held.offsets.data(), state.data() + fixed_size + count * sizeof(std::int32_t),
                count * sizeof(held.offsets[0]));
  }
  for (const std::int32_t i : held.particles) {
    if (i < 0 || i >= particles() || model_->body.fixed[static_cast<std::size_t>(i)] != 0) {
      return Failure{
          fmt::format("tissue state holds particle {}, not a free one of {}", i, particles())};
    }
  }

  release(lane);
  std::size_t next = 0;
  for (auto* a : arrays) {
    for (std::size_t k = static_cast<std::size_t>(lane); k < a->size();
         k += static_cast<std::size_t>(lanes())) {
      (*a)[k] = values[next++];
    }
  }
  const std::uint32_t bit = 1U << lane;
  for (int i = 0; i < particles(); ++i) {
    if (model_->body.fixed[static_cast<std::size_t>(i)] == 0)
      free_mask_[static_cast<std::size_t>(i)] |= bit;
  }
  for (const std::int32_t i : held.particles) {
    free_mask_[static_cast<std::size_t>(i)] &= ~bit;
    held_mask_[static_cast<std::size_t>(i)] |= bit;
  }
  held_[static_cast<std::size_t>(lane)] = std::move(held);
  return total;
}

template <typename Real>
std::uint64_t ClusterTissue<Real>::hash(int lane) const {
  Bytes bytes;
  save(lane, bytes);
  return fnv1a64(bytes);
}

template class ClusterTissue<float>;
template class ClusterTissue<double>;

}  // namespace omentum
