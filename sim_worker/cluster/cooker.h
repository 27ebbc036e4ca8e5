#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "proto/scene.pb.h"

namespace omentum {

/// Which particles form which cluster, made once per scene in double precision (docs/tissue.md 3).
/// Depends on the order of the particles; the same on every machine.
struct Clusters {
  std::vector<int> begin;   ///< size clusters + 1: cluster c owns member[begin[c] .. begin[c+1])
  std::vector<int> member;  ///< particle indices, ascending inside a cluster
  std::vector<Eigen::Vector3d> centre;  ///< mean of each ball of the greedy cover [m]
  std::vector<int> orphans;  ///< ascending: in no cluster before the orphan policy was applied
  int attached = 0;          ///< orphans attached to their nearest cluster
  double tie_margin = 0;     ///< smallest |distance - radius| of all queries [m]; < 0.1 um is a tie
  int rigid_groups = 0;      ///< groups of clusters joined by >= 3 common non-collinear particles

  int count() const { return static_cast<int>(begin.size()) - 1; }
  std::span<const int> members(int cluster) const {
    return {&member[begin[cluster]], static_cast<std::size_t>(size(cluster))};
  }
  int size(int cluster) const { return begin[cluster + 1] - begin[cluster]; }
};

/// Mean position of the particles of these indices, of which there is at least one [m].
Eigen::Vector3d mean_position(std::span<const Eigen::Vector3d> particles,
                              std::span<const int> indices);

/// Makes the clusters of at least one particle, positions in B [m]. With ORPHANS_REJECT orphans
/// stay in `orphans`, for require_no_orphans() to refuse.
Clusters cook_clusters(std::span<const Eigen::Vector3d> particles, const pb::ClusterModel& model);

/// Throws Error naming count and first indices if orphans exist and the policy is ORPHANS_REJECT.
void require_no_orphans(const Clusters& clusters, const pb::ClusterModel& model);

}  // namespace omentum
