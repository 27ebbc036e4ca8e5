#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/dds_discovery.h"
#include "core/dds_options.h"
#include "core/deafness.h"
#include "core/wire.h"
#include "granting/simulation_book.h"
#include "granting/worker_list.h"

namespace omentum {

struct SimulationAskerOptions {
  std::string run;  ///< whose workers are asked
  std::uint32_t domain = 0;
  DdsProfile profile;          ///< of find_dds_profile()
  std::string program;         ///< for the workers' logs
  std::uint64_t build_id = 0;  ///< workers of another one decline
  /// What a person should know, one line; called by a thread of the asker.
  std::function<void(const std::string&)> tell;
};

/// How it goes.
struct AskerState {
  std::uint32_t workers = 0;  ///< that can be asked
  std::uint64_t done = 0;     ///< results
  std::uint64_t steps = 0;    ///< control steps of them
  double compute_s = 0;       ///< processor time of workers
  Ledger ledger;
};

/// Has the workers of a run do simulations (docs/wire.md 10): one participant; one task writer per
/// worker, a reader of results, and a thread that takes, grants and gives out what has come. Where
/// workers are there and nothing is heard of what they were asked, the participant is made anew
/// (docs/trust.md 2), and all that is open is asked again.
class SimulationAsker {
 public:
  /// Joins the domain. Throws Error; aborts where `options` have nobody to tell.
  explicit SimulationAsker(SimulationAskerOptions options);
  /// What is still asked for fails.
  ~SimulationAsker();
  SimulationAsker(const SimulationAsker&) = delete;
  SimulationAsker& operator=(const SimulationAsker&) = delete;

  /// The result of a task, sooner or later: waits for workers where there are none. Any number of
  /// threads at a time. Fails where none can come any more.
  Result<Bytes> ask(Bytes task, std::uint32_t steps);

  AskerState state() const;

 private:
  struct Question {
    Bytes task;
    std::uint32_t steps = 0;
    Result<Bytes> answer = Failure{"the program ends"};
    bool answered = false;
  };
  struct Served {
    std::unique_ptr<BusWriter<SimulationGrant>> writer;
    WorkerStatus last;
    /// Writer of its status: a different writer means that the worker has joined anew.
    std::uint64_t speaks_as = 0;
    bool joined = false;
    bool silent = false;
  };

  /// A place in the domain. All that is made from its participant goes before it does.
  struct Link {
    Link(const SimulationAskerOptions& options, std::uint32_t id);
    dds::Participant participant;
    dds::Discovery discovery;
    BusReader<WorkerStatus> worker_reader;
    BusReader<SimulationPart> part_reader;
    dds::Waitset waitset;
  };

  void wake();
  void run(const std::stop_token& stop);
  void wait(std::int64_t timeout_ns);
  bool is_deaf(std::int64_t now_ns);
  bool somebody_is_busy_or_free(std::int64_t now_ns);
  void join_anew(const std::stop_token& stop);
  void take_statuses(std::int64_t now_ns);
  void take_parts(std::int64_t now_ns);
  void take_questions();
  void follow(std::uint32_t id, const ListedWorker& worker, std::int64_t now_ns);
  void follow_matches(std::int64_t now_ns);
  void write_grants(std::int64_t now_ns);
  void give_answers();
  void tell_waiting(std::int64_t now_ns);
  void publish_state();
  void retire(Served served, std::int64_t now_ns);

  SimulationAskerOptions options_;
  std::uint32_t id_;

  /// Null while it is made anew. The thread alone replaces it, and uses it without the lock.
  std::unique_ptr<Link> link_;  // guarded by mutex_

  // The thread's own.
  SimulationBook book_;
  WorkerList workers_;
  std::map<std::uint32_t, Served> served_;
  std::vector<std::pair<std::unique_ptr<BusWriter<SimulationGrant>>, std::int64_t>> retired_;
  std::map<std::uint32_t, std::shared_ptr<Question>> asked_;  ///< by task
  std::uint64_t refused_told_ = 0;
  std::int64_t alone_since_ns_ = 0, alone_told_ns_ = 0;  ///< without workers; 0 = not so
  Deafness deaf_;
  std::int64_t fine_ns_ = 0;    ///< a result came, none was waited for, or somebody works on one
  std::int64_t looked_ns_ = 0;  ///< for workers that are there

  mutable std::mutex mutex_;
  std::condition_variable answered_;
  std::deque<std::shared_ptr<Question>> questions_;  // guarded by mutex_
  AskerState state_;                                 // guarded by mutex_
  bool over_ = false;                                // guarded by mutex_
  std::size_t asking_ = 0;                           // threads in ask(); guarded by mutex_
  std::jthread thread_;                              // last: stops before anything it uses goes
};

}  // namespace omentum
