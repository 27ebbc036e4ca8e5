#include "granting/worker_list.h"

#include <algorithm>

namespace omentum {
namespace {

// Of so many that left, late results still count.
constexpr std::size_t kLeftKept = 4096;

}  // namespace

/// Whether there is room for a worker of this participant; makes some where one is silent.
bool WorkerList::may_come(std::uint64_t participant, std::int64_t now_ns) {
  if (participant != 0 && worker_of_.contains(participant)) return false;
  // Those that left are listed until they are taken.
  if (workers_.size() >= 2 * kMostWorkers) return false;
  if (count_alive_ < kMostWorkers) return true;
  const auto oldest = std::ranges::min_element(workers_, {}, [](const auto& entry) {
    return entry.second.alive ? entry.second.at_ns : INT64_MAX;
  });
  if (now_ns - oldest->second.at_ns < kQuietNs) return false;
  ++pushed_out_;
  gone(oldest->first, oldest->second, true);
  return true;
}

void WorkerList::gone(std::uint32_t worker_id, ListedWorker& worker, bool crashed) {
  --count_alive_;
  worker.alive = false;
  worker.crashed = crashed;
  const auto own = worker_of_.find(worker.participant);
  if (own != worker_of_.end() && own->second == worker_id) worker_of_.erase(own);
  changed_.insert(worker_id);
  left_.push_back(worker_id);
  if (left_.size() <= kLeftKept) return;
  const auto first = workers_.find(left_.front());  // may have joined anew since
  if (first == workers_.end() || !first->second.alive) participant_of_.erase(left_.front());
  left_.pop_front();
}

WorkerList::Event WorkerList::note(Arrival<WorkerStatus>&& arrival, std::int64_t now_ns) {
  const std::uint32_t id = arrival.record.worker_id;
  const auto found = workers_.find(id);
  const bool was_alive = found != workers_.end() && found->second.alive;
  const bool alive = arrival.info.valid && arrival.info.state == dds::InstanceState::kAlive;
  if (!alive) {
    if (!was_alive) return Event::kNothing;
    const bool crashed = arrival.info.state != dds::InstanceState::kDisposed;
    gone(id, found->second, crashed);
    return crashed ? Event::kCrashed : Event::kLeft;
  }
  if (was_alive ? found->second.writer != arrival.info.writer
                : !may_come(arrival.info.participant, now_ns)) {
    ++refused_;
    return Event::kRefused;
  }
  ListedWorker& worker = workers_[id];
  if (!was_alive) {
    // One that rejoined, with a certificate renewed, is another participant.
    ++count_alive_;
    worker.participant = arrival.info.participant;
    participant_of_[id] = worker.participant;
    if (worker.participant != 0) worker_of_[worker.participant] = id;
  }
  worker.status = std::move(arrival.record);
  worker.writer = arrival.info.writer;
  worker.at_ns = now_ns;
  worker.alive = true;
  worker.crashed = false;
  changed_.insert(id);
  return was_alive ? Event::kSpoke : Event::kCame;
}

std::vector<std::pair<std::uint32_t, ListedWorker>> WorkerList::take_changed() {
  std::vector<std::pair<std::uint32_t, ListedWorker>> changed;
  for (const std::uint32_t id : std::exchange(changed_, {})) {
    const auto found = workers_.find(id);
    changed.emplace_back(id, found->second);
    if (!found->second.alive) workers_.erase(found);
  }
  return changed;
}

const ListedWorker* WorkerList::find(std::uint32_t worker_id) const {
  const auto found = workers_.find(worker_id);
  return found == workers_.end() ? nullptr : &found->second;
}

bool WorkerList::is_process_of(std::uint32_t worker_id, std::uint64_t participant) const {
  const auto found = participant_of_.find(worker_id);
  return found != participant_of_.end() && found->second == participant;
}

std::vector<WorkerStatus> WorkerList::alive() const {
  std::vector<WorkerStatus> statuses;
  for (const auto& [id, worker] : workers_) {
    if (worker.alive) statuses.push_back(worker.status);
  }
  return statuses;
}

}  // namespace omentum
