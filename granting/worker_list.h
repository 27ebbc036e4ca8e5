#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "core/types.h"
#include "core/wire.h"

namespace omentum {

/// A worker as its last status tells.
struct ListedWorker {
  WorkerStatus status;
  std::uint64_t writer = 0;
  std::uint64_t participant = 0;
  std::int64_t at_ns = 0;  ///< of the last status
  bool alive = false;
  bool crashed = false;  ///< not alive, and without saying so
};

/// The workers of a run, from what arrives on omentum/worker/status (docs/wire.md 4). An id never
/// comes back. A process is one worker, and the list has an end: who announces more of them than
/// there can be is refused and counted. One thread at a time.
class WorkerList {
 public:
  enum class Event { kNothing, kRefused, kCame, kSpoke, kLeft, kCrashed };

  static constexpr std::size_t kMostWorkers = 1024;
  /// One that has been silent for so long makes room for another when the list is full.
  static constexpr std::int64_t kQuietNs = 3'000'000'000;

  /// kRefused: somebody else speaks under the id of a live worker, the process is another worker
  /// already, or the list is full of workers that speak; dropped.
  Event note(Arrival<WorkerStatus>&& arrival, std::int64_t now_ns);

  bool has_changed() const { return !changed_.empty(); }
  /// Ids of workers of which something changed since the last call, with what is known of them.
  std::vector<std::pair<std::uint32_t, ListedWorker>> take_changed();
  /// Null: not known, or gone.
  const ListedWorker* find(std::uint32_t worker_id) const;
  /// Results count only from the process that announced the worker. Known also for a while after
  /// it left.
  bool is_process_of(std::uint32_t worker_id, std::uint64_t participant) const;
  std::vector<WorkerStatus> alive() const;
  std::uint32_t count_alive() const { return count_alive_; }
  /// Statuses that were dropped, and workers that went to make room, since the start.
  std::uint64_t refused() const { return refused_; }
  std::uint64_t pushed_out() const { return pushed_out_; }

 private:
  bool may_come(std::uint64_t participant, std::int64_t now_ns);
  void gone(std::uint32_t worker_id, ListedWorker& worker, bool crashed);

  std::map<std::uint32_t, ListedWorker> workers_;
  std::set<std::uint32_t> changed_;
  std::map<std::uint64_t, std::uint32_t> worker_of_;       ///< live ones, by participant
  std::map<std::uint32_t, std::uint64_t> participant_of_;  ///< also of the last ones that left
  std::deque<std::uint32_t> left_;                         ///< oldest first
  std::uint32_t count_alive_ = 0;
  std::uint64_t refused_ = 0, pushed_out_ = 0;
};

}  // namespace omentum
