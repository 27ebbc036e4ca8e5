#include "sim_worker/tissue/tissue.h"

#include <array>
#include <cmath>

#include "core/check.h"

namespace omentum {

bool usable(const LaneParameters& p) {
  const auto within = [](double v, double min, double max) { return v >= min && v <= max; };
  return within(p.stiffness_scale, 1e-3, 1e3) && within(p.gravity_scale, -100, 100) &&
         within(p.damping_scale, 0, 1e3) && within(p.friction_scale, 0, 1e3);
}

template <typename Real>
void find_nearest_in_lanes(const LaneKernel<Real>& kernel, int particles, const Real* x,
                           std::span<const Eigen::Vector3d> points, std::span<Nearest> nearest) {
  constexpr std::size_t kMaxLanes = 16;
  const auto W = static_cast<std::size_t>(kernel.lanes);
  OMENTUM_CHECK(points.size() == W && nearest.size() == W && W <= kMaxLanes);
  std::array<Real, 3 * kMaxLanes> point{};
  std::array<Real, kMaxLanes> distance2{};
  std::array<Real, kMaxLanes> found{};
  for (std::size_t lane = 0; lane < W; ++lane) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      point[axis * W + lane] = static_cast<Real>(points[lane][static_cast<Eigen::Index>(axis)]);
    }
  }
  kernel.nearest_particle({particles, x, point.data(), distance2.data(), found.data()});
  for (std::size_t lane = 0; lane < W; ++lane) {
    nearest[lane] = {static_cast<int>(found[lane]),
                     std::sqrt(static_cast<double>(distance2[lane]))};
  }
}

template void find_nearest_in_lanes(const LaneKernel<float>&, int, const float*,
                                    std::span<const Eigen::Vector3d>, std::span<Nearest>);
template void find_nearest_in_lanes(const LaneKernel<double>&, int, const double*,
                                    std::span<const Eigen::Vector3d>, std::span<Nearest>);

}  // namespace omentum
