#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/mcap.h"
#include "core/psm.h"
#include "core/result.h"
#include "core/types.h"
#include "proto/config.pb.h"

namespace omentum {

/// What a recording carries beside task and segment, so that the file explains itself.
struct RecordingContext {
  std::string name;         ///< evaluation set, e.g. grid100_greedy
  std::string config_text;  ///< resolved configuration
  std::uint64_t config_hash = 0;
  std::string git_revision;
  double control_period = 0.02;  ///< time between decisions [s]
  std::uint32_t particles = 0;   ///< of the tissue; 0 = no frames
};

/// What recordings of a configuration have in common; particles are left at 0.
RecordingContext recording_context(const pb::Config& config, const std::string& name,
                                   const std::string& git_revision);

/// One evaluation episode as recorded: the task that made it and the steps it brought. Frame f of
/// segment.frame_positions_in_world_m is the tissue before step frame_steps[f].
struct EpisodeRecording {
  RecordingContext context;
  RolloutTask task;
  RolloutSegment segment;
  std::vector<std::uint32_t> frame_steps;
  bool complete = false;              ///< the file has its end; else what was there is here
  std::vector<std::string> problems;  ///< one line each: the MCAP reader's, and messages dropped
};

/// How the tool is turned before every step, as it was observed; empty where it does not turn.
/// Throws Error for a configuration that cannot be read.
std::vector<RollPitchYaw> turns_of_steps(const RolloutSegment& segment,
                                         const std::string& config_text);

/// Writes episodes into an MCAP file that may hold other streams too (channels:
/// proto/recording.proto).
class EpisodeWriter {
 public:
  /// Declares the channels; `with_tool`: that of the simulated tool as well, which in a recording
  /// of a robot shows the robot's. `writer` must outlive it.
  EpisodeWriter(McapWriter& writer, bool with_tool);

  /// One episode as a block, its first decision at `start_ns` of the log clock. Frames are taken to
  /// be task.frame_stride steps apart, beginning at step 0; the last one may lie after the last
  /// step. Fails, naming `path`, if the arrays of the segment do not fit `steps`; nothing is
  /// written then.
  Result<void> write(const std::string& path, const RolloutTask& task,
                     const RolloutSegment& segment, const RecordingContext& context,
                     std::uint64_t start_ns);

 private:
  McapWriter& writer_;
  McapWriter::ChannelId episode_, step_;
  std::optional<McapWriter::ChannelId> tool_;
  McapWriter::ChannelId tissue_ = 0, result_ = 0;
};

/// Writes one episode to an MCAP file of its own, replacing it; log time 0 is its first decision.
/// Fails, naming the path, as EpisodeWriter::write does, or if the disk does not take it.
Result<void> save_episode(const std::string& path, const RolloutTask& task,
                          const RolloutSegment& segment, const RecordingContext& context);

/// Reads it back; save and load are inverse for every field that recording.proto names. Of a
/// truncated file the steps of its whole chunks are read. Fails if there is no file or no episode
/// header in it. Of a file of several episodes this is the first, and `problems` says so.
Result<EpisodeRecording> load_episode(const std::string& path);

/// The recordings that a path stands for: itself; of a folder its *.mcap, or those of its
/// recordings/, in order of name. Throws Error for a folder without any.
std::vector<std::string> recordings_of(const std::string& path);

/// As load_episode, from bytes; the entry of the fuzz target.
Result<EpisodeRecording> parse_episode(const std::string& name, const std::string& bytes);

/// All episodes of a file, in file order.
Result<std::vector<EpisodeRecording>> parse_episodes(const std::string& name,
                                                     const std::string& bytes);

}  // namespace omentum
