#include <cstddef>
#include <cstdint>
#include <string>

#include "core/check.h"
#include "core/registration_file.h"
#include "core/touched_points.h"

// Any text gives a registration that prints to the same, or one line that names the file; as a
// table of touches, touches or one such line.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  const auto is_told = [](const std::string& error) {
    return error.starts_with("fuzz:") && error.find('\n') == std::string::npos;
  };
  try {
    const omentum::Registration registration = omentum::parse_registration("fuzz", text);
    if (registration.points.size() < 4) __builtin_trap();
    const std::string printed = omentum::print_registration(registration);
    const omentum::Registration again = omentum::parse_registration("again", printed);
    if (again.points.size() != registration.points.size()) __builtin_trap();
  } catch (const omentum::Error& error) {
    if (!is_told(error.what())) __builtin_trap();
  }
  const omentum::Result<omentum::CsvTable> table = omentum::parse_csv("fuzz", text);
  if (!table) return 0;
  for (const bool with_world : {true, false}) {
    const auto touches = omentum::read_touches(table.value(), with_world);
    if (!touches && !is_told(touches.error())) __builtin_trap();
    if (!touches) continue;
    if (touches.value().size() != table.value().rows.size()) __builtin_trap();
    for (const omentum::Touch& touch : touches.value()) {
      if (!touch.pose_RC.p.allFinite() || !touch.pose_RC.R.allFinite()) __builtin_trap();
    }
  }
  return 0;
}
