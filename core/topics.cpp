#include "core/topics.h"

#include <array>

#include "core/check.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;

constexpr std::array<TopicSpec, 13> kTopics{{
    {TopicId::kPolicyWeights, "omentum/policy/weights", true, History::kKeepLast, 2,
     Durability::kTransientLocal, 2, 1 * kS, 0},
    {TopicId::kRolloutTask, "omentum/rollout/task", true, History::kKeepLast, 1,
     Durability::kVolatile, 0, 1 * kS, 0},
    {TopicId::kRolloutSegment, "omentum/rollout/segment", true, History::kKeepAll, 0,
     Durability::kVolatile, 0, 2 * kS, 0},
    {TopicId::kWorkerStatus, "omentum/worker/status", true, History::kKeepLast, 1,
     Durability::kTransientLocal, 1, 1 * kS, 2 * kS},
    {TopicId::kLearnerStatus, "omentum/learner/status", true, History::kKeepLast, 1,
     Durability::kTransientLocal, 1, 1 * kS, 2 * kS},
    {TopicId::kEpisodeSummary, "omentum/episode/summary", true, History::kKeepLast, 256,
     Durability::kVolatile, 0, 1 * kS, 0},
    {TopicId::kRunManifest, "omentum/run/manifest", true, History::kKeepLast, 1,
     Durability::kTransientLocal, 1, 1 * kS, 0},
    {TopicId::kControlCommand, "omentum/control/command", true, History::kKeepLast, 16,
     Durability::kVolatile, 0, 1 * kS, 0},
    {TopicId::kControlReply, "omentum/control/reply", true, History::kKeepLast, 16,
     Durability::kVolatile, 0, 1 * kS, 0},
    {TopicId::kSimFrame, "omentum/sim/frame", false, History::kKeepLast, 1, Durability::kVolatile,
     0, 1 * kS, 0},
    {TopicId::kRobotState, "omentum/robot/state", false, History::kKeepLast, 1,
     Durability::kVolatile, 0, 1 * kS, 0},
    {TopicId::kSimulationTask, "omentum/simulation/task", true, History::kKeepLast, 1,
     Durability::kVolatile, 0, 1 * kS, 0},
    {TopicId::kSimulationResult, "omentum/simulation/result", true, History::kKeepAll, 0,
     Durability::kVolatile, 0, kS / 5, 0},
}};

}  // namespace

std::span<const TopicSpec> topics() { return kTopics; }

const TopicSpec& topic_spec(TopicId id) {
  const auto index = static_cast<std::size_t>(id);
  OMENTUM_CHECK(index < kTopics.size() && kTopics[index].id == id);
  return kTopics[index];
}

std::vector<std::string> public_partitions(const std::string& run) { return {"", run}; }

std::vector<std::string> mirror_partitions(const std::string& run) { return {"", run + "/hub"}; }

std::vector<std::string> tool_partitions(const std::string& run) { return {run, run + "/hub"}; }

std::vector<std::string> run_partition(const std::string& run) { return {run}; }

std::vector<std::string> worker_partition(const std::string& run, std::uint32_t worker_id) {
  return {fmt::format("{}/w{}", run, worker_id)};
}

std::vector<std::string> asker_partition(const std::string& run, std::uint32_t asker_id) {
  return {fmt::format("{}/a{}", run, asker_id)};
}

void check_run_name(const std::string& run) {
  const std::string allowed = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-.";
  if (run.empty() || run.size() > 100 || run.find_first_not_of(allowed) != std::string::npos ||
      run.front() == '-' || run.front() == '.') {
    throw_error("run.name \"{}\": 1 to 100 of A-Z a-z 0-9 _ - . and neither - nor . first", run);
  }
}

}  // namespace omentum
