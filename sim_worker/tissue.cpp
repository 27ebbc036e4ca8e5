#include "sim_worker/tissue.h"

#include "sim_worker/cluster_tissue.h"
#include "sim_worker/elastic_model.h"
#include "sim_worker/reference_model.h"
#include "sim_worker/solid_model.h"

namespace omentum {

bool usable(const LaneParameters& p) {
  const auto within = [](double v, double min, double max) { return v >= min && v <= max; };
  return within(p.stiffness_scale, 1e-3, 1e3) && within(p.gravity_scale, -100, 100) &&
         within(p.damping_scale, 0, 1e3) && within(p.friction_scale, 0, 1e3);
}

std::shared_ptr<const TissueModel> make_tissue_model(const Scene& scene, double control_period,
                                                     std::vector<std::string>& warnings) {
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
