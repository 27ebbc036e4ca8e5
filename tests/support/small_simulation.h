#pragma once

#include <string>

#include "core/config.h"
#include "sim_worker/playback/simulation.h"

/// A simulation of a recording that takes milliseconds.
namespace omentum::test {

/// A sheet of 3 x 4 particles, clamped at one edge, whose other one jaws lift for two steps.
inline SimulationTask small_simulation(pb::TissueModelKind model) {
  pb::Scene scene;
  parse_text_proto("small", R"(
tissue { grid { count_x: 3 count_y: 4 pitch_m: 0.003 } thickness_m: 0.003 anchor_max_y_m: -0.004
  material { damping_per_s: 5 } reference { elements_x: 1 elements_y: 1 elements_z: 1 } }
tool { base { translation_m { x: 0.1427 z: 0.1584 } } contact: false })",
                   scene);
  scene.mutable_tissue()->set_model(model);
  SimulationTask task;
  task.scene = override_scene(scene, {});
  task.commands.time = {0, 0.04};
  task.commands.p_WT = {{0, 0.0045, 0}, {0, 0.0045, 0.001}};
  task.commands.jaw_rad = {0, 0};
  task.commands.path = "tool.csv";
  task.from_rest = false;
  return task;
}

}  // namespace omentum::test
