#include "sim_worker/models.h"

#include "core/check.h"
#include "sim_worker/cluster/cluster_tissue.h"
#include "sim_worker/coupled/coupled_tissue.h"
#include "sim_worker/reference/reference_model.h"
#include "sim_worker/shell/shell_model.h"
#include "sim_worker/solid/solid_model.h"

namespace omentum {

std::shared_ptr<const TissueModel> make_tissue_model(const Scene& scene, double control_period,
                                                     std::vector<std::string>& warnings,
                                                     std::span<const PinchCircle> pinches) {
  if (!scene.config.has_tissue()) throw_error("scene.tissue: missing, give grid, sheet or volume");
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
    return make_shell_model(scene, control_period, warnings);
  }
  if (scene.config.tissue().model() == pb::TISSUE_REFERENCE)
    return make_reference_model(scene, control_period, warnings, pinches);
  return make_cluster_model(scene, control_period, warnings);
}

const LaneKernel<float>& choose_kernel(unsigned width) {
  const bool has_avx512 = __builtin_cpu_supports("avx512f") != 0 &&
                          __builtin_cpu_supports("avx512dq") != 0 &&
                          __builtin_cpu_supports("avx512vl") != 0;
  switch (width) {
    case 0:
      return has_avx512 ? f32x16() : f32x8();
    case 1:
      return f32x1();
    case 8:
      return f32x8();
    case 16:
      if (!has_avx512)
        throw_error("run.lane_width: 16 needs a CPU with AVX-512, allowed here: 1, 8");
      return f32x16();
    default:
      throw_error("run.lane_width: {}, allowed: 0 (widest), 1, 8, 16", width);
  }
}

}  // namespace omentum
