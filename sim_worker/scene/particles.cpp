#include "sim_worker/scene/particles.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "core/check.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

Vector3d mean_of(std::span<const Vector3d> particles, std::span<const int> indices) {
  Vector3d sum = Vector3d::Zero();
  for (const int i : indices) sum += particles[static_cast<std::size_t>(i)];
  return sum / static_cast<double>(indices.size());
}

}  // namespace

std::vector<Vector3d> make_grid_particles(const pb::GridMaker& grid) {
  std::vector<Vector3d> particles;
  const auto centred = [&grid](unsigned i, unsigned count) {
    return (static_cast<double>(i) - 0.5 * static_cast<double>(count - 1)) * grid.pitch_m();
  };
  for (unsigned ix = 0; ix < grid.count_x(); ++ix) {
    for (unsigned iy = 0; iy < grid.count_y(); ++iy) {
      particles.emplace_back(centred(ix, grid.count_x()), centred(iy, grid.count_y()), 0);
    }
  }
  return particles;
}

std::vector<Vector3d> make_volume_particles(
    const pb::VolumeMaker& maker, const Vector3d& bounds_min, const Vector3d& bounds_max,
    const std::function<std::vector<bool>(std::span<const Vector3d>)>& inside,
    std::span<const Vector3d> surface_samples) {
  const double factor = maker.volume_sampling();
  const double voxel = maker.particle_spacing_m() / factor;
  const Vector3d centre = 0.5 * (bounds_min + bounds_max);
  const Vector3d extent = bounds_max - bounds_min;
  std::array<int, 3> count{};
  for (int axis = 0; axis < 3; ++axis) {
    // 1e-9: an extent that is a whole number of voxels up to rounding keeps its last voxel.
    count[static_cast<std::size_t>(axis)] =
        static_cast<int>(std::floor(extent[axis] / voxel + 1e-9)) + 4;
  }
  const double cells = 1.0 * count[0] * count[1] * count[2];
  if (!(cells <= 2e7)) {
    throw_error(
        "tissue.volume.particle_spacing_m: {} with volume_sampling {} needs {:.3g} voxels, allowed "
        "at most 2e7",
        maker.particle_spacing_m(), factor, cells);
  }
  // Samples in voxel units, so that distances that are whole voxels compare exactly.
  std::vector<Vector3d> units;
  std::vector<Vector3d> points;
  for (int ix = 0; ix < count[0]; ++ix) {
    for (int iz = 0; iz < count[2]; ++iz) {
      for (int iy = 0; iy < count[1]; ++iy) {
        const Vector3d unit(ix - 0.5 * (count[0] - 1), iy - 0.5 * (count[1] - 1),
                            iz - 0.5 * (count[2] - 1));
        units.push_back(unit);
        points.push_back(centre + voxel * unit);
      }
    }
  }
  const std::vector<bool> is_inside = inside(points);
  std::vector<Vector3d> samples;
  for (std::size_t i = 0; i < units.size(); ++i) {
    if (is_inside[i]) samples.push_back(units[i]);
  }
  for (const Vector3d& p : surface_samples) samples.emplace_back((p - centre) / voxel);
  if (samples.empty()) return {};

  // Bins of one merge radius, so that a query looks at 27 of them.
  const auto cell_of = [factor](const Vector3d& u) {
    return std::array<int, 3>{static_cast<int>(std::floor(u.x() / factor)),
                              static_cast<int>(std::floor(u.y() / factor)),
                              static_cast<int>(std::floor(u.z() / factor))};
  };
  std::map<std::array<int, 3>, std::vector<int>> bins;
  for (std::size_t i = 0; i < samples.size(); ++i)
    bins[cell_of(samples[i])].push_back(static_cast<int>(i));

  std::vector<bool> used(samples.size(), false);
  std::vector<Vector3d> particles;
  for (std::size_t seed = samples.size(); seed-- > 0;) {
    if (used[seed]) continue;
    const auto cell = cell_of(samples[seed]);
    std::vector<int> taken;
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dz = -1; dz <= 1; ++dz) {
          const auto bin = bins.find({cell[0] + dx, cell[1] + dy, cell[2] + dz});
          if (bin == bins.end()) continue;
          for (const int i : bin->second) {
            if ((samples[static_cast<std::size_t>(i)] - samples[seed]).squaredNorm() <
                factor * factor) {
              taken.push_back(i);
            }
          }
        }
      }
    }
    std::sort(taken.begin(), taken.end());
    for (const int i : taken) used[static_cast<std::size_t>(i)] = true;
    particles.emplace_back(centre + voxel * mean_of(samples, taken));
  }
  return particles;
}

}  // namespace omentum
