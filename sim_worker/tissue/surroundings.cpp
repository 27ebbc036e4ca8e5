#include "sim_worker/tissue/surroundings.h"

#include "core/check.h"
#include "sim_worker/lanes/lane_kernel.h"

namespace omentum {

Surroundings make_surroundings(const Scene& scene) {
  if (scene.bodies.size() + 1 > kMaxShapes) {
    throw_error("scene.rigid_body: {} bodies, allowed at most {}", scene.bodies.size(),
                kMaxShapes - 1);
  }
  const pb::Tool& tool = scene.config.tool();
  Surroundings around;
  around.gravity = scene.gravity;
  around.static_friction = scene.config.tissue().static_friction();
  around.dynamic_friction = scene.config.tissue().dynamic_friction();
  around.bodies = scene.bodies;
  around.tool_contact = tool.contact();
  around.tool_radius = tool.shaft_radius_m();
  around.tool_start = tool.shaft_start_m() + tool.shaft_radius_m();
  around.tool_length = tool.shaft_length_m();
  around.shaft_axis = -scene_tool_mount(scene).jaw_direction();
  return around;
}

}  // namespace omentum
