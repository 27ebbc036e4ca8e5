#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>

#include "core/simulation_records.h"
#include "core/wire.h"
#include "sim_worker/bus/worker_bus.h"

namespace omentum {

/// Bytes of a task -> bytes of its result, unless `stop` ended it early; see run_task_bytes(). It
/// is called on the worker's thread and asks `stop` on that thread.
using SimulateBytes =
    std::function<Bytes(std::span<const std::byte> task, const std::function<bool()>& stop)>;

/// Simulations that others ask a worker for: what waits, what runs, what is on its way back
/// (docs/wire.md 10). At most 64 tasks wait, 8 of one asker, for 16 askers; what is beyond is
/// declined or dropped, and counted. The worker's thread only. Times are of the steady clock [ns].
class SimulationServer {
 public:
  /// Tasks for another worker or of another build are declined; without `simulate` all of them.
  SimulationServer(std::uint32_t worker_id, std::uint64_t build_id, SimulateBytes simulate)
      : worker_id_(worker_id), build_id_(build_id), simulate_(std::move(simulate)) {}

  /// What became of grants since the worker was asked last.
  struct Counts {
    std::uint64_t received = 0, published = 0;
    std::uint64_t timeouts = 0;   ///< writes that waited in vain for room; they are tried again
    std::uint64_t steps = 0;      ///< of the tasks that were simulated to their end
    std::uint64_t abandoned = 0;  ///< declined ones as well: who asked is told, no learner is
  };
  Counts take_counts() { return std::exchange(counts_, {}); }

  /// A grant, or word that a task is not wanted any more.
  void take(Arrival<SimulationGrant>&& arrival, WorkerBus& bus, std::int64_t now_ns);
  /// Gives back all that is not done, for this reason.
  void decline_all(const std::string& reason, WorkerBus& bus);

  /// Whether there is a task to begin: of an asker that can be answered, and while no result is on
  /// its way to one.
  bool can_begin() const;
  /// Whether flush() has something to send.
  bool has_answers() const { return !outbox_.empty(); }
  /// Tasks that wait, run or are on their way back; what was declined is none.
  std::size_t in_progress() const {
    return waiting_.size() + outbox_.size() - declines_ + (running_ ? 1 : 0);
  }
  /// Simulates the one that waits longest of those that can begin. `stop` is asked now and then; a
  /// task that is not wanted any more ends as well. What was stopped for another reason goes back
  /// to waiting. Precondition: can_begin().
  void run_next(const std::function<bool()>& stop);
  /// Sends what can be sent; gives up what waits for an asker that cannot be found.
  void flush(WorkerBus& bus, std::int64_t now_ns);
  /// The bus is made anew: its writers go first. What waits and what is done stays.
  void forget_writers() { writers_.clear(); }

 private:
  struct Outgoing {
    SimulationPart head;  ///< of the next part, without payload; or why there is none
    Bytes result;
    std::int64_t at_ns = 0;
  };
  struct Running {
    SimulationGrant grant;
    bool wanted = true;
  };

  std::string reason_to_decline(const SimulationGrant& grant) const;
  void decline(const SimulationGrant& grant, const std::string& reason, WorkerBus& bus);
  SimulationPart answer_to(const SimulationGrant& grant) const;
  void withdraw(std::uint32_t asker_id, std::uint32_t task);
  bool is_found(std::uint32_t asker_id) const;
  bool send(Outgoing& out, WorkerBus& bus, std::int64_t now_ns);
  BusWriter<SimulationPart>* writer_to(std::uint32_t asker_id, WorkerBus& bus);

  std::uint32_t worker_id_;
  std::uint64_t build_id_;
  SimulateBytes simulate_;
  std::deque<SimulationGrant> waiting_;
  std::optional<Running> running_;
  std::deque<Outgoing> outbox_;
  std::size_t declines_ = 0;                                                     ///< in outbox_
  std::map<std::uint32_t, std::unique_ptr<BusWriter<SimulationPart>>> writers_;  ///< by asker
  std::set<std::uint32_t> told_;  ///< askers that are in the log
  Counts counts_;
};

}  // namespace omentum
