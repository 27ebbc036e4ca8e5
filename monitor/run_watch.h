#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "core/dds.h"
#include "core/wire.h"
#include "monitor/run_state.h"

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

}  // namespace omentum
