#include "sim_worker/tissue.h"

#include <array>
#include <cmath>

#include "core/check.h"
#include "sim_worker/cluster_tissue.h"
#include "sim_worker/coupled_tissue.h"
#include "sim_worker/elastic_model.h"
#include "sim_worker/reference_model.h"
#include "sim_worker/solid_model.h"

namespace omentum {

bool usable(const LaneParameters& p) {
  const auto within = [](double v, double min, double max) { return v >= min && v <= max; };
  return within(p.stiffness_scale, 1e-3, 1e3) && within(p.gravity_scale, -100, 100) &&
         within(p.damping_scale, 0, 1e3) && within(p.friction_scale, 0, 1e3);
}

template <typename Real>
void find_nearest_in_lanes(const Kernel<Real>& kernel, int particles, const Real* x,
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

template void find_nearest_in_lanes(const Kernel<float>&, int, const float*,
                                    std::span<const Eigen::Vector3d>, std::span<Nearest>);
template void find_nearest_in_lanes(const Kernel<double>&, int, const double*,
                                    std::span<const Eigen::Vector3d>, std::span<Nearest>);

std::shared_ptr<const TissueModel> make_tissue_model(const Scene& scene, double control_period,
                                                     std::vector<std::string>& warnings) {
  if (scene.soft_body) {
    const pb::Tissue& tissue = scene.config.tissue();
    if (tissue.model() != pb::TISSUE_ELASTIC || !tissue.has_grid()) {
      throw_error(
          "scene.body: with scene.tissue.model {} and a {}, allowed: TISSUE_ELASTIC and a grid",
          pb::TissueModelKind_Name(tissue.model()), tissue.has_grid() ? "grid" : "volume");
    }
    return make_coupled_model(scene, control_period, warnings);
  }
  if (scene.config.tissue().model() == pb::TISSUE_ELASTIC) {
    if (scene.config.tissue().has_volume()) return make_solid_model(scene, control_period);
    return make_elastic_model(scene, control_period, warnings);
  }
  if (scene.config.tissue().model() == pb::TISSUE_REFERENCE)
    return make_reference_model(scene, control_period, warnings);
  return make_cluster_model(scene, control_period, warnings);
}

const Kernel<float>& choose_kernel(unsigned width) {
  const bool has_avx512 = __builtin_cpu_supports("avx512f") != 0 &&
                          __builtin_cpu_supports("avx512dq") != 0 &&
                          __builtin_cpu_supports("avx512vl") != 0;
  switch (width) {
    case 0:
      return has_avx512 ? kKernelF32x16 : kKernelF32x8;
    case 1:
      return kKernelF32x1;
    case 8:
      return kKernelF32x8;
    case 16:
      if (!has_avx512)
        throw_error("run.lane_width: 16 needs a CPU with AVX-512, allowed here: 1, 8");
      return kKernelF32x16;
    default:
      throw_error("run.lane_width: {}, allowed: 0 (widest), 1, 8, 16", width);
  }
}

}  // namespace omentum
