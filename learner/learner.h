#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/dds_options.h"
#include "core/heartbeat.h"
#include "core/policy.h"
#include "learner/batch.h"
#include "learner/bus.h"
#include "learner/checkpoint.h"
#include "learner/demonstrations.h"
#include "learner/evaluation.h"
#include "learner/metrics.h"
#include "learner/ppo.h"
#include "learner/recent_episodes.h"
#include "learner/run_lock.h"
#include "learner/summary.h"
#include "learner/task_book.h"
#include "proto/config.pb.h"

namespace omentum {

struct LearnerOptions {
  DdsOptions dds;
  std::string heartbeat;        ///< file that the loop touches; empty: none
  std::string run_dir;          ///< runs/<name>; made if missing
  bool restart = false;         ///< move an existing run aside
  std::string initialise_from;  ///< checkpoint file whose weights a new run starts from
  /// Folder of recordings that a new run clones before PPO begins; with initialise_from: an Error.
  std::string initialise_from_recordings;
  bool quiet = false;  ///< no progress lines on stdout
  double unsaved_limit_s =
      300;  ///< training goes on so long while no checkpoint can be written; then it pauses
  double max_wait_s = 0;  ///< without a worker; then the run stops with code 1. 0 = for ever
};

/// One training run: owns the task book, PPO, the bus and the run folder. A run folder with a
/// checkpoint is continued bit for bit. One thread, plus the bus's drain thread and PPO's helpers.
/// learner.cpp has the run, learner_waiting.cpp what it says without workers, learner_saving.cpp
/// what it leaves on disk, learner_control.cpp what operators ask, learner_report.cpp metrics and
/// status of each update, learner_evaluation.cpp the evaluation and the summary.
class Learner {
 public:
  /// Reads or makes the run folder. Throws Error: one line.
  Learner(pb::Config config, LearnerOptions options);

  /// Trains to max_steps, evaluates, writes summary. Returns the exit code: 0 done, 130 stopped on
  /// request with a resumable checkpoint, 1 when that could not be saved, on a failed integrity
  /// check, a newer learner or physics that keeps diverging. Throws Error with the workers' reason
  /// when they cannot run the configuration: the scene is resolved there.
  int run(const std::function<bool()>& stop);

 private:
  /// One evaluation set as it was granted and what came back, in its order.
  struct Evaluated {
    std::vector<RolloutTask> tasks;
    std::vector<RolloutSegment> segments;
  };

  static constexpr double kRetrySaveS = 2;  ///< what the disk refused is tried again after it [s]

  void open_run_folder();
  void restore();
  /// Throws Error where the folder has no checkpoint and yet records of a run.
  void refuse_to_overwrite() const;
  /// Fits the policy of a new run to options_.initialise_from_recordings.
  void clone_demonstrations();
  void publish_weights(const PolicyWeights& weights);
  bool collect_batch(const std::function<bool()>& stop);
  std::optional<std::string> refused_by_workers();
  bool check_batch(Batch& batch);
  void count_episodes(std::span<const RolloutSegment> segments);
  void report_update(const UpdateStats& stats);
  /// False when the disk refused it; unsaved_ then says why.
  bool save_checkpoint(std::optional<std::uint64_t> milestone);
  /// False when asked to stop before.
  bool pause_until_saved(std::optional<std::uint64_t> milestone, const std::function<bool()>& stop);
  /// Tries until the disk takes it. False when asked to stop before.
  bool until_written(const std::function<Result<void>()>& write, const std::function<bool()>& stop);
  /// Serves the bus until the next try to write; false when asked to stop.
  bool wait_for_disk(const std::function<bool()>& stop);
  void say_ledger() const;
  /// Ends an unfinished run; the exit code.
  int stopped();
  void tell_while_alone();
  void set_workers(MetricsRow& row, const BusStatistics& bus) const;
  bool run_evaluation_set(const EvaluationSet& set, const std::function<bool()>& stop,
                          Evaluated& result);
  [[nodiscard]] Result<void> record_evaluation(const EvaluationSet& set, const Evaluated& result);
  /// Fills lattice_ once in a session: its grasps follow a script, whatever the weights are. False
  /// when asked to stop before.
  bool run_lattice(EvaluationSet& set, std::uint32_t particles, const std::function<bool()>& stop);
  /// These sets with the present weights; tables into `folder`, recordings if `record`. Empty:
  /// stopped. Precondition: the recorded grid comes before the lattice.
  std::optional<std::vector<EvaluationSummary>> evaluate(std::vector<EvaluationSet> sets,
                                                         const std::string& folder, bool record,
                                                         const std::function<bool()>& stop);
  bool evaluate_on_the_way(const std::function<bool()>& stop);
  /// Evaluates the trained policy; false when asked to stop.
  bool finish_run(RunSummary& results, const std::function<bool()>& stop);
  Result<void> export_policy() const;
  /// summary.json, and what belongs to it where the folder was removed.
  Result<void> write_results(const RunSummary& results);
  /// After two workers gave different results for one task; the exit code.
  int audit_failed();
  RunSummary summary() const;
  void say_phase(LearnerPhase phase);
  /// Does what operators have asked since the last call; not during an update.
  void obey_commands();
  void obey(const ControlCommand& command);
  /// Workers have followed a later learner than this folder knows of.
  bool folder_is_old() const;
  /// Another learner of the run speaks that this folder does not know of; of the two this younger
  /// one ends.
  bool is_second() const;
  std::string second_learner() const;
  double wall_s() const;

  pb::Config config_;
  LearnerOptions options_;
  std::uint64_t config_hash_ = 0;
  PolicyShape shape_;
  std::uint64_t updates_wanted_ = 0;
  std::uint32_t epoch_ = 0;
  std::uint32_t folder_epoch_ = 0;  ///< of the last session in the run folder; 0 = none

  std::unique_ptr<RunLock> lock_;
  std::unique_ptr<CheckpointStore> checkpoints_;
  std::unique_ptr<Ppo> ppo_;
  std::optional<Demonstrations> demonstrations_;  ///< until they are cloned or skipped
  std::unique_ptr<TaskBook> book_;
  std::unique_ptr<LearnerBus> bus_;
  std::unique_ptr<MetricsWriter> metrics_;
  RecentEpisodes episodes_;
  std::vector<EvaluationRow> lattice_;  ///< judged; empty until the first evaluation with one
  PolicyWeights current_, previous_;    ///< v(k) and v(k-1)

  LearnerStatus status_;                                                   ///< as published last
  bool stop_wanted_ = false, paused_ = false, evaluation_wanted_ = false;  ///< by an operator
  std::uint64_t drain_asked_ = 0;  ///< request for a worker that is not known

  std::uint64_t physics_ticks_ = 0;
  double log_prob_check_max_ = 0;
  double best_score_ = -1e300;
  std::int64_t started_ns_ = 0, saved_ns_ = 0;
  std::optional<std::uint64_t> milestone_due_;  ///< crossed and not on disk yet
  std::string unsaved_;  ///< why the last checkpoint could not be written; empty = it was
  std::int64_t unsaved_since_ns_ = 0, unsaved_told_ns_ = 0;
  std::optional<std::uint64_t> saved_steps_;             ///< of the newest checkpoint on disk
  std::int64_t alone_since_ns_ = 0, alone_told_ns_ = 0;  ///< without workers; 0 = not so
  bool waited_too_long_ = false;
  std::int64_t refused_since_ns_ = 0;  ///< every worker refuses the configuration; 0 = not so
  double wall_before_s_ = 0;
  std::uint64_t admitted_before_ = 0;  ///< segments, in earlier sessions
  std::uint64_t steps_before_ = 0;     ///< of earlier sessions, for the rate
  /// What this session spent its time on [s]; names of metrics.csv and summary.json.
  std::map<std::string, double> timings_{{"wait", 0},    {"check", 0}, {"update", 0},
                                         {"publish", 0}, {"save", 0},  {"evaluation", 0}};
};

}  // namespace omentum
