#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "mismatch/scene/believed_scene.h"

// Any text gives a scene, or one line that names the file.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  const auto made = omentum::parse_believed_scene("fuzz", text);
  if (!made) {
    const std::string& error = made.error();
    if (!error.starts_with("fuzz:") || error.find('\n') != std::string::npos) __builtin_trap();
    return 0;
  }
  for (const Eigen::Vector3d& p : made.value().pinch_W) {
    if (!p.allFinite()) __builtin_trap();
  }
  for (const std::string& warning : made.value().warnings) {
    if (warning.find('\n') != std::string::npos) __builtin_trap();
  }
  const omentum::pb::Tissue& tissue = made.value().scene.tissue();
  if (!std::isfinite(tissue.thickness_m()) || !std::isfinite(tissue.anchor_max_y_m()))
    __builtin_trap();
  return 0;
}
