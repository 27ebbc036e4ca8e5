#include "sim_worker/backend/sim_setup.h"

#include <fmt/core.h>

#include "core/check.h"
#include "core/config.h"
#include "sim_worker/models.h"
#include "sim_worker/tissue/randomise.h"

namespace omentum {

namespace {

/// Whether scene and model can do what the task asks for.
void check_orientation(const SimSetup& setup) {
  const pb::Task& task = setup.config.task();
  if (task.observation() == pb::OBSERVATION_ORIENTED && setup.scene.tumour_places.empty()) {
    throw_error(
        "task.observation: OBSERVATION_ORIENTED in a scene without tumour_place, allowed with one "
        "or more: it holds the normal there");
  }
  if (!turns_tool(task)) return;
  if (!setup.tissue->can_turn()) {
    throw_error("task.action: ACTION_ORIENTED with {}, allowed with TISSUE_CLUSTER",
                pb::TissueModelKind_Name(setup.config.scene().tissue().model()));
  }
  if (setup.arm->active() || draws_arm(setup.config)) {
    throw_error(
        "task.action: ACTION_ORIENTED with effects of the arm (scene.arm or randomise arm.*), "
        "allowed without: they know one orientation");
  }
}

std::shared_ptr<SimSetup> resolve(const pb::Config& config, const std::string& directory) {
  auto setup = std::make_shared<SimSetup>();
  setup->config = config;
  setup->scene = make_scene(config.scene(), directory);
  setup->warnings = setup->scene.warnings;
  check_task_parts(config.scene(), setup->warnings);
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
  check_orientation(*setup);
  return setup;
}

}  // namespace

std::shared_ptr<const SimSetup> make_sim_setup(const pb::Config& config,
                                               const std::string& directory) {
  const std::string file = scene_path(config);
  try {
    const std::shared_ptr<SimSetup> setup = resolve(config, directory);
    for (std::string& warning : setup->warnings) warning = with_place(file, warning);
    return setup;
  } catch (const Error& error) {
    throw_error("{}", with_place(file, error.what()));
  }
}

std::shared_ptr<const SimSetup> make_sim_setup(const pb::Config& config) {
  return make_sim_setup(config, scene_directory(config));
}

Task make_task(const SimSetup& setup) {
  const Scene& scene = setup.scene;
  return {setup.config,
          {scene.tumour_point, scene.target, scene.tool_start, scene.grid_starts,
           scene.robot_starts, setup.mount, scene.tumour_places}};
}

}  // namespace omentum
