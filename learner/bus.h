#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/alarms.h"
#include "core/dds_options.h"
#include "core/heartbeat.h"
#include "core/wire.h"
#include "granting/worker_list.h"
#include "learner/hub_mirror.h"
#include "learner/task_book.h"

namespace omentum {

struct LearnerBusOptions {
  std::string run;  ///< name; partition of the run
  std::uint32_t domain = 0;
  DdsProfile profile;  ///< of find_dds_profile()
  std::uint32_t learner_epoch = 1;
  std::string heartbeat;    ///< file that serve() touches; empty: none
  std::uint32_t slots = 1;  ///< E; ring and reader hold 4 E segments, at least 64
};

/// Counters of the learner's side of the bus since its start.
struct BusStatistics {
  std::uint64_t bytes_up = 0;    ///< segments
  std::uint64_t bytes_down = 0;  ///< tasks, and weights once per worker
  std::uint64_t refused = 0;     ///< samples the wire layer refused
  std::uint64_t foreign = 0;     ///< segments not from the process of the worker they name
  std::uint64_t of_robots = 0;   ///< of them, those that a gateway recorded on a robot
  std::uint64_t lost = 0;        ///< by the middleware
  std::uint64_t full = 0;  ///< times the segment reader was full: this process received nothing
  std::uint64_t worker_crashes = 0;
  std::uint64_t worker_leaves = 0;
  std::uint64_t id_conflicts = 0;  ///< statuses that WorkerList refused
  std::uint32_t workers_alive = 0;
};

/// The learner's end of the bus (docs/wire.md 1, 4, 5.2): one participant; writers of manifest,
/// weights, summaries and status; one directed task writer per worker; a drain thread that takes
/// segments and sends the status also while the learner thread is busy.
///
/// Everything public is for the learner thread, which calls serve() while waiting and between
/// minibatches.
class LearnerBus {
 public:
  /// Joins the domain. Throws Error, also for the name of a run that cannot be a partition; aborts
  /// without a slot.
  explicit LearnerBus(const LearnerBusOptions& options);
  /// Leaves as a crash would; call finish() first at the end of a run.
  ~LearnerBus();
  LearnerBus(const LearnerBus&) = delete;
  LearnerBus& operator=(const LearnerBus&) = delete;

  /// Before the first weights. The epoch is the bus's own. Once superseded(), these three succeed
  /// and publish nothing.
  [[nodiscard]] Result<void> publish_manifest(RunManifest manifest);
  /// Never blocks: KEEP_LAST. policy_id, epoch and time are filled in. Announce the same version to
  /// the book.
  [[nodiscard]] Result<void> publish_weights(PolicyWeights weights);
  [[nodiscard]] Result<void> publish_summary(const EpisodeSummary& summary);
  /// Sets the status to be published; ledger, workers, rates and identity are filled in by the bus.
  /// A change of phase is published at once, anything else twice a second.
  void set_status(const LearnerStatus& status);

  /// Empties the ring into the book, tells it of workers that came, left, declined or fell silent,
  /// and writes the grants. A few microseconds when nothing happened.
  void serve(TaskBook& book, std::int64_t now_ns);
  /// Sleeps until there is something to serve; true when there is.
  bool wait(std::int64_t timeout_ns);

  /// What operators have asked since the last call. A request that was answered is answered again
  /// in the same words and left out.
  std::vector<ControlCommand> take_commands();
  void reply(const ControlCommand& command, bool done, const std::string& text);
  /// Nothing is granted while paused; what is out comes in.
  void pause_grants(bool paused) { paused_ = paused; }
  /// Workers publish frames of the slot from its next task on, so often [Hz]; 0 ends it.
  void watch_slot(std::uint32_t slot, float hz);
  /// Highest epoch of another learner that workers report to have followed; 0 = none.
  std::uint32_t epoch_of_workers() const { return epoch_of_workers_; }

  /// The certificate has ended (dds::Participant::expired): nobody hears this process any more.
  bool expired() const { return participant_.expired(); }

  /// A learner with a higher epoch serves this run, and goes on to: stop and exit with an error.
  /// Nothing more is published. Not at once: of two that do not know of each other the younger one
  /// ends.
  bool superseded() const { return superseding_epoch() != 0; }
  std::uint32_t superseding_epoch() const { return superseding_epoch_.load(); }

  /// Epoch of a learner of this run that is older than this one and speaks; 0 = none heard.
  std::uint32_t older_epoch() const { return older_epoch_.load(); }
  /// The same, before anything is published: waits so long for one to be heard.
  std::uint32_t listen_for_older(std::int64_t timeout_ns);

  /// Tells the workers that the run is over (phase kDone) and waits until they left; true if all
  /// did in time.
  bool finish(std::int64_t timeout_ns);

  BusStatistics statistics() const;
  /// Last status of every live worker, by id.
  std::vector<WorkerStatus> worker_statuses() const;
  /// Host, process and build of a worker, also of one that has left: for messages.
  std::string describe_worker(std::uint32_t id) const;
  /// Workers that have joined, can be granted to, and are not silent.
  std::uint32_t workers_ready() const;

 private:
  // What the learner thread holds of a worker.
  struct Served {
    std::unique_ptr<BusWriter<RolloutTask>> writer;
    WorkerStatus last;
    /// Writer of its status: a different writer means that the worker has joined anew.
    std::uint64_t speaks_as = 0;
    std::int64_t since_ns = 0;
    bool joined = false;
    bool silent = false;
    // When it gave the last sign of getting tasks and of being heard, and its counts then.
    std::int64_t fine_ns = 0;
    std::uint64_t fine_received = 0, fine_published = 0;
  };

  void drain(const std::stop_token& stop);
  void drain_segments();
  void drain_worker_status();
  void drain_learner_status();
  void drain_commands();
  void drain_mirrored();
  void send_status(std::int64_t now_ns);

  void follow_worker(TaskBook& book, std::uint32_t id, const ListedWorker& seen,
                     std::int64_t now_ns);
  void follow_declines(TaskBook& book, std::uint32_t id, const WorkerStatus& before,
                       const WorkerStatus& after, std::int64_t now_ns);
  void serve_worker(std::uint32_t id, const ListedWorker& seen, std::int64_t now_ns);
  void serve_late_ones(std::int64_t now_ns);
  void retire(std::map<std::uint32_t, Served>::iterator worker);
  void follow_silence(TaskBook& book);
  void find_unheard(const TaskBook& book, std::int64_t now_ns);
  void write_grants(TaskBook& book, std::int64_t now_ns);
  void repeat_for_workers(std::int64_t now_ns);
  void report_book(const TaskBook& book, std::int64_t now_ns);
  void raise_alarms();
  void send(const ControlReply& reply);

  LearnerBusOptions options_;
  std::uint32_t policy_id_;
  std::size_t ring_capacity_;

  dds::Participant participant_;
  BusWriter<RunManifest> manifest_writer_;
  BusWriter<PolicyWeights> weights_writer_;
  BusWriter<EpisodeSummary> summary_writer_;
  BusWriter<LearnerStatus> status_writer_;                   // drain thread only
  std::optional<BusReader<RolloutSegment>> segment_reader_;  // drain thread only
  BusReader<WorkerStatus> worker_reader_;                    // drain thread only
  BusReader<LearnerStatus> learner_reader_;                  // drain thread only
  BusReader<ControlCommand> command_reader_;                 // drain thread only
  BusWriter<ControlReply> reply_writer_;
  // In a hub; drain thread only.
  std::optional<HubMirror> mirror_;
  std::optional<BusReader<SimFrame>> frame_reader_;
  std::optional<BusReader<ControlReply>> reply_reader_;
  std::optional<BusReader<RobotStatus>> robot_reader_;
  dds::Waitset waitset_;

  // Learner thread only.
  std::map<std::uint32_t, Served> served_;
  std::map<std::uint32_t, WorkerStatus> known_;  ///< first status of every worker of this session
  std::vector<std::uint32_t> barred_told_;
  std::vector<std::pair<std::unique_ptr<BusWriter<RolloutTask>>, std::int64_t>> retired_;
  std::int64_t writers_from_ns_ = 0;  ///< when the present second of new writers began
  std::uint32_t writers_made_ = 0;    ///< in it
  std::uint64_t refused_told_ = 0, foreign_told_ = 0, strangers_told_ = 0, robots_told_ = 0;
  std::int64_t foreign_warned_ns_ = 0;
  std::int64_t reported_ns_ = 0, repeated_ns_ = 0;
  RunManifest manifest_;                    ///< as published
  std::deque<PolicyWeights> sent_weights_;  ///< the last two
  bool weights_wanted_ = false;             ///< a worker declined for lack of them
  bool paused_ = false;
  std::map<std::uint32_t, float> watched_;  ///< frames [Hz] by slot
  std::deque<ControlReply> replies_;        ///< the last ones
  std::uint32_t epoch_of_workers_ = 0;
  Alarms alarms_;
  ProfileAlarms profile_alarms_;
  Heartbeat heartbeat_;

  mutable std::mutex mutex_;
  std::condition_variable something_;
  std::deque<RolloutSegment> ring_;  // guarded by mutex_
  // (slot, task_hash), guarded by mutex_
  std::vector<std::pair<std::uint32_t, std::uint64_t>> overflown_;
  WorkerList workers_;                                  // guarded by mutex_
  std::map<std::uint32_t, std::uint64_t> segments_of_;  // of live workers; guarded by mutex_
  std::vector<ControlCommand> commands_;                // guarded by mutex_
  std::size_t ring_peak_ = 0;                           // since the last report; guarded by mutex_
  LearnerStatus status_;                                // guarded by mutex_
  bool status_urgent_ = true;                           // guarded by mutex_
  BusStatistics statistics_;                            // guarded by mutex_

  // Drain thread only.
  std::int64_t status_sent_ns_ = 0, rate_from_ns_ = 0;
  std::uint64_t rate_bytes_up_ = 0, rate_bytes_down_ = 0;

  std::uint32_t younger_epoch_ = 0;  ///< heard, and since when
  std::int64_t younger_since_ns_ = 0;

  std::atomic<bool> speaks_{false};                  ///< the manifest is out
  std::atomic<std::uint32_t> older_epoch_{0};        ///< below ours, of who speaks
  std::atomic<std::uint32_t> superseding_epoch_{0};  ///< highest above ours
  std::jthread drain_thread_;                        // last: stops before anything it uses goes
};

}  // namespace omentum
