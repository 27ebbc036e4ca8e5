#include "sim_worker/cluster/cooker.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>

#include "core/check.h"
#include "core/hash.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

Vector3d mean_of(std::span<const Vector3d> particles, std::span<const int> indices) {
  Vector3d sum = Vector3d::Zero();
  for (const int i : indices) sum += particles[static_cast<std::size_t>(i)];
  return sum / static_cast<double>(indices.size());
}

bool collinear(std::span<const Vector3d> particles, const std::vector<int>& common) {
  const Vector3d& a = particles[static_cast<std::size_t>(common[0])];
  const Vector3d ab = particles[static_cast<std::size_t>(common[1])] - a;
  for (std::size_t i = 2; i < common.size(); ++i) {
    const Vector3d ac = particles[static_cast<std::size_t>(common[i])] - a;
    // 1e-6 of the product of lengths: well above rounding, well below a real corner of any
    // sampling.
    if (ab.cross(ac).norm() > 1e-6 * ab.norm() * ac.norm()) return false;
  }
  return true;
}

int count_rigid_groups(std::span<const Vector3d> particles, const Clusters& clusters) {
  const int n = clusters.count();
  std::vector<int> parent(static_cast<std::size_t>(n));
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&parent](int c) {
    while (parent[static_cast<std::size_t>(c)] != c) c = parent[static_cast<std::size_t>(c)];
    return c;
  };
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      std::vector<int> common;
      const auto* m = clusters.member.data();
      const auto& begin = clusters.begin;
      std::set_intersection(m + begin[static_cast<std::size_t>(a)],
                            m + begin[static_cast<std::size_t>(a) + 1],
                            m + begin[static_cast<std::size_t>(b)],
                            m + begin[static_cast<std::size_t>(b) + 1], std::back_inserter(common));
      if (common.size() >= 3 && !collinear(particles, common)) {
        parent[static_cast<std::size_t>(root(a))] = root(b);
      }
    }
  }
  int groups = 0;
  for (int c = 0; c < n; ++c) groups += root(c) == c ? 1 : 0;
  return groups;
}

/// One cluster of the greedy cover: all it took (decides its centre) and the part nobody had taken
/// before.
struct Cover {
  std::vector<int> taken;
  std::vector<int> fresh;
};

std::vector<Cover> greedy_cover(std::span<const Vector3d> particles, double spacing,
                                double& margin) {
  const int n = static_cast<int>(particles.size());
  std::vector<bool> used(particles.size(), false);
  std::vector<Cover> cover;
  for (int seed = n - 1; seed >= 0; --seed) {
    if (used[static_cast<std::size_t>(seed)]) continue;
    Cover cluster;
    for (int i = 0; i < n; ++i) {
      const double distance =
          (particles[static_cast<std::size_t>(i)] - particles[static_cast<std::size_t>(seed)])
              .norm();
      margin = std::min(margin, std::fabs(distance - spacing));
      if (!(distance < spacing)) continue;
      cluster.taken.push_back(i);
      if (!used[static_cast<std::size_t>(i)]) cluster.fresh.push_back(i);
    }
    for (const int i : cluster.fresh) used[static_cast<std::size_t>(i)] = true;
    cover.push_back(std::move(cluster));
  }
  return cover;
}

}  // namespace

std::uint64_t Clusters::hash() const {
  std::uint64_t h = kFnvOffset;
  const auto add = [&h](int value) {
    const auto word = static_cast<std::uint32_t>(value);
    h = fnv1a64(std::as_bytes(std::span(&word, 1)), h);
  };
  for (std::size_t c = 0; c + 1 < begin.size(); ++c) {
    add(begin[c + 1] - begin[c]);
    for (int m = begin[c]; m < begin[c + 1]; ++m) add(member[static_cast<std::size_t>(m)]);
  }
  return h;
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
    const Vector3d centre = mean_of(particles, cluster.taken);
    std::vector<int> own = cluster.fresh;  // radius 0: a partition
    if (radius > 0) {
      own.clear();
      for (int i = 0; i < n; ++i) {
        const double distance = (particles[static_cast<std::size_t>(i)] - centre).norm();
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
    for (const int i : m) ++memberships[static_cast<std::size_t>(i)];
  }
  for (int i = 0; i < n; ++i) {
    if (memberships[static_cast<std::size_t>(i)] == 0) result.orphans.push_back(i);
  }
  if (model.orphan_policy() == pb::ORPHANS_ATTACH_NEAREST) {
    // Nearest *mean of the members* before attaching; ties go to the lower cluster.
    std::vector<Vector3d> means;
    for (const auto& m : members) means.push_back(mean_of(particles, m));
    for (const int i : result.orphans) {
      std::size_t best = 0;
      double best_distance = std::numeric_limits<double>::infinity();
      for (std::size_t c = 0; c < means.size(); ++c) {
        const double distance = (particles[static_cast<std::size_t>(i)] - means[c]).norm();
        if (distance < best_distance) {
          best_distance = distance;
          best = c;
        }
      }
      members[best].insert(std::upper_bound(members[best].begin(), members[best].end(), i), i);
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
      "no cluster "
      "(first:{}); allowed: 0 orphans, radius >= 1.2 x spacing is safe, or name orphan_policy "
      "ORPHANS_ATTACH_NEAREST",
      model.cluster_spacing_m(), model.cluster_radius_m(), clusters.orphans.size(), first);
}

}  // namespace omentum
