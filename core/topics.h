#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace omentum {

/// The topics that travel between the programs. Index into topics().
enum class TopicId : std::uint32_t {
  kPolicyWeights,
  kRolloutTask,
  kRolloutSegment,
  kWorkerStatus,
  kLearnerStatus,
  kEpisodeSummary,
  kRunManifest,
  kControlCommand,
  kControlReply,
  kSimFrame,
  kRobotState,
  kSimulationTask,
  kSimulationResult,
};

enum class History { kKeepLast, kKeepAll };
enum class Durability { kVolatile, kTransientLocal };

/// One row of the table of docs/wire.md 3, which says why: everything about a topic but its fields.
/// Nothing else in the product names a topic or a policy. All topics have SHARED ownership and
/// AUTOMATIC liveliness: other kinds would hide them from generic tools.
struct TopicSpec {
  TopicId id;
  const char* name;
  bool reliable;
  History history;
  int depth;  ///< of KEEP_LAST, both sides
  Durability durability;
  int service_depth;             ///< samples for a late joiner with TRANSIENT_LOCAL
  std::int64_t max_blocking_ns;  ///< how long a write may wait; only KEEP_ALL writers ever do
  std::int64_t deadline_ns;      ///< offered and requested; 0 = infinite
};

std::span<const TopicSpec> topics();
const TopicSpec& topic_spec(TopicId id);

// Names of partitions. `run` must have passed check_run_name(), else DDS may read it as a pattern.

/// Partitions a public topic is written into: "" for generic tools, which have no partition option,
/// and the run.
std::vector<std::string> public_partitions(const std::string& run);
/// Where the learner of a hub repeats what workers publish, and what tools of ours read: the run
/// itself and, in a hub, that.
std::vector<std::string> mirror_partitions(const std::string& run);
std::vector<std::string> tool_partitions(const std::string& run);
/// The partition our readers join.
std::vector<std::string> run_partition(const std::string& run);
/// Tasks of one worker: "<run>/w<worker_id>".
std::vector<std::string> worker_partition(const std::string& run, std::uint32_t worker_id);
/// Results of simulations that one program asked for: "<run>/a<asker_id>".
std::vector<std::string> asker_partition(const std::string& run, std::uint32_t asker_id);

/// Throws Error unless the name of a run can be a partition and a folder: 1 to 100 letters, digits,
/// '_', '-', '.', the first neither '-' (an option) nor '.' (hidden); DDS would read '*', '?' and
/// '[' as wildcards and '/' separates the worker part.
void check_run_name(const std::string& run);

}  // namespace omentum
