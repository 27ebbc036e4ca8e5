#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/alarms.h"
#include "core/backend.h"
#include "core/dds_options.h"
#include "core/deafness.h"
#include "core/heartbeat.h"
#include "core/policy.h"
#include "core/wire.h"
#include "sim_worker/bus/learner_choice.h"
#include "sim_worker/bus/simulation_server.h"
#include "sim_worker/bus/task_queue.h"
#include "sim_worker/bus/worker_bus.h"

// bus/ is the end of a simulation worker on the DDS bus: it takes tasks and weights, groups tasks
// into lanes, runs them through a function it is given, and publishes segments and status.

namespace omentum {

/// What a worker makes from a manifest.
struct WorkerSetup {
  std::unique_ptr<Backend> backend;  ///< never null in what make_setup returns
  PolicyShape shape;                 ///< of the observations and actions of `backend`
  std::uint64_t config_hash = 0;     ///< of the backend's configuration, computed by this build
  double decision_s = 0;             ///< simulated time of one decision [s], above 0
};

struct BusWorkerOptions {
  std::string run;           ///< name of the run, not empty
  std::uint32_t domain = 0;  ///< 0 ... 230
  DdsProfile profile;        ///< of find_dds_profile()
  /// The profile as of now, asked for while no learner is heard: one that comes back at another
  /// address, or a name that did not exist. Empty: the profile never changes.
  std::function<Result<DdsProfile>()> find_profile;
  std::string heartbeat;       ///< file that the loop touches; empty: none
  std::uint64_t build_id = 0;  ///< tasks of a run made by another build are declined
  std::string program_version;
  std::int64_t max_wait_ns = 0;  ///< without a learner [ns]; then run() ends with 1. 0 = for ever
  /// Makes the environments of a run. May throw Error: the worker then declines and shows the
  /// reason in its status.
  std::function<WorkerSetup(const RunManifest&)> make_setup;
  /// run_rollout() of core/rollout.h; tests put something of their own here. As find_profile and
  /// make_setup it is called on the thread of run().
  std::function<std::vector<RolloutSegment>(Backend&, Policy&, std::span<const RolloutTask>,
                                            const std::function<bool()>& stop)>
      rollout;
  SimulateBytes simulate;  ///< empty: simulations are declined
};

/// A status is published at least so often [ns].
inline constexpr std::int64_t kStatusPeriodNs = 500'000'000;

/// Id of this process: hash of host, process id and start time; never 0.
std::uint32_t make_worker_id();
/// Identity and machine of this process.
WorkerStatus first_worker_status(const BusWorkerOptions& options);

/// The worker's end of the bus (docs/wire.md 1, 4.2, 5.2). It waits for a learner, follows the
/// highest learner epoch of its run, groups tasks of one policy version, kind and length, runs
/// them, publishes the segments, and declines what it must not run with a reason in its status.
/// While no learner speaks it simulates recordings for others (SimulationServer), and stops when
/// one does. All of its functions are for one thread; another one receives (WorkerBus).
/// bus_worker.cpp runs tasks,
/// bus_worker_learner.cpp follows the learner, bus_worker_status.cpp says what the worker does.
class BusWorker {
 public:
  /// Joins the domain. Throws Error as WorkerBus does.
  explicit BusWorker(BusWorkerOptions options);

  /// Serves until stop() is true, the operator drains it or the learner's phase is kDone; then
  /// hands back what it holds and disposes its status.
  /// `stop` is polled at least every 50 ms and once per step of a rollout. Returns the exit code of
  /// the program, 0.
  int run(const std::function<bool()>& stop);

  /// Of make_worker_id(); the same over rejoins.
  std::uint32_t worker_id() const { return status_.worker_id; }
  /// As it is published next.
  const WorkerStatus& status() const { return status_; }

 private:
  struct Outgoing {
    RolloutSegment segment;
    std::int64_t at_ns = 0;
  };

  void join(const DdsProfile& profile);
  void take_arrivals();
  void take_weights(std::vector<Arrival<PolicyWeights>> weights);
  void take_learners(const std::vector<Arrival<LearnerStatus>>& learners);
  void take_commands(const std::vector<Arrival<ControlCommand>>& commands);
  void rejoin_if_needed(std::int64_t now_ns);
  std::string deafness(std::int64_t now_ns);
  void rejoin(const DdsProfile& profile, const std::string& reason, std::int64_t now_ns);
  void follow(const LearnerChoice::Learner& learner);
  void tell_while_alone(std::int64_t now_ns);
  void tell_if_barred(const LearnerStatus& learner);
  void count_stranger(const char* what);
  void prepare();
  void accept(std::uint64_t participant, RolloutTask task);
  enum class Check { kReady, kWait, kNoWeights, kConfig, kState };
  Check check(const RolloutTask& task) const;
  void decline_unfit(std::int64_t now_ns);
  void decline(const RolloutTask& task, Check reason);
  const PolicyWeights* weights_of(const RolloutTask& task) const;

  void run_group(std::vector<TaskQueue::Entry> group, const std::function<bool()>& stop);
  void publish_frames(std::span<const RolloutTask> tasks, std::int64_t now_ns);
  Policy& policy_of(const RolloutTask& task);

  bool learner_speaks(std::int64_t now_ns) const;
  void serve_simulations(const std::function<bool()>& stop);
  void count_simulations();

  void flush(std::int64_t now_ns);
  bool deliverable(std::int64_t now_ns) const;
  void say(WorkerPhase phase);
  void publish_status(std::int64_t now_ns);
  void raise_alarms(std::uint64_t throttled_ns);
  void count_wrong(std::uint64_t wrong_weights, std::uint64_t dropped);
  void warn(const std::string& text);
  void leave();

  BusWorkerOptions options_;
  WorkerStatus status_;
  Alarms alarms_;
  ProfileAlarms profile_alarms_;
  Heartbeat heartbeat_;

  std::unique_ptr<WorkerBus> bus_;

  LearnerChoice choice_;
  std::uint64_t learner_ = 0;            ///< participant that is followed; 0 = none yet
  std::uint32_t epoch_ = 0;              ///< of learner_
  std::int64_t epoch_told_from_ns_ = 0;  ///< when the status begins to name it
  std::int64_t learner_at_ns_ = 0;       ///< last status of the learner of epoch_
  bool learner_gone_ = false;
  bool done_ = false;
  bool drained_ = false;                 ///< the operator wants this worker to leave
  std::optional<RunManifest> manifest_;  ///< of learner_
  bool prepared_ = false;                ///< setup_ was checked against manifest_
  std::string setup_error_;
  std::int64_t retry_ns_ = 0, retry_span_ns_ = 0;  ///< of a setup that failed
  std::string barred_for_;                         ///< what the learner says; empty = not so
  WorkerSetup setup_;
  /// By participant: the last two, newest last.
  std::map<std::uint64_t, std::deque<PolicyWeights>> weights_;
  /// Tasks from participants that have not offered their manifest yet.
  std::vector<std::pair<std::uint64_t, RolloutTask>> early_;
  std::uint64_t wrong_weights_ = 0, dropped_ = 0, timeouts_ = 0;
  std::uint64_t strangers_ = 0;  ///< samples of others than the learner
  std::int64_t stranger_told_ns_ = 0;
  std::int64_t alone_since_ns_ = 0, alone_told_ns_ = 0;  ///< without a learner; 0 = not so
  bool waited_too_long_ = false;
  std::int64_t profile_asked_ns_ = 0;
  Deafness deaf_;                       ///< to a learner of this run
  std::int64_t listed_ns_ = 0;          ///< the learner has named this worker, or was not heard
  std::int64_t matched_ns_ = 0;         ///< its endpoints were found, or are not looked for
  std::int64_t weights_missed_ns_ = 0;  ///< a task was declined for lack of them; 0 = none since
  bool unheard_ = false;                ///< the learner says so
  std::unique_ptr<Policy> policy_;
  TaskQueue pending_;
  std::deque<Outgoing> outbox_;
  SimulationServer simulations_;
  std::int64_t asked_ns_ = 0;  ///< for a simulation, last; 0 = never
  std::uint32_t running_ = 0;
  std::map<std::uint32_t, std::int64_t> frame_sent_ns_;  ///< by slot

  std::int64_t status_sent_ns_ = 0;
  std::int64_t busy_ns_ = 0;
  std::uint64_t steps_sent_ = 0;
};

}  // namespace omentum
