#include "granting/worker_list.h"

#include <algorithm>

namespace omentum {

WorkerList::Event WorkerList::note(Arrival<WorkerStatus>&& arrival, std::int64_t now_ns) {
  const std::uint32_t id = arrival.record.worker_id;
  ListedWorker& worker = workers_[id];
  const bool alive = arrival.info.valid && arrival.info.state == dds::InstanceState::kAlive;
  if (alive && worker.alive && worker.writer != arrival.info.writer) return Event::kRefused;
  Event event = Event::kNothing;
  if (alive) {
    event = worker.alive ? Event::kSpoke : Event::kCame;
    // One that rejoined, with a certificate renewed, is another participant.
    if (!worker.alive) participant_of_[id] = arrival.info.participant;
    if (!worker.alive) ++count_alive_;
    worker.status = std::move(arrival.record);
    worker.writer = arrival.info.writer;
    worker.at_ns = now_ns;
  } else if (worker.alive) {
    --count_alive_;
    worker.crashed = arrival.info.state != dds::InstanceState::kDisposed;
    event = worker.crashed ? Event::kCrashed : Event::kLeft;
  }
  worker.alive = alive;
  if (std::find(changed_.begin(), changed_.end(), id) == changed_.end()) changed_.push_back(id);
  return event;
}

std::vector<std::pair<std::uint32_t, ListedWorker>> WorkerList::take_changed() {
  std::vector<std::pair<std::uint32_t, ListedWorker>> changed;
  std::sort(changed_.begin(), changed_.end());
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
