#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "core/dds_discovery.h"
#include "core/dds_options.h"
#include "core/simulation_records.h"
#include "core/wire.h"

namespace omentum {

/// What has arrived for a worker since it was asked last, in order of arrival per topic.
struct WorkerInbox {
  std::vector<Arrival<RunManifest>> manifests;
  std::vector<Arrival<LearnerStatus>> learners;
  std::vector<Arrival<PolicyWeights>> weights;  ///< of this run, compared with their hash
  std::vector<Arrival<RolloutTask>> tasks;
  std::vector<Arrival<ControlCommand>> commands;
  /// Without data: the task of this key is not wanted any more.
  std::vector<Arrival<SimulationGrant>> simulations;
  std::uint64_t wrong_weights = 0;  ///< did not match their hash
  std::uint64_t dropped = 0;        ///< the oldest of a topic, beyond what is kept of it
};

struct WorkerBusOptions {
  std::string run;           ///< name of the run, not empty
  std::uint32_t domain = 0;  ///< 0 ... 230
  DdsProfile profile;
  std::uint32_t worker_id = 0;  ///< of make_worker_id(); tasks for another one do not come here
  /// Called by the receiving thread when weights are there and have the hash they name; it must not
  /// throw. May be empty.
  std::function<void(const PolicyWeights&)> on_weights;
};

/// DDS entities of a worker, and the thread that receives while its lanes compute. Writers and all
/// public functions are for the worker's thread.
class WorkerBus {
 public:
  /// Joins the domain and begins to receive. Throws Error: one line, for a domain outside 0 to 230,
  /// a profile that DDS refuses, entities that a certificate does not allow.
  explicit WorkerBus(const WorkerBusOptions& options);
  ~WorkerBus();
  WorkerBus(const WorkerBus&) = delete;
  WorkerBus& operator=(const WorkerBus&) = delete;

  /// Sleeps until something has arrived, at most so long [ns].
  void wait(std::int64_t timeout_ns);
  bool has_arrivals() const { return arrived_.load(std::memory_order_acquire); }
  /// What has arrived since the last call. Does not wait.
  WorkerInbox take();

  /// The configuration of DDS with which the domain was joined.
  const std::string& uri() const { return uri_; }
  /// The certificate has ended: nobody hears this process any more.
  bool expired() const { return participant_.expired(); }
  /// A learner's process is in the domain, of whatever run.
  bool sees_a_learner() const { return participant_.sees("omentum-learner"); }

  /// Participants, writers and readers that discovery has found.
  dds::Discovery::Count discovered() { return discovery_.count(); }
  /// The learner's writer of tasks for this worker is found: what it writes from now on arrives.
  bool hears_tasks() const { return task_reader_.raw().matched() > 0; }

  // Writers of this process, in all public partitions of the run. They live as long as this.
  BusWriter<RolloutSegment>& segments() { return segment_writer_; }
  BusWriter<WorkerStatus>& status() { return status_writer_; }
  BusWriter<ControlReply>& replies() { return reply_writer_; }
  BusWriter<SimFrame>& frames() { return frame_writer_; }
  /// For results of simulations to who asked; it must go before this does. Throws Error, for a role
  /// that may not write there.
  std::unique_ptr<BusWriter<SimulationPart>> make_result_writer(std::uint32_t asker_id) const;

 private:
  void receive(const std::stop_token& stop);
  void keep_simulation(Arrival<SimulationGrant>&& arrival);

  std::string run_;
  std::string uri_;
  std::uint32_t policy_id_;
  std::function<void(const PolicyWeights&)> on_weights_;

  dds::Participant participant_;
  dds::Discovery discovery_;
  // Receiving thread only.
  BusReader<LearnerStatus> learner_reader_;
  BusReader<RunManifest> manifest_reader_;
  BusReader<PolicyWeights> weights_reader_;
  BusReader<RolloutTask> task_reader_;
  BusReader<ControlCommand> command_reader_;
  std::optional<BusReader<SimulationGrant>> simulation_reader_;  ///< none where it may not
  // The worker's thread only.
  BusWriter<RolloutSegment> segment_writer_;
  BusWriter<WorkerStatus> status_writer_;
  BusWriter<ControlReply> reply_writer_;
  BusWriter<SimFrame> frame_writer_;
  dds::Waitset waitset_;

  std::atomic<bool> arrived_{false};
  std::mutex mutex_;
  std::condition_variable something_;
  WorkerInbox inbox_;     // guarded by mutex_
  std::jthread receive_;  // last: stops before anything it uses goes
};

}  // namespace omentum
