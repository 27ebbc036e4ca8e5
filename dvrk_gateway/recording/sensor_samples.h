#pragma once

#include <google/protobuf/message.h>

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// Samples of sensors beside the robot (docs/formats.md 12): force, markers, tracker, cloud, color,
/// depth. Everything here is total over any bytes; any thread.

enum class SensorKind { kForce, kMarkers, kTracker, kCloud, kColor, kDepth };

/// force, markers ...; nothing for another word.
std::optional<SensorKind> sensor_kind(std::string_view name);
/// Channel of a recording: /force ...
std::string sensor_topic(SensorKind kind);

using SensorMessage = std::shared_ptr<const google::protobuf::Message>;

/// One JSON object of a sensor. Fails with one line: no JSON object, a member that is missing, not
/// known or no finite number, a count of numbers that does not fit. Images come by files alone.
Result<SensorMessage> parse_sensor_json(SensorKind kind, std::string_view text);

/// Rows of a table of docs/formats.md 3: `header` and one or more lines below it. `folder`: where
/// the files lie that rows of clouds and images name. Fails, as a whole, with one line.
Result<std::vector<SensorMessage>> parse_sensor_rows(SensorKind kind, const std::string& name,
                                                     const std::string& folder,
                                                     const std::string& header,
                                                     std::string_view lines);

}  // namespace omentum
