#pragma once

#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "core/types.h"
#include "core/wire.h"

namespace omentum {

/// A worker as its last status tells.
struct ListedWorker {
  WorkerStatus status;
  std::uint64_t writer = 0;
  std::int64_t at_ns = 0;  ///< of the last status
  bool alive = false;
  bool crashed = false;  ///< not alive, and without saying so
};

/// The workers of a run, from what arrives on omentum/worker/status (docs/wire.md 4). An id never
/// comes back. One thread at a time.
class WorkerList {
 public:
  enum class Event { kNothing, kRefused, kCame, kSpoke, kLeft, kCrashed };

  /// kRefused: somebody else speaks under the id of a live worker; dropped.
  Event note(Arrival<WorkerStatus>&& arrival, std::int64_t now_ns);

  bool has_changed() const { return !changed_.empty(); }
  /// Ids of workers of which something changed since the last call, with what is known of them.
  std::vector<std::pair<std::uint32_t, ListedWorker>> take_changed();
  /// Null: not known, or gone.
  const ListedWorker* find(std::uint32_t worker_id) const;
  /// Results count only from the process that announced the worker. Known also after it left.
  bool is_process_of(std::uint32_t worker_id, std::uint64_t participant) const;
  std::vector<WorkerStatus> alive() const;
  std::uint32_t count_alive() const { return count_alive_; }

 private:
  std::map<std::uint32_t, ListedWorker> workers_;
  std::vector<std::uint32_t> changed_;
  std::map<std::uint32_t, std::uint64_t> participant_of_;  ///< of every worker ever seen
  std::uint32_t count_alive_ = 0;
};

}  // namespace omentum
