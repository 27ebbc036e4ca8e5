#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

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
  // As the value of one knob it changes that knob or is refused in one line.
  try {
    const auto rest_with = [](const std::vector<std::string>& sets) {
      static const std::string path = omentum::deploy_dir() + "/scenes/omentum.txtpb";
      omentum::pb::Scene scene = omentum::load_scene(path, sets);
      scene.mutable_tool()->clear_roll_deg();
      return scene.SerializeAsString();
    };
    static const std::string rest = rest_with({});
    if (rest_with({"scene.tool.roll_deg=" + text}) != rest) __builtin_trap();
  } catch (const omentum::Error& error) {
    if (std::string(error.what()).find('\n') != std::string::npos) __builtin_trap();
  }
  try {
    omentum::pb::Config config = omentum::parse_config("fuzz", text);
    hide_meshes(*config.mutable_scene());
    const omentum::Scene scene = omentum::make_scene(config.scene(), "absent");
    if (config.scene().has_tissue() && scene.tissue.particles.empty()) __builtin_trap();
    // What was accepted prints and parses to the same run.
    const omentum::pb::Config again = omentum::parse_config("again", omentum::print_config(config));
    if (omentum::config_hash(again) != omentum::config_hash(config)) __builtin_trap();
  } catch (const omentum::Error&) {
  }
  return 0;
}
