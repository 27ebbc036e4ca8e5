// Constraints between pairs of particles of the cluster model: links, and contact of a sheet with
// itself. Both add corrections and their number to pair_sum.
#include <algorithm>
#include <cmath>
#include <optional>

#include "sim_worker/cluster/cluster_tissue.h"

namespace omentum {

using Eigen::Vector3d;

template <typename Real>
void ClusterTissue<Real>::add_pair_corrections() {
  pair_sum_.fill(Real{0});
  add_links();
  add_self_contacts();
}

/// Moves the free ones of two particles along the line between them, by the same distance:
/// scale_of(length, number of free ones) times the line; nothing = no correction.
template <typename Real>
template <typename Scale>
void ClusterTissue<Real>::add_pair(int i, int j, int lane, Real count, Scale&& scale_of) {
  const Real wi = this->is_free(i, lane) ? Real{1} : Real{0};
  const Real wj = this->is_free(j, lane) ? Real{1} : Real{0};
  if (wi + wj == Real{0}) return;
  std::array<Real, 3> d{};
  for (int axis = 0; axis < 3; ++axis) d[axis] = xs_(i, axis, lane) - xs_(j, axis, lane);
  const Real length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
  if (!(length > Real{0})) return;
  const std::optional<Real> scale = scale_of(length, wi + wj);
  if (!scale) return;
  for (int axis = 0; axis < 3; ++axis) {
    const Real step = *scale * d[axis];
    pair_sum_(i, axis, lane) -= wi * step;
    pair_sum_(j, axis, lane) += wj * step;
  }
  pair_sum_(i, 3, lane) += count;
  pair_sum_(j, 3, lane) += count;
}

// Distance constraints times stiffness, both orders of a pair counted as FleX does; a negative
// stiffness resists stretch only (tether).
template <typename Real>
void ClusterTissue<Real>::add_links() {
  const auto stiffness = static_cast<Real>(std::fabs(model_->parameters.link_stiffness()));
  const bool one_sided = model_->parameters.link_stiffness() < 0;
  for (std::size_t k = 0; k < model_->links.size(); ++k) {
    const auto [i, j] = model_->links[k];
    const auto scale_of = [&](Real length, Real weights) -> std::optional<Real> {
      const Real stretch = length - link_rest_[k];
      if (one_sided && stretch < Real{0}) return std::nullopt;
      return Real{2} * stiffness * stretch / (weights * length);
    };
    for (int lane = 0; lane < lanes(); ++lane) add_pair(i, j, lane, Real{2}, scale_of);
  }
}

/// Between particles of a lane that do not overlap [m].
template <typename Real>
double ClusterTissue<Real>::self_distance(int lane) const {
  return 2 * model_->body.particle_radius * this->thickness_scale(lane);
}

template <typename Real>
void ClusterTissue<Real>::add_self_contacts() {
  for (int lane = 0; lane < lanes(); ++lane) {
    const auto rest = static_cast<Real>(self_distance(lane));
    const auto scale_of = [rest](Real length, Real weights) -> std::optional<Real> {
      if (!(length < rest)) return std::nullopt;
      return (length - rest) / (weights * length);
    };
    for (const auto& [i, j] : self_pairs_[lane]) add_pair(i, j, lane, Real{1}, scale_of);
  }
}

// Candidate pairs of this substep, per lane: nearer than one and a half rest distances now, farther
// apart than the rest distance in the rest shape (the filter of the seed). Cells are sorted, so the
// order of pairs is the same on every machine.
template <typename Real>
void ClusterTissue<Real>::find_self_contacts() {
  const auto& body = model_->body.particles;
  // Cell numbers of the three axes in one integer that sorts like (x, y, z): a cell and its two
  // neighbours along z are one range.
  constexpr std::uint64_t kOrigin = 1U << 20;
  struct Cell {
    std::uint64_t key;
    std::int32_t particle;
    auto operator<=>(const Cell&) const = default;
  };
  std::vector<Cell> cells;
  cells.reserve(body.size());
  for (int lane = 0; lane < lanes(); ++lane) {
    const double rest = self_distance(lane);
    const double reach = 1.5 * rest;
    auto& pairs = self_pairs_[lane];
    pairs.clear();
    cells.clear();
    for (int i = 0; i < particles(); ++i) {
      std::uint64_t key = 0;
      bool near = true;
      for (int axis = 0; axis < 3; ++axis) {
        const double u = std::floor(static_cast<double>(xs_(i, axis, lane)) / reach);
        near = near && std::fabs(u) < kOrigin - 1;
        if (near) key = key << 21 | (kOrigin + static_cast<std::uint64_t>(std::int64_t(u)));
      }
      // A particle that diverged has no neighbours; its lane is reported as failed after the step.
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
          for (int axis = 0; axis < 3; ++axis)
            d[axis] = static_cast<double>(xs_(cell.particle, axis, lane) - xs_(other, axis, lane));
          if (!(d.norm() < reach)) continue;
          // 1 %: particles one rest distance apart stay filtered whatever the rounding.
          if ((body[cell.particle] - body[other]).norm() <= 1.01 * rest) {
            continue;
          }
          pairs.push_back({cell.particle, other});
        }
      }
    }
  }
}

#define OMENTUM_INSTANTIATE(Real)                                \
  template double ClusterTissue<Real>::self_distance(int) const; \
  template void ClusterTissue<Real>::add_pair_corrections();     \
  template void ClusterTissue<Real>::add_links();                \
  template void ClusterTissue<Real>::add_self_contacts();        \
  template void ClusterTissue<Real>::find_self_contacts()
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
