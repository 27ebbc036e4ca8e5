#pragma once

#include "core/types.h"
#include "proto/bus.pb.h"

namespace omentum {

/// The records of the bus as messages of proto/bus.proto, field by field.
pb::bus::PolicyWeights to_message(const PolicyWeights& from);
pb::bus::RolloutSegment to_message(const RolloutSegment& from);
pb::bus::WorkerStatus to_message(const WorkerStatus& from);
pb::bus::LearnerStatus to_message(const LearnerStatus& from);
pb::bus::EpisodeSummary to_message(const EpisodeSummary& from);
pb::bus::RunManifest to_message(const RunManifest& from);
pb::bus::ControlCommand to_message(const ControlCommand& from);
pb::bus::ControlReply to_message(const ControlReply& from);
pb::bus::SimFrame to_message(const SimFrame& from);
pb::bus::RobotStatus to_message(const RobotStatus& from);

}  // namespace omentum
