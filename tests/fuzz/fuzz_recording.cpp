#include <cstddef>
#include <cstdint>
#include <sstream>
#include <string>

#include "core/ply.h"
#include "dvrk_gateway/recording/motion.h"
#include "dvrk_gateway/recording/sensor_samples.h"
#include "dvrk_gateway/recording/wire_log.h"

// Any bytes: as a wire log, a recording with every line accounted for, or one line why not; as a
// line or rows of a sensor, as a cloud and as a recording to replay, samples or one line.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

void require_one_line(const std::string& error) {
  if (error.empty() || error.find('\n') != std::string::npos) __builtin_trap();
}

void convert(const std::string& text) {
  std::istringstream log(text);
  std::ostringstream out;
  const auto counts = omentum::convert_wire_log(log, {}, out);
  if (!counts) {
    require_one_line(counts.error());
    return;
  }
  const omentum::McapContent content = omentum::read_mcap(out.str());
  if (!content.complete || !content.problems.empty()) __builtin_trap();
  // The motion of what was converted is a motion, or too short to be one.
  const auto motion = omentum::parse_motion("fuzz", out.str());
  if (!motion && motion.error().find("two poses of one time") != std::string::npos)
    __builtin_trap();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using omentum::SensorKind;
  const std::string text(reinterpret_cast<const char*>(data), size);
  convert(text);
  for (const SensorKind kind : {SensorKind::kForce, SensorKind::kMarkers, SensorKind::kTracker,
                                SensorKind::kCloud, SensorKind::kColor}) {
    const auto message = omentum::parse_sensor_json(kind, text);
    if (!message) require_one_line(message.error());
    if (kind == SensorKind::kCloud || kind == SensorKind::kColor) continue;  // names of files
    const std::string header = text.substr(0, text.find('\n'));
    const auto rows = omentum::parse_sensor_rows(kind, "fuzz", "", header,
                                                 text.substr(std::min(size, header.size() + 1)));
    if (!rows) require_one_line(rows.error());
  }
  const auto points = omentum::parse_ply("fuzz", text);
  if (!points) require_one_line(points.error());
  return 0;
}
