#include "core/topics.h"

#include <array>

#include "core/check.h"

namespace omentum {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kS = 1000 * kMs;

constexpr std::array<TopicSpec, 7> kTopics{{
    {TopicId::kPolicyWeights, "omentum/policy/weights", "PolicyWeights", "policy_id, learner_epoch",
     History::kKeepLast, 2, Durability::kTransientLocal, 2, 1 * kS, 0, true,
     "two versions are alive with lead 1; a late joiner gets the last two; KEEP_LAST never blocks "
     "the learner; the epoch in the key keeps two learners apart without exclusive ownership"},
    {TopicId::kRolloutTask, "omentum/rollout/task", "RolloutTask", "slot", History::kKeepLast, 1,
     Durability::kVolatile, 0, 1 * kS, 0, false,
     "directed to one worker: Cyclone has no writer-side filter; a newer grant of a slot replaces "
     "the older one; granted only after the writer is matched"},
    {TopicId::kRolloutSegment, "omentum/rollout/segment", "RolloutSegment", "none",
     History::kKeepAll, 0, Durability::kVolatile, 0, 2 * kS, 0, true,
     "bulk path: nothing may be lost, and identity is (slot, segment), not the writer; the "
     "reader's "
     "max_samples is a fuse that never blows because tasks are credits"},
    {TopicId::kWorkerStatus, "omentum/worker/status", "WorkerStatus", "worker_id",
     History::kKeepLast, 1, Durability::kTransientLocal, 1, 1 * kS, 2 * kS, true,
     "failure detector: disposed = left, no writers = crashed; deadline = hung"},
    {TopicId::kLearnerStatus, "omentum/learner/status", "LearnerStatus", "run_id, learner_epoch",
     History::kKeepLast, 1, Durability::kTransientLocal, 1, 1 * kS, 2 * kS, true,
     "workers keep their segments while it is silent and follow the highest epoch"},
    {TopicId::kEpisodeSummary, "omentum/episode/summary", "EpisodeSummary", "none",
     History::kKeepLast, 256, Durability::kVolatile, 0, 1 * kS, 0, true,
     "written by the learner after admission: a worker would repeat it for a re-granted segment"},
    {TopicId::kRunManifest, "omentum/run/manifest", "RunManifest", "run_id, learner_epoch",
     History::kKeepLast, 1, Durability::kTransientLocal, 1, 1 * kS, 0, true,
     "configuration of the run, written before the first weights"},
}};

}  // namespace

std::span<const TopicSpec> topics() { return kTopics; }

const TopicSpec& topic_spec(TopicId id) {
  const auto index = static_cast<std::size_t>(id);
  OMENTUM_CHECK(index < kTopics.size() && kTopics[index].id == id);
  return kTopics[index];
}

std::vector<std::string> public_partitions(const std::string& run) { return {"", run}; }

std::vector<std::string> run_partition(const std::string& run) { return {run}; }

std::vector<std::string> worker_partition(const std::string& run, std::uint32_t worker_id) {
  return {fmt::format("{}/w{}", run, worker_id)};
}

void check_run_name(const std::string& run) {
  const std::string allowed = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-.";
  if (run.empty() || run.size() > 100 || run.find_first_not_of(allowed) != std::string::npos ||
      run.front() == '-' || run.front() == '.') {
    throw_error("run.name \"{}\": 1 to 100 of A-Z a-z 0-9 _ - . and neither - nor . first", run);
  }
}

}  // namespace omentum
