#include "contract/backend_contract.h"

#include "core/config.h"
#include "sim_worker/backend/image_source.h"
#include "sim_worker/backend/sim_backend.h"
#include "support/dummy_backend.h"

namespace omentum::test {
namespace {

/// The setup is made when the first back end is: ctest runs one case per process, and every process
/// lists them all.
BackendCase sim_case(const std::string& name, const std::string& preset,
                     const std::vector<std::string>& overrides = {}) {
  const pb::Config config = load_config(preset, overrides);
  const auto setup = std::make_shared<std::shared_ptr<const SimSetup>>();
  const auto make = [config, setup](int lanes) {
    if (*setup == nullptr) *setup = make_sim_setup(config, deploy_dir() + "/scenes");
    return std::make_unique<SimBackend>(*setup, lanes, 0, make_image_source(**setup));
  };
  return {name, make, policy_shape(config)};
}

BackendCase dummy_case() {
  PolicyShape shape;
  shape.observations = 12;
  shape.branches = {3, 3, 3, 2};
  return {"dummy", [](int lanes) { return std::make_unique<DummyBackend>(lanes); }, shape};
}

INSTANTIATE_TEST_SUITE_P(
    All, BackendContract,
    testing::Values(
        dummy_case(), sim_case("paper", "paper"), sim_case("omentum", "omentum"),
        // A short episode brings resets, a near start brings grasp and contact into the 40 ... 100
        // steps.
        sim_case("omentum_short", "omentum",
                 {"task.episode_steps=23", "scene.start_grid.centre_m={ x: 0.005 y: 0.04 z: 0.05 }",
                  "task.start_height_range_m=0.015"}),
        sim_case("omentum_elastic", "omentum_elastic"),
        sim_case("omentum_elastic_short", "omentum_elastic",
                 {"task.episode_steps=23", "scene.start_grid.centre_m={ x: 0.005 y: 0.04 z: 0.05 }",
                  "task.start_height_range_m=0.015"}),
        sim_case("omentum_continuous", "omentum", {"task.action=ACTION_CONTINUOUS"}),
        sim_case("omentum_plastic", "omentum",
                 {"scene.tissue.cluster.plastic_creep=0.1",
                  "scene.tissue.cluster.plastic_threshold_m2=1e-8",
                  "scene.tissue.cluster.self_collision=true", "scene.tissue.grid.count_x=12"}),
        sim_case("omentum_image", "omentum",
                 {"task.observation=OBSERVATION_IMAGE", "task.image_size=16"})),
    [](const auto& param_info) { return param_info.param.name; });

}  // namespace
}  // namespace omentum::test
