#include "sim_worker/cluster/cooker.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>

#include "core/check.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

bool collinear(std::span<const Vector3d> particles, const std::vector<int>& common) {
  const Vector3d& a = particles[common[0]];
  const Vector3d ab = particles[common[1]] - a;
  for (std::size_t i = 2; i < common.size(); ++i) {
    const Vector3d ac = particles[common[i]] - a;
    // Relative to the lengths: well above rounding, well below a corner of any sampling.
    if (ab.cross(ac).norm() > 1e-6 * ab.norm() * ac.norm()) return false;
  }
  return true;
}

int count_rigid_groups(std::span<const Vector3d> particles, const Clusters& clusters) {
  const int n = clusters.count();
  std::vector<int> parent(n);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&parent](int c) {
    while (parent[c] != c) c = parent[c];
    return c;
  };
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      std::vector<int> common;
      std::ranges::set_intersection(clusters.members(a), clusters.members(b),
                                    std::back_inserter(common));
      if (common.size() >= 3 && !collinear(particles, common)) parent[root(a)] = root(b);
    }
  }
  int groups = 0;
  for (int c = 0; c < n; ++c) groups += root(c) == c ? 1 : 0;
  return groups;
}

/// One ball of the greedy cover.
struct Cover {
  std::vector<int> taken;  ///< particles within the spacing of its seed
  std::vector<int> fresh;  ///< those in no ball before it
};

std::vector<Cover> greedy_cover(std::span<const Vector3d> particles, double spacing,
                                double& margin) {
  const int n = static_cast<int>(particles.size());
  std::vector<bool> used(particles.size(), false);
  std::vector<Cover> cover;
  for (int seed = n - 1; seed >= 0; --seed) {
    if (used[seed]) continue;
    Cover cluster;
    for (int i = 0; i < n; ++i) {
      const double distance = (particles[i] - particles[seed]).norm();
      margin = std::min(margin, std::fabs(distance - spacing));
      if (!(distance < spacing)) continue;
      cluster.taken.push_back(i);
      if (!used[i]) cluster.fresh.push_back(i);
    }
    for (const int i : cluster.fresh) used[i] = true;
    cover.push_back(std::move(cluster));
  }
  return cover;
}

}  // namespace

Vector3d mean_position(std::span<const Vector3d> particles, std::span<const int> indices) {
  Vector3d sum = Vector3d::Zero();
  for (const int i : indices) sum += particles[i];
  return sum / static_cast<double>(indices.size());
}

Clusters cook_clusters(std::span<const Vector3d> particles, const pb::ClusterModel& model) {
  OMENTUM_CHECK(!particles.empty());
  Clusters result;
  result.tie_margin = std::numeric_limits<double>::infinity();
  const double radius = model.cluster_radius_m();
  const int n = static_cast<int>(particles.size());

  std::vector<std::vector<int>> members;
  for (const Cover& cluster :
       greedy_cover(particles, model.cluster_spacing_m(), result.tie_margin)) {
    const Vector3d centre = mean_position(particles, cluster.taken);
    std::vector<int> own = cluster.fresh;  // radius 0: a partition
    if (radius > 0) {
      own.clear();
      for (int i = 0; i < n; ++i) {
        const double distance = (particles[i] - centre).norm();
        result.tie_margin = std::min(result.tie_margin, std::fabs(distance - radius));
        if (distance < radius) own.push_back(i);
      }
      if (own.empty()) continue;
    }
    result.centre.push_back(centre);
    members.push_back(std::move(own));
  }

  std::vector<int> memberships(particles.size(), 0);
  for (const auto& m : members) {
    for (const int i : m) ++memberships[i];
  }
  for (int i = 0; i < n; ++i) {
    if (memberships[i] == 0) result.orphans.push_back(i);
  }
  if (model.orphan_policy() == pb::ORPHANS_ATTACH_NEAREST) {
    // To the cluster of the nearest mean of its members so far; of equal ones to the first.
    std::vector<Vector3d> means;
    for (const auto& m : members) means.push_back(mean_position(particles, m));
    for (const int i : result.orphans) {
      const auto distance = [&](const Vector3d& mean) { return (particles[i] - mean).norm(); };
      const auto nearest = std::ranges::min_element(means, {}, distance);
      std::vector<int>& own = members[nearest - means.begin()];
      own.insert(std::ranges::upper_bound(own, i), i);
      ++result.attached;
    }
  }

  result.begin.push_back(0);
  for (const auto& m : members) {
    result.member.insert(result.member.end(), m.begin(), m.end());
    result.begin.push_back(static_cast<int>(result.member.size()));
  }
  result.rigid_groups = count_rigid_groups(particles, result);
  return result;
}

void require_no_orphans(const Clusters& clusters, const pb::ClusterModel& model) {
  if (model.orphan_policy() != pb::ORPHANS_REJECT || clusters.orphans.empty()) return;
  std::string first;
  for (std::size_t i = 0; i < std::min<std::size_t>(8, clusters.orphans.size()); ++i) {
    first += fmt::format(" {}", clusters.orphans[i]);
  }
  throw_error(
      "tissue.cluster: cluster_spacing_m {} with cluster_radius_m {} leaves {} of the particles in "
      "no cluster (first:{}); allowed: 0 orphans, radius >= 1.2 x spacing is safe, or name "
      "orphan_policy ORPHANS_ATTACH_NEAREST",
      model.cluster_spacing_m(), model.cluster_radius_m(), clusters.orphans.size(), first);
}

}  // namespace omentum
