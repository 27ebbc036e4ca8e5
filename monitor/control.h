#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "core/types.h"
#include "core/wire.h"
#include "monitor/tool.h"

namespace omentum {

/// Publishes commands of one run and finds their replies. One thread.
class Operator {
 public:
  /// Throws Error, also where DDS Security denies this role to write commands.
  Operator(const dds::Participant& participant, const std::string& run, const std::string& issuer);

  /// Waits until somebody reads commands, up to `timeout_s`; false if nobody does.
  bool wait_for_reader(double timeout_s);
  /// Sends and does not wait; the request's number. A command that has one keeps it.
  Result<std::uint64_t> send(ControlCommand command);
  /// The reply to a request, up to `timeout_s`; nothing where none came.
  std::optional<ControlReply> wait_for_reply(std::uint64_t request, double timeout_s);

 private:
  std::string run_, issuer_;
  BusWriter<ControlCommand> commands_;
  BusReader<ControlReply> replies_;
  dds::Waitset waitset_;
};

struct ControlOptions {
  ToolOptions tool;
  ControlCommand command;  ///< action, worker_id, slot, frames_hz
  double timeout_s = 10;
};

/// Exit code: 0 done, 1 refused or no answer.
int run_control(const ControlOptions& options);

}  // namespace omentum
