#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "core/dds.h"
#include "core/wire.h"
#include "monitor/run_state.h"
#include "monitor/tool.h"

namespace omentum {

/// Reads the topics of a run that tell how it does. Writes nothing; no writer waits for it, since
/// all it reads is KEEP_LAST. One thread; wake() from any.
class RunWatch {
 public:
  /// Throws Error. Without `with_frames` no frames are read.
  RunWatch(const dds::Participant& participant, const std::string& run, bool with_frames);

  /// Waits up to `timeout_ns` for something to arrive and hands all that is there to `state`.
  void wait(std::int64_t timeout_ns);
  void take_into(RunState& state, const std::function<void(SimFrame&&)>& on_frame = {});
  void wake() { waitset_.wake(); }
  /// Samples that arrived but failed the checks of core/wire.h.
  std::uint64_t refused() const;

 private:
  BusReader<LearnerStatus> learner_;
  BusReader<WorkerStatus> workers_;
  BusReader<RunManifest> manifest_;
  BusReader<EpisodeSummary> episodes_;
  BusReader<RobotStatus> robots_;
  std::optional<BusReader<SimFrame>> frames_;
  dds::Waitset waitset_;
};

/// A tool's place in the domain of a run, made anew where it is deaf (docs/trust.md 2).
class RunLink {
 public:
  RunLink(const ToolOptions& options, const std::string& name, bool with_frames)
      : options_(options), name_(name), with_frames_(with_frames) {}

  /// Joins. False when asked to stop meanwhile. Throws Error.
  bool join();
  /// A learner's process is there and of this run none speaks: all that was made from the
  /// participant must go, and join() comes next. At most every ten seconds.
  bool is_deaf(const RunState& state, std::int64_t now_ns);
  void leave();

  const dds::Participant& participant() const { return *participant_; }
  RunWatch& watch() { return *watch_; }

 private:
  ToolOptions options_;
  std::string name_;
  bool with_frames_;
  std::unique_ptr<dds::Participant> participant_;
  std::unique_ptr<RunWatch> watch_;  // after it
  std::int64_t asked_ns_ = 0;
};

}  // namespace omentum
