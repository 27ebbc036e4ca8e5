#include "sim_worker/backend/sim_setup.h"

#include <fmt/core.h>

#include "sim_worker/models.h"
#include "sim_worker/tissue/randomise.h"

namespace omentum {

std::shared_ptr<const SimSetup> make_sim_setup(const pb::Config& config,
                                               const std::string& directory) {
  auto setup = std::make_shared<SimSetup>();
  setup->config = config;
  setup->scene = make_scene(config.scene(), directory);
  setup->warnings = setup->scene.warnings;
  setup->tissue =
      make_tissue_model(setup->scene, config.task().control_period_s(), setup->warnings);
  setup->mount = scene_tool_mount(setup->scene);
  setup->arm = std::make_shared<Arm>(setup->scene.config.arm(), setup->mount,
                                     config.task().control_period_s());
  setup->exposure = std::make_shared<ExposureEstimator>(
      setup->scene, static_cast<int>(config.task().exposure_samples()));
  const double speed = config.task().increment_m() / config.task().control_period_s();
  if (speed > 0.05 + 1e-9) {  // docs/task.md 5: warn above 50 mm/s
    setup->warnings.push_back(
        fmt::format("task.increment_m: {} m every {} s is {:.3g} m/s per axis, above 0.05 m/s",
                    config.task().increment_m(), config.task().control_period_s(), speed));
  }
  check_randomise(config, setup->scene);
  return setup;
}

Task make_task(const SimSetup& setup) {
  const Scene& scene = setup.scene;
  return {setup.config,
          {scene.tumour_point, scene.target, scene.tool_start, scene.grid_starts,
           scene.robot_starts, setup.mount}};
}

}  // namespace omentum
