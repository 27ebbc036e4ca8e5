#pragma once

#include <Eigen/Core>
#include <functional>
#include <span>
#include <vector>

#include "proto/scene.pb.h"

// scene/ turns a scene file into plain numbers: particles of the tissue, rigid and soft bodies,
// camera, workspace, starts. It refuses, in one line with knob and range, what cannot be simulated.
// Runs once at the start; nothing here is on the hot path.

namespace omentum {

/// Grid maker: n_x x n_y particles at the pitch, centred on B, x_B outer, y_B inner.
std::vector<Eigen::Vector3d> make_grid_particles(const pb::GridMaker& grid);

/// Volume maker (docs/tissue.md 2): voxel samples of the inside, x outer, z, y inner, merged
/// greedily from the last sample to the first in integer voxel units. `inside` answers for a batch
/// of points in B.
std::vector<Eigen::Vector3d> make_volume_particles(
    const pb::VolumeMaker& maker, const Eigen::Vector3d& bounds_min,
    const Eigen::Vector3d& bounds_max,
    const std::function<std::vector<bool>(std::span<const Eigen::Vector3d>)>& inside,
    std::span<const Eigen::Vector3d> surface_samples);

}  // namespace omentum
