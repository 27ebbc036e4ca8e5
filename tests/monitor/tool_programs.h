#pragma once

#include <atomic>
#include <string>
#include <thread>

#include "core/wire.h"
#include "tests/integration/programs.h"

namespace omentum::test {

/// Stands in for the learner's side of control/command: answers every command, and refuses slots
/// from 100 on.
class Responder {
 public:
  Responder(std::uint32_t domain, std::string run)
      : run_(std::move(run)), participant_(domain, loopback_profile().uri, "responder") {
    thread_ = std::jthread([this](const std::stop_token& stop) { answer(stop); });
  }
  int answered() const { return answered_; }
  bool frames_on() const { return frames_on_; }

 private:
  void answer(const std::stop_token& stop) {
    BusReader<ControlCommand> commands(participant_, run_partition(run_), "responder-commands");
    BusWriter<ControlReply> replies(participant_, public_partitions(run_), "responder-replies");
    while (!stop.stop_requested()) {
      (void)commands.take(16, [&](Arrival<ControlCommand>&& arrival) {
        if (!arrival.info.valid) return;
        const ControlCommand& command = arrival.record;
        ControlReply reply;
        reply.run_id = run_;
        reply.request = command.request;
        reply.program = "learner";
        reply.done = command.slot < 100;
        reply.text = reply.done ? "as you wish" : "there is no such slot";
        if (command.action == ControlAction::kFramesOn && reply.done) frames_on_ = true;
        if (command.action == ControlAction::kFramesOff) frames_on_ = false;
        if (replies.write(reply)) ++answered_;
      });
      std::this_thread::sleep_for(std::chrono::milliseconds(5));  // polls
    }
  }

  std::string run_;
  dds::Participant participant_;
  std::atomic<int> answered_ = 0;
  std::atomic<bool> frames_on_ = false;
  std::jthread thread_;  // last: it uses the others
};

/// The program `omentum` on the domain of `programs`.
inline Strings tool(const Programs& programs, const std::string& subcommand, const std::string& run,
                    const Strings& more = {}) {
  return Strings{OMENTUM_TOOL, subcommand, "--run",
                 run,          "--domain", std::to_string(programs.domain())} +
         more;
}

}  // namespace omentum::test
