#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/episode_recording.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {

/// What came of one recording.
struct ReplayReport {
  bool identical = false;   ///< every step there is, bit for bit
  bool complete = true;     ///< the whole file could be read; else it was cut off or is corrupt
  std::uint32_t steps = 0;  ///< compared and equal
  std::string text;         ///< one line: "identical steps=N" or the first difference
};

/// Runs recorded actions again, in the simulation made from the recording's own configuration text,
/// and compares observations, rewards, flags, exposures and state hashes bit for bit. Keeps the
/// simulation as long as recordings of the same configuration follow each other. Not thread-safe.
class Replayer {
 public:
  /// The result does not depend on the kernel width; 1 is the cheapest for one environment.
  explicit Replayer(unsigned lane_width = 1) : lane_width_(lane_width) {}

  /// Throws Error (one line) for a file that is no recording or cannot be run here.
  ReplayReport replay(const std::string& path);
  ReplayReport replay(const std::string& name, const EpisodeRecording& recording);

 private:
  void prepare(const std::string& name, const EpisodeRecording& recording);
  RolloutSegment run_again(const RolloutTask& task, const RolloutSegment& recorded);

  unsigned lane_width_;
  std::string prepared_for_;
  std::unique_ptr<SimBackend> backend_;
};

}  // namespace omentum
