#include "sim_worker/bus/task_queue.h"

#include <algorithm>
#include <tuple>
#include <utility>

namespace omentum {
namespace {

// Tasks of one group arrive within moments of each other: the wait for them, as a fraction of the
// last group's duration, which bounds its cost.
constexpr double kGatherFraction = 0.05;
constexpr std::int64_t kLeastGatherNs = 300'000;
constexpr std::int64_t kMostHolds = 4;  // x the wait, while tasks keep arriving one by one

auto key(const RolloutTask& t) {
  return std::tie(t.policy_version, t.weights_hash, t.kind, t.steps, t.greedy, t.frame_stride);
}

}  // namespace

bool TaskQueue::push(RolloutTask task, std::int64_t now_ns) {
  const auto same = std::find_if(entries_.begin(), entries_.end(), [&task](const Entry& waiting) {
    return waiting.task.slot == task.slot;
  });
  const bool replaced = same != entries_.end();
  if (replaced) entries_.erase(same);
  last_arrival_ns_ = now_ns;
  entries_.push_back({std::move(task), now_ns});
  return replaced;
}

void TaskQueue::erase_if(const std::function<bool(const Entry&)>& unfit) {
  std::erase_if(entries_, unfit);
}

std::vector<TaskQueue::Entry> TaskQueue::next_group(
    std::size_t lanes, const std::function<bool(const RolloutTask&)>& ready, std::int64_t now_ns) {
  hold_until_ns_ = 0;
  const Entry* first = nullptr;
  for (const Entry& entry : entries_) {
    if (!ready(entry.task)) continue;
    if (first == nullptr || entry.task.segment < first->task.segment) first = &entry;
  }
  if (first == nullptr) return {};
  const RolloutTask pattern = first->task;
  const auto fits = [&pattern](const Entry& entry) { return key(entry.task) == key(pattern); };
  const auto count = std::count_if(entries_.begin(), entries_.end(), fits);
  if (static_cast<std::size_t>(count) < lanes) {
    // The next tasks of the previous group's slots arrive soon. Without a wait for them, tasks that
    // are once late would run in groups of their own from then on.
    const std::int64_t quiet_since = std::max(last_arrival_ns_, group_end_ns_);
    const std::int64_t since = std::max(first->at_ns, group_end_ns_);
    const std::int64_t until = std::min(quiet_since + gather_ns_, since + kMostHolds * gather_ns_);
    if (now_ns < until) {
      hold_until_ns_ = until;
      return {};
    }
  }
  std::vector<Entry> group;
  for (auto at = entries_.begin(); at != entries_.end() && group.size() < lanes;) {
    if (!fits(*at)) {
      ++at;
      continue;
    }
    group.push_back(std::move(*at));
    at = entries_.erase(at);
  }
  return group;
}

void TaskQueue::group_ran(std::int64_t begin_ns, std::int64_t end_ns) {
  group_end_ns_ = end_ns;
  gather_ns_ = std::clamp(
      static_cast<std::int64_t>(kGatherFraction * static_cast<double>(end_ns - begin_ns)),
      kLeastGatherNs, kMostGatherNs);
}

}  // namespace omentum
