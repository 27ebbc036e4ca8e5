#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/backend.h"
#include "core/dds_profile.h"
#include "core/policy.h"
#include "core/wire.h"
#include "sim_worker/bus/task_queue.h"

// bus/ is the end of a simulation worker on the DDS bus: it takes tasks and weights, groups tasks
// into lanes, sends segments back and says how it is. What the rollout does is not known here.

namespace omentum {

/// What a worker makes from a manifest.
struct WorkerSetup {
  std::unique_ptr<Backend> backend;
  PolicyShape shape;
  std::uint64_t config_hash =
      0;  ///< of the configuration the backend was made from, computed by this build
};

struct BusWorkerOptions {
  std::string run;
  std::uint32_t domain = 0;
  DdsProfile profile;          ///< of choose_dds_profile(worker_receive_bytes(...))
  std::uint64_t build_id = 0;  ///< tasks of a run made by another build are declined
  std::string program_version;
  /// Makes the environments of a run. May throw Error: the worker then declines and shows the
  /// reason in its status.
  std::function<WorkerSetup(const RunManifest&)> make_setup;
  /// run_rollout() of core/rollout.h; tests put something of their own here.
  std::function<std::vector<RolloutSegment>(Backend&, Policy&, std::span<const RolloutTask>,
                                            const std::function<bool()>& stop)>
      rollout;
};

/// Id of this process: hash of host, process id and start time; never 0.
std::uint32_t make_worker_id();

/// The worker's end of the bus (docs/wire.md 1, 4.2, 5.2): a stateless executor of tasks. It
/// waits patiently for a learner, follows the highest learner epoch of its run, groups tasks of one
/// policy version, kind and length, runs them, publishes the segments, and declines with a visible
/// reason what it must not run. One thread does everything.
class BusWorker {
 public:
  /// Joins the domain. Throws Error.
  explicit BusWorker(BusWorkerOptions options);

  /// Serves until stop() is true or the learner says that the run is over; leaves gracefully.
  /// `stop` is polled at least every 50 ms and once per step of a rollout. Returns the exit code of
  /// the program, 0.
  int run(const std::function<bool()>& stop);

  std::uint32_t worker_id() const { return status_.worker_id; }
  const WorkerStatus& status() const { return status_; }

 private:
  struct Outgoing {
    RolloutSegment segment;
    std::int64_t at_ns = 0;
  };

  void take_control();
  void take_weights();
  void take_tasks();
  void follow(std::uint32_t epoch);
  void prepare();
  void accept(RolloutTask task);
  enum class Check { kReady, kWait, kNoWeights, kConfig, kState };
  Check check(const RolloutTask& task) const;
  void decline_unfit(std::int64_t now_ns);
  void decline(const RolloutTask& task, Check reason);
  const PolicyWeights* weights_of(const RolloutTask& task) const;

  void run_group(std::vector<TaskQueue::Entry> group, const std::function<bool()>& stop);
  Policy& policy_of(const RolloutTask& task);

  void flush(std::int64_t now_ns);
  bool deliverable(std::int64_t now_ns) const;
  void say(WorkerPhase phase);
  void publish_status(std::int64_t now_ns);
  void warn(const std::string& text);
  void leave();

  BusWorkerOptions options_;
  std::uint32_t policy_id_;
  WorkerStatus status_;

  dds::Participant participant_;
  BusReader<LearnerStatus> learner_reader_;
  BusReader<RunManifest> manifest_reader_;
  BusReader<PolicyWeights> weights_reader_;
  BusReader<RolloutTask> task_reader_;
  BusWriter<RolloutSegment> segment_writer_;
  BusWriter<WorkerStatus> status_writer_;
  dds::Waitset waitset_;

  std::uint32_t epoch_ = 0;         ///< highest seen; 0 = no learner yet
  std::int64_t learner_at_ns_ = 0;  ///< last sign of life of the learner of epoch_
  bool learner_gone_ = false;
  bool done_ = false;
  std::optional<RunManifest> manifest_;  ///< of epoch_
  std::uint32_t setup_epoch_ = 0;        ///< epoch whose manifest setup_ was checked against
  std::string setup_error_;
  WorkerSetup setup_;
  std::deque<PolicyWeights> weights_;  ///< the last two, newest last
  std::unique_ptr<Policy> policy_;
  TaskQueue pending_;
  std::deque<Outgoing> outbox_;
  std::uint32_t running_ = 0;

  std::int64_t status_sent_ns_ = 0;
  std::int64_t busy_ns_ = 0;
  std::uint64_t steps_sent_ = 0;
};

}  // namespace omentum
