#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "proto/scene.pb.h"

namespace omentum {

/// Which particles form which cluster, made once per scene in double precision (docs/tissue.md 3).
/// The order of particles decides the result; the same particles give the same clusters on every
/// machine.
struct Clusters {
  std::vector<int> begin;   ///< size clusters + 1: cluster c owns member[begin[c] .. begin[c+1])
  std::vector<int> member;  ///< particle indices, ascending inside a cluster
  std::vector<Eigen::Vector3d> centre;  ///< mean of the taken of the cover, in creation order [m]
  std::vector<int>
      orphans;       ///< particles in no cluster before the orphan policy was applied, ascending
  int attached = 0;  ///< orphans attached to their nearest cluster
  double tie_margin =
      0;  ///< smallest |distance - radius| over all queries [m]; below 0.1 um the cover is a tie
  int rigid_groups = 0;  ///< groups of clusters joined by >= 3 common non-collinear particles

  int count() const { return static_cast<int>(begin.size()) - 1; }
  /// FNV-1a 64 over size and ascending members of each cluster in order, as little-endian u32.
  std::uint64_t hash() const;
};

/// Cooks clusters; does not judge orphans beyond the policy: with ORPHANS_REJECT they stay listed
/// in `orphans` and require_no_orphans() refuses them.
Clusters cook_clusters(std::span<const Eigen::Vector3d> particles, const pb::ClusterModel& model);

/// Throws Error naming count and first indices if orphans exist and the policy is ORPHANS_REJECT.
void require_no_orphans(const Clusters& clusters, const pb::ClusterModel& model);

}  // namespace omentum
