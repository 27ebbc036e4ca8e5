#pragma once

#include <string>

#include "core/wire.h"

namespace omentum {

/// In a hub tools find the learner only: it writes again what workers and gateways publish, into
/// the partitions of mirror_partitions(), where no program of the run reads. One thread.
class HubMirror {
 public:
  HubMirror(const dds::Participant& participant, const std::string& run);

  void worker(const WorkerStatus& status);
  /// It left or was lost.
  void gone(const WorkerStatus& status);
  void segment(const RolloutSegment& segment);
  void frame(const SimFrame& frame);
  void reply(const ControlReply& reply);
  void robot(const RobotStatus& status);
  /// To the workers, whom an operator cannot reach.
  void forward(ControlCommand command);
  static bool is_forwarded(const ControlCommand& command);

 private:
  BusWriter<WorkerStatus> workers_;
  BusWriter<RolloutSegment> segments_;
  BusWriter<SimFrame> frames_;
  BusWriter<ControlReply> replies_;
  BusWriter<RobotStatus> robots_;
  BusWriter<ControlCommand> commands_;
};

}  // namespace omentum
