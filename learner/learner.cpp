#include "learner/learner.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <thread>

#include "core/build_id.h"
#include "core/check.h"
#include "core/clock.h"
#include "core/config.h"
#include "core/durable_file.h"
#include "core/fp_mode.h"
#include "core/log.h"
#include "core/rollout.h"
#include "core/task.h"

namespace omentum {
namespace {

// Diverged lanes of one session: single ones are skipped, an unstable scene ends the run.
constexpr std::uint64_t kMaxFailures = 1000;

// Before it speaks a learner listens so long for one that is there already; with DDS Security keys
// are exchanged first.
constexpr std::int64_t kListenNs = 500'000'000;
constexpr std::int64_t kListenSecuredNs = 2'000'000'000;

std::string one_line(std::string text) {
  for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos;) {
    text.replace(at, 1, at + 1 == text.size() ? "" : "; ");
  }
  return text;
}

}  // namespace

Learner::Learner(pb::Config config, LearnerOptions options)
    : config_(std::move(config)),
      options_(std::move(options)),
      config_hash_(config_hash(config_)),
      shape_(policy_shape(config_)) {
  OMENTUM_CHECK(fp_mode_is_default());
  started_ns_ = steady_now_ns();
  const std::uint64_t per_batch =
      std::uint64_t{config_.rollout().slots()} * config_.rollout().steps_per_segment();
  updates_wanted_ = (config_.rollout().max_steps() + per_batch - 1) / per_batch;
  open_run_folder();
}

void Learner::open_run_folder() {
  namespace fs = std::filesystem;
  const pb::Run& run = config_.run();
  int threads = static_cast<int>(run.learner_threads());
  if (threads == 0) {
    threads = config_.rollout().lead() == pb::LEAD_1
                  ? 1
                  : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  }
  ppo_ = std::make_unique<Ppo>(config_, shape_, threads);
  // Before anything is made or moved: a file that cannot be taken leaves nothing behind.
  if (!options_.initialise_from.empty() && !options_.initialise_from_recordings.empty())
    throw_error("--initialise-from and --initialise-from-recordings: allowed one of them");
  if (!options_.initialise_from.empty()) {
    const Result<pb::Checkpoint> other = load_checkpoint(options_.initialise_from);
    if (!other) throw_error("--initialise-from: {}", other.error());
    const Result<void> taken = ppo_->initialise_from(other.value().ppo());
    if (!taken) throw_error("--initialise-from {}: {}", options_.initialise_from, taken.error());
  }
  if (!options_.initialise_from_recordings.empty()) {
    demonstrations_ = read_demonstrations(options_.initialise_from_recordings, config_);
  }
  lock_ = std::make_unique<RunLock>(options_.run_dir);
  if (options_.restart && fs::exists(options_.run_dir)) {
    std::string aside;
    for (int i = 1; aside.empty() || fs::exists(aside); ++i)
      aside = fmt::format("{}.old{}", options_.run_dir, i);
    fs::rename(options_.run_dir, aside);
    log().info("moved={} to={}", options_.run_dir, aside);
  }
  std::error_code error;
  fs::create_directories(options_.run_dir + "/checkpoints", error);
  if (error) throw_error("{}: {}", options_.run_dir, error.message());
  std::vector<std::uint64_t> milestones;
  for (const pb::Milestone& milestone : config_.report().milestone())
    milestones.push_back(milestone.steps());
  checkpoints_ =
      std::make_unique<CheckpointStore>(options_.run_dir + "/checkpoints", std::move(milestones));
  restore();
}

void Learner::restore() {
  TaskBookConfig book;
  const pb::Rollout& rollout = config_.rollout();
  book.run_seed = rollout.run_seed();
  book.config_hash = config_hash_;
  book.slots = rollout.slots();
  book.steps = rollout.steps_per_segment();
  book.lead = static_cast<std::uint32_t>(rollout.lead());
  book.episode_decisions =
      std::max(1U, config_.task().episode_steps() / config_.task().action_repeat());
  book.stagger = rollout.stagger();
  book.batches = updates_wanted_;
  book.state_format = kSimStateFormat;
  book.shape = shape_;
  book.audit_rate = config_.run().audit_rate();

  const Result<std::optional<LoadedCheckpoint>> found = checkpoints_->load_newest();
  if (!found) throw_error("{}", found.error());
  if (found.value().has_value()) {
    const Result<void> same =
        check_same_config(found.value()->checkpoint, config_hash_, print_config(config_));
    if (!same) {
      throw_error("{}: holds a run of another configuration (--restart moves it aside): {}",
                  options_.run_dir, one_line(same.error()));
    }
  }
  if (!found.value().has_value()) refuse_to_overwrite();
  const Result<std::uint32_t> last = last_learner_epoch(options_.run_dir);
  if (!last) throw_error("{}", last.error());
  folder_epoch_ = last.value();
  const Result<std::uint32_t> epoch = next_learner_epoch(
      options_.run_dir, static_cast<std::uint32_t>(wall_now_ns() / 1'000'000'000));
  if (!epoch) throw_error("{}", epoch.error());
  epoch_ = epoch.value();
  book.learner_epoch = epoch_;
  if (found.value().has_value()) {
    const LoadedCheckpoint& loaded = *found.value();
    for (const std::string& warning : loaded.warnings)
      log().warn("event=checkpoint_skipped reason=\"{}\" older taken: {}", warning, loaded.path);
    if (!options_.initialise_from.empty())
      log().warn("event=initialise_from_skipped reason=\"the run goes on from its checkpoint\"");
    if (demonstrations_) {
      log().warn(
          "event=initialise_from_recordings_skipped reason=\"the run goes on from its "
          "checkpoint\"");
    }
    const pb::Checkpoint& saved = loaded.checkpoint;
    const Result<void> taken = ppo_->load(saved.ppo());
    if (!taken) throw_error("{}: {}", loaded.path, taken.error());
    book_ = std::make_unique<TaskBook>(book, slots_from_disk(saved));
    if (saved.has_previous_weights()) {
      Result<PolicyWeights> previous = from_disk(saved.previous_weights());
      if (!previous) throw_error("{}: {}", loaded.path, previous.error());
      previous_ = std::move(previous).value();
      previous_.config_hash = config_hash_;
    }
    wall_before_s_ = saved.wall_s();
    physics_ticks_ = saved.physics_steps_total();
    for (const pb::RecentEpisode& one : saved.recent_episode()) {
      episodes_.add(
          {one.return_sum(), one.length(), one.exposure(), one.success(), one.held(), one.lost()});
    }
    episodes_.total = saved.episodes_total();
    best_score_ = saved.best_score();
    log().info("resumed={} steps={} update={} epoch={}", loaded.path, ppo_->steps_total(),
               ppo_->version(), epoch_);
  } else {
    book_ = std::make_unique<TaskBook>(book);
    if (demonstrations_) clone_demonstrations();
  }
  demonstrations_.reset();
  steps_before_ = ppo_->steps_total();
  admitted_before_ = book_->ledger().admitted;
  if (found.value().has_value()) saved_steps_ = steps_before_;
  current_ = ppo_->weights();
  current_.config_hash = config_hash_;
  if (const Result<void> written =
          write_durably(options_.run_dir + "/config.txtpb", print_config(config_));
      !written) {
    throw_error("{}", written.error());
  }
  metrics_ =
      std::make_unique<MetricsWriter>(options_.run_dir, action_names(config_.task()),
                                      ppo_->version(), config_.run().mlagents_metric_aliases());
}

void Learner::clone_demonstrations() {
  for (const std::string& file : demonstrations_->left_out)
    log().warn("event=demonstration_left_out reason=\"{}: p_T was not reached\"", file);
  const std::int64_t mark = steady_now_ns();
  const std::size_t episodes = demonstrations_->episodes;
  const std::size_t steps = demonstrations_->batch.rows();
  const CloningStats stats = ppo_->clone(std::move(demonstrations_->batch));
  log().info(
      "cloned episodes={} steps={} minibatches={} surprise={:.4f} first_surprise={:.4f} "
      "value_error={:.4f} first_value_error={:.4f} wall_s={:.1f}",
      episodes, steps, stats.minibatches, stats.surprise, stats.first_surprise, stats.value_error,
      stats.first_value_error, seconds_since(mark));
}

// The whole run: collect a batch, check it, learn, publish, report, save; then evaluate.
int Learner::run(const std::function<bool()>& stop_from_outside) {
  const std::function<bool()> stop = [&] {
    return stop_wanted_ || bus_->expired() || stop_from_outside();
  };
  LearnerBusOptions options;
  options.run = config_.run().name();
  options.domain = config_.run().domain();
  options.slots = config_.rollout().slots();
  options.heartbeat = options_.heartbeat;
  options.learner_epoch = epoch_;
  std::optional<DdsProfile> profile =
      wait_for_dds_profile(options_.dds, DdsRole::kHub, options.domain, kReceiveBufferBytes,
                           static_cast<std::int64_t>(1e9 * options_.max_wait_s), stop_from_outside);
  if (!profile) return stop_from_outside() ? 130 : 1;
  options.profile = std::move(*profile);
  bus_ = std::make_unique<LearnerBus>(options);
  bus_->listen_for_older(options_.dds.security_dir.empty() ? kListenNs : kListenSecuredNs);
  if (is_second()) throw_error("{}", second_learner());

  RunManifest manifest;
  manifest.run_id = config_.run().name();
  manifest.config_text = print_config(config_);
  manifest.config_hash = config_hash_;
  manifest.layout_hash = shape_.layout_hash();
  manifest.build_id = build_id();
  manifest.git_revision = git_revision();
  manifest.run_seed = config_.rollout().run_seed();
  manifest.slots = config_.rollout().slots();
  manifest.steps_per_segment = config_.rollout().steps_per_segment();
  manifest.lead = static_cast<std::uint32_t>(config_.rollout().lead());
  manifest.state_format = kSimStateFormat;
  manifest.observation_names = observation_names(config_.task());
  manifest.action_names = action_names(config_.task());
  if (const Result<void> sent = bus_->publish_manifest(manifest); !sent)
    throw_error("manifest: {}", sent.error());
  log().info(
      "run={} domain={} epoch={} dds={} receive_buffer_bytes={} slots={} steps_per_segment={} "
      "lead={} "
      "updates={}",
      options.run, options.domain, epoch_, options.profile.name,
      options.profile.receive_buffer_bytes, options.slots, manifest.steps_per_segment,
      manifest.lead, updates_wanted_);

  if (manifest.lead == 1 && current_.policy_version > 0) publish_weights(previous_);
  publish_weights(current_);
  saved_ns_ = steady_now_ns();

  while (ppo_->version() < updates_wanted_) {
    if (!evaluate_on_the_way(stop) || !collect_batch(stop)) {
      if (bus_->superseded()) {
        log().error("a learner with epoch {} serves run {}: this one stops",
                    bus_->superseding_epoch(), options.run);
        // Unless that one has taken over the folder.
        const Result<std::uint32_t> last = last_learner_epoch(options_.run_dir);
        if (last && last.value() == epoch_) stopped();
        return 1;
      }
      if (is_second()) {
        log().error("{}", second_learner());
        return 1;
      }
      if (book_->audit_difference()) return audit_failed();
      if (book_->failures() > kMaxFailures) {
        log().error("{} environments diverged, allowed {} in one session; the last one: {}",
                    book_->failures(), kMaxFailures, book_->last_failure());
        bus_->finish(std::int64_t{2'000'000'000});
        return 1;
      }
      if (folder_is_old()) {
        log().error(
            "workers have followed epoch {} of run {}, {} knows of {} only: the wrong folder, or "
            "an "
            "old copy; --restart begins anew",
            bus_->epoch_of_workers(), options.run, options_.run_dir, folder_epoch_);
        return 1;
      }
      const int code = stopped();
      if (bus_->expired()) {
        log().error("the certificate has ended: {}",
                    certificate_warning(options.profile).value_or(""));
        return 1;
      }
      return waited_too_long_ ? 1 : code;
    }
    const std::vector<RolloutSegment> segments = book_->take_batch();
    count_episodes(segments);
    std::int64_t mark = steady_now_ns();
    Batch batch = assemble(segments, shape_);
    if (!check_batch(batch)) return 1;
    timings_["check"] += seconds_since(mark);

    mark = steady_now_ns();
    say_phase(LearnerPhase::kUpdating);
    const UpdateStats stats =
        config_.run().updates()
            ? ppo_->update(batch, [this] { bus_->serve(*book_, steady_now_ns()); })
            : ppo_->skip_update(batch);
    timings_["update"] += seconds_since(mark);

    mark = steady_now_ns();
    previous_ = std::move(current_);
    current_ = ppo_->weights();
    current_.config_hash = config_hash_;
    publish_weights(current_);
    bus_->serve(*book_, steady_now_ns());
    timings_["publish"] += seconds_since(mark);
    report_update(stats);

    const bool last = ppo_->version() == updates_wanted_;
    const auto milestone =
        checkpoints_->crossed_milestone(ppo_->steps_total() - batch.rows(), ppo_->steps_total());
    if (last || milestone.has_value() ||
        seconds_since(saved_ns_) >= config_.run().checkpoint_interval_s() ||
        (!unsaved_.empty() && seconds_since(saved_ns_) >= kRetrySaveS)) {
      mark = steady_now_ns();
      save_checkpoint(milestone);
      timings_["save"] += seconds_since(mark);
    }
    if (!unsaved_.empty() &&
        (last || seconds_since(unsaved_since_ns_) > options_.unsaved_limit_s) &&
        !pause_until_saved(milestone, stop)) {
      return stopped();
    }
    if (const Result<void> balanced = book_->check_balance(); !balanced) {
      OMENTUM_CHECK(false, "ledger: {}", balanced.error());
    }
  }

  std::string spent;
  for (const auto& [name, seconds] : timings_) spent += fmt::format(" {}_s={:.1f}", name, seconds);
  log().info("trained steps={} wall_s={:.1f} weights={}{}", ppo_->steps_total(), wall_s(),
             hex(current_.weights_hash), spent);
  const auto export_policy = [this] { return this->export_policy(); };
  RunSummary results;
  const auto write = [&] { return write_results(results); };
  bool finished =
      until_written(export_policy, stop) && finish_run(results, stop) && until_written(write, stop);
  if (book_->audit_difference()) return audit_failed();
  say_ledger();
  if (metrics_->incomplete() > 0) {
    log().error(
        "event=metrics_incomplete updates={} some of metrics.csv, metrics.jsonl and the "
        "TensorBoard file lack their rows",
        metrics_->incomplete());
  }
  say_phase(LearnerPhase::kDone);
  bus_->finish(std::int64_t{5'000'000'000});
  // Exit code 0 means that the results are there, whatever happened to the folder meanwhile.
  if (finished && !std::filesystem::exists(options_.run_dir + "/summary.json"))
    finished = until_written(write, stop);
  return finished ? 0 : 130;
}

void Learner::say_ledger() const {
  std::string counters;
  for (const auto& [name, value] : kLedgerCounters)
    counters += fmt::format(" {}={}", name, book_->ledger().*value);
  log().info("ledger{}", counters);
}

int Learner::audit_failed() {
  const AuditDifference& difference = *book_->audit_difference();
  const std::string text =
      fmt::format("two results of slot {} segment {} differ in {}: {} and {}", difference.slot,
                  difference.segment,
                  difference.end_state ? "the end state" : "their steps, with equal end states",
                  bus_->describe_worker(difference.worker_ids[0]),
                  bus_->describe_worker(difference.worker_ids[1]));
  log().error("event=audit_mismatch {}; nothing collected since the last comparison can be trusted",
              text);
  RunSummary failed = summary();
  failed.audit_mismatch = text;
  const std::string path = options_.run_dir + "/summary.json";
  if (const Result<void> written = write_summary(path, failed); !written)
    log().error("event=not_written reason=\"{}\"", written.error());
  bus_->finish(std::int64_t{2'000'000'000});
  return 1;
}

double Learner::wall_s() const { return wall_before_s_ + seconds_since(started_ns_); }

void Learner::publish_weights(const PolicyWeights& weights) {
  if (const Result<void> sent = bus_->publish_weights(weights); !sent)
    log().warn("weights not sent: {}", sent.error());
  book_->announce_weights(weights.policy_version, weights.weights_hash);
}

bool Learner::collect_batch(const std::function<bool()>& stop) {
  const std::int64_t mark = steady_now_ns();
  say_phase(paused_ ? LearnerPhase::kPaused : LearnerPhase::kWaiting);
  while (!book_->batch_complete()) {
    obey_commands();
    if (stop() || folder_is_old() || is_second() || bus_->superseded() ||
        book_->failures() > kMaxFailures) {
      return false;
    }
    if (book_->audit_difference()) return false;
    bus_->serve(*book_, steady_now_ns());
    if (book_->batch_complete()) break;
    tell_while_alone();
    if (waited_too_long_) return false;
    if (const std::optional<std::string> reason = refused_by_workers()) {
      bus_->finish(std::int64_t{2'000'000'000});
      throw_error("{}{}", place_in_scene(scene_path(config_), *reason), one_line(*reason));
    }
    bus_->wait(std::int64_t{20'000'000});
  }
  timings_["wait"] += seconds_since(mark);
  return true;
}

bool Learner::check_batch(Batch& batch) {
  // Batch k was collected with weights k (lead 0) or max(k - 1, 0) (lead 1).
  const std::uint64_t k = ppo_->version();
  const bool lags = config_.rollout().lead() == pb::LEAD_1 && k > 0;
  const PolicyWeights& weights = lags ? previous_ : current_;
  for (const std::uint64_t version : batch.policy_versions) {
    OMENTUM_CHECK(version == weights.policy_version, "batch {} with weights {} instead of {}", k,
                  version, weights.policy_version);
  }
  if (!config_.run().updates()) return true;
  Policy behaviour(shape_, weights);
  const LogProbCheck check = complete_batch(behaviour, batch);
  log_prob_check_max_ = check.largest_log_prob_difference;
  if (!config_.ppo().check_log_probs()) return true;
  if (check.largest_log_prob_difference == 0 && check.largest_value_difference == 0) return true;
  log().error(
      "integrity: log-probability of slot {} step {} of batch {} differs by {:.9g} (value by "
      "{:.9g}) from the "
      "weights {} it names; builds or machines compute differently",
      check.slot, check.step, k, check.largest_log_prob_difference, check.largest_value_difference,
      hex(weights.weights_hash));
  return false;
}

void Learner::say_phase(LearnerPhase phase) {
  status_.phase = phase;
  status_.policy_version = ppo_->version();
  status_.batch = ppo_->version();
  status_.steps_total = ppo_->steps_total();
  status_.steps_wanted = config_.rollout().max_steps();
  status_.weights_hash = current_.weights_hash;
  bus_->set_status(status_);
}

}  // namespace omentum
