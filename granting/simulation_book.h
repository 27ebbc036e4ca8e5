#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "core/simulation_records.h"
#include "granting/grants.h"

namespace omentum {

/// A simulation that was asked for is there.
struct SimulationDone {
  std::uint32_t task = 0;
  Bytes result;
  std::int64_t compute_time_ns = 0;
  /// Workers that hold a grant of it, the one that was first among them: to be told it is over.
  std::vector<std::uint32_t> holders;
};

/// Simulations that a program has others do: puts their results together, judges and counts them;
/// its Grants decide who gets what (docs/wire.md 10). Tasks are bytes, and so are results. No DDS,
/// no clock, no thread; times are nanoseconds of any steady clock.
class SimulationBook {
 public:
  SimulationBook(std::uint32_t asker_id, std::string asker, std::uint64_t build_id);

  /// Wants the result of a task; its number. `steps`: how much work it is, at least 1. Aborts for a
  /// task that is empty or longer than kMaxTaskBytes.
  std::uint32_t ask(Bytes task, std::uint32_t steps);
  /// Workers, as Grants has them; each simulates one task at a time.
  Grants& grants() { return grants_; }
  void worker_left(std::uint32_t worker_id);

  /// What to write now.
  std::vector<SimulationGrant> grant(std::int64_t now_ns);
  void undelivered(const SimulationGrant& grant) { grants_.undelivered(grant.task, grant.grant); }

  /// A piece of a result, from the process of the worker that it names. Pieces come in order; whole
  /// results count, the others are invalid. Or that it declines.
  void receive(SimulationPart part, std::int64_t now_ns);
  /// A piece that did not come from the process of its worker, or that the wire layer refused.
  void foreign(std::uint64_t parts);
  void refused(std::uint64_t parts);
  std::vector<SimulationDone> take_done() { return std::exchange(done_, {}); }
  /// Workers that declined since the last call, and why.
  std::vector<std::pair<std::uint32_t, std::string>> take_declined() {
    return std::exchange(declined_, {});
  }

  std::size_t open() const { return grants_.open_tasks(); }
  Ledger ledger() const { return grants_.ledger(); }
  /// The equations of docs/wire.md 4.3.
  bool balanced() const { return grants_.balanced() && grants_.counts().admitted == admitted_; }
  const std::string& last_refusal() const { return last_refusal_; }

 private:
  struct Task {
    Bytes bytes;
    std::uint64_t hash = 0;
    std::uint32_t steps = 0;
    std::vector<std::uint32_t> holders;
  };
  /// What is there of a result, by task and worker.
  struct Assembly {
    std::uint32_t grant = 0;
    std::uint32_t next = 0;  ///< part
    SimulationPart first;    ///< without payload
    Bytes bytes;
  };
  using Key = std::pair<std::uint32_t, std::uint32_t>;

  void refuse(const SimulationPart& part, const std::string& reason, std::int64_t now_ns);
  void count_unwanted(const SimulationPart& part);
  void admit(const SimulationPart& last, Assembly assembly, std::int64_t now_ns);

  std::uint32_t asker_id_;
  std::string asker_;
  std::uint64_t build_id_;
  Grants grants_;
  std::map<std::uint32_t, Task> tasks_;  ///< open ones
  std::map<Key, Assembly> assemblies_;
  std::map<std::uint32_t, std::pair<std::uint64_t, std::uint32_t>> recent_;  ///< hash, CRC by task
  std::vector<SimulationDone> done_;
  std::vector<std::pair<std::uint32_t, std::string>> declined_;
  std::uint32_t next_task_ = 0;
  std::uint64_t admitted_ = 0;
  std::string last_refusal_;
};

}  // namespace omentum
