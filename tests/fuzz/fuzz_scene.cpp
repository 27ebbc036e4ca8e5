#include <cstddef>
#include <cstdint>
#include <string>

#include "core/check.h"
#include "core/config.h"
#include "sim_worker/scene/scene.h"

// Any text gives a scene or an Error: nothing else may leave parse_config and make_scene.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

/// Every mesh becomes a file that is not there: readers have a target of their own, and the fuzzer
/// must not open what it dreams up.
void hide_meshes(omentum::pb::Scene& scene) {
  if (scene.tissue().volume().has_mesh()) {
    scene.mutable_tissue()->mutable_volume()->mutable_mesh()->set_path("absent.obj");
  }
  for (omentum::pb::RigidBody& body : *scene.mutable_rigid_body()) {
    if (body.has_mesh()) body.mutable_mesh()->set_path("absent.obj");
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  try {
    omentum::pb::Config config = omentum::parse_config("fuzz", text);
    hide_meshes(*config.mutable_scene());
    const omentum::Scene scene = omentum::make_scene(config.scene(), "absent");
    if (scene.tissue.particles.empty()) __builtin_trap();
    // What was accepted prints and parses to the same run.
    const omentum::pb::Config again = omentum::parse_config("again", omentum::print_config(config));
    if (omentum::config_hash(again) != omentum::config_hash(config)) __builtin_trap();
  } catch (const omentum::Error&) {
  }
  return 0;
}
