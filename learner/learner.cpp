#include "learner/learner.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <fstream>
#include <thread>

#include "core/check.h"
#include "core/config.h"
#include "core/episode_recording.h"
#include "core/fp_mode.h"
#include "core/log.h"
#include "core/rollout.h"
#include "learner/onnx_export.h"

namespace omentum {
namespace {

// A worker that refuses and another that does not yet speak differ by this [ns].
constexpr std::int64_t kRefusalNs = 3'000'000'000;
// Diverged lanes of one session: a lost episode now and then is no harm, a scene that explodes
// never ends.
constexpr std::uint64_t kMaxFailures = 1000;

const std::vector<std::uint64_t> kMilestones = {500000, 2000000,
                                                3000000};  // the paper's, steps (P VI-B)

double seconds_since(std::int64_t begin_ns) {
  return 1e-9 * static_cast<double>(steady_now_ns() - begin_ns);
}

std::string duration_text(double seconds) {
  const auto s = static_cast<long>(std::max(0.0, seconds));
  return s >= 3600 ? fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
                   : fmt::format("{}:{:02}", s / 60, s % 60);
}

void write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path);
  file << text;
  file.flush();
  if (!file) throw_error("{}: cannot be written", path);
}

std::string one_line(std::string text) {
  for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos;) {
    text.replace(at, 1, at + 1 == text.size() ? "" : "; ");
  }
  return text;
}

void table_to_disk(const SlotTable& table, std::uint32_t state_format, pb::Checkpoint& disk) {
  disk.set_batch(table.batch);
  for (std::size_t i = 0; i < table.slots.size(); ++i) {
    const SlotStart& from = table.slots[i];
    pb::SlotState& to = *disk.add_slot();
    to.set_slot(static_cast<std::uint32_t>(i));
    to.set_next_segment(from.segment);
    to.set_episode(from.episode);
    to.set_episode_step(from.episode_step);
    to.set_episode_limit(from.episode_limit);
    to.set_start_state(from.state.data(), from.state.size());
    to.set_start_hash(from.hash);
    to.set_reset(from.reset);
    to.set_state_format(state_format);
  }
  pb::LedgerTotals& ledger = *disk.mutable_ledger();
  ledger.set_granted(table.ledger.granted);
  ledger.set_regranted(table.ledger.regranted);
  ledger.set_received(table.ledger.received);
  ledger.set_admitted(table.ledger.admitted);
  ledger.set_duplicate(table.ledger.duplicate);
  ledger.set_stale(table.ledger.stale);
  ledger.set_invalid(table.ledger.invalid);
  ledger.set_cancelled(table.ledger.cancelled);
  ledger.set_foreign(table.ledger.foreign);
  ledger.set_overflow(table.ledger.overflow);
  ledger.set_audit_mismatch(table.ledger.audit_mismatch);
}

SlotTable table_from_disk(const pb::Checkpoint& disk) {
  SlotTable table;
  table.batch = disk.batch();
  for (const pb::SlotState& from : disk.slot()) {
    SlotStart to;
    to.segment = from.next_segment();
    to.episode = from.episode();
    to.episode_step = from.episode_step();
    to.episode_limit = from.episode_limit();
    const auto* bytes = reinterpret_cast<const std::byte*>(from.start_state().data());  // NOLINT
    to.state.assign(bytes, bytes + from.start_state().size());
    to.hash = from.start_hash();
    to.reset = from.reset();
    table.slots.push_back(std::move(to));
  }
  const pb::LedgerTotals& ledger = disk.ledger();
  table.ledger.granted = ledger.granted();
  table.ledger.regranted = ledger.regranted();
  table.ledger.received = ledger.received();
  table.ledger.admitted = ledger.admitted();
  table.ledger.duplicate = ledger.duplicate();
  table.ledger.stale = ledger.stale();
  table.ledger.invalid = ledger.invalid();
  table.ledger.cancelled = ledger.cancelled();
  table.ledger.foreign = ledger.foreign();
  table.ledger.overflow = ledger.overflow();
  table.ledger.audit_mismatch = ledger.audit_mismatch();
  return table;
}

}  // namespace

/// Means over the last 100 training episodes, for the console and the curves.
struct Learner::Episodes {
  struct One {
    double return_sum, length, exposure;
    bool success, held, lost;
  };
  std::deque<One> recent;
  std::vector<One> of_update;
  std::uint64_t total = 0;
  std::uint64_t truncated = 0;

  void add(const One& one) {
    recent.push_back(one);
    if (recent.size() > 100) recent.pop_front();
    of_update.push_back(one);
    ++total;
  }
  template <typename F>
  double mean(F&& value) const {
    double sum = 0;
    for (const One& one : recent) sum += static_cast<double>(value(one));
    return recent.empty() ? 0 : sum / static_cast<double>(recent.size());
  }
};

Learner::Learner(pb::Config config, LearnerOptions options)
    : config_(std::move(config)),
      options_(std::move(options)),
      config_hash_(config_hash(config_)),
      shape_(policy_shape(config_)),
      episodes_(std::make_unique<Episodes>()) {
  OMENTUM_CHECK(fp_mode_is_default());
  started_ns_ = steady_now_ns();
  const std::uint64_t per_batch =
      std::uint64_t{config_.rollout().slots()} * config_.rollout().steps_per_segment();
  updates_wanted_ = (config_.rollout().max_steps() + per_batch - 1) / per_batch;
  open_run_folder();
}

Learner::~Learner() = default;

void Learner::open_run_folder() {
  namespace fs = std::filesystem;
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
  checkpoints_ = std::make_unique<CheckpointStore>(options_.run_dir + "/checkpoints", kMilestones);

  const pb::Run& run = config_.run();
  int threads = static_cast<int>(run.learner_threads());
  if (threads == 0) {
    threads = config_.rollout().lead() == pb::LEAD_1
                  ? 1
                  : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  }
  ppo_ = std::make_unique<Ppo>(config_, shape_, threads);
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
  book.observation_size = static_cast<std::uint32_t>(shape_.observations);
  for (const int b : shape_.branches) book.branches.push_back(static_cast<std::uint32_t>(b));
  book.masking = config_.ppo().masking();
  book.segment_crc = segment_crc;
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
  const Result<std::uint32_t> epoch = next_learner_epoch(options_.run_dir);
  if (!epoch) throw_error("{}", epoch.error());
  epoch_ = epoch.value();
  book.learner_epoch = epoch_;
  if (found.value().has_value()) {
    const LoadedCheckpoint& loaded = *found.value();
    for (const std::string& warning : loaded.warnings) log().warn("{}", warning);
    const pb::Checkpoint& saved = loaded.checkpoint;
    const Result<void> taken = ppo_->load(saved.ppo());
    if (!taken) throw_error("{}: {}", loaded.path, taken.error());
    book_ = std::make_unique<TaskBook>(book, table_from_disk(saved));
    if (saved.has_previous_weights()) {
      Result<PolicyWeights> previous = from_disk(saved.previous_weights());
      if (!previous) throw_error("{}: {}", loaded.path, previous.error());
      previous_ = std::move(previous).value();
      previous_.config_hash = config_hash_;
    }
    wall_before_s_ = saved.wall_s();
    physics_ticks_ = saved.physics_steps_total();
    episodes_->total = saved.episodes_total();
    best_score_ = saved.best_score();
    log().info("resumed={} steps={} update={} epoch={}", loaded.path, ppo_->steps_total(),
               ppo_->version(), epoch_);
  } else {
    if (!options_.initialise_from.empty()) {
      const Result<pb::Checkpoint> other = load_checkpoint(options_.initialise_from);
      if (!other) throw_error("--initialise-from: {}", other.error());
      const Result<void> taken = ppo_->initialise_from(other.value().ppo());
      if (!taken) throw_error("--initialise-from {}: {}", options_.initialise_from, taken.error());
    }
    book_ = std::make_unique<TaskBook>(book);
  }
  steps_before_ = ppo_->steps_total();
  current_ = ppo_->weights();
  current_.config_hash = config_hash_;
  write_text(options_.run_dir + "/config.txtpb", print_config(config_));
  metrics_ =
      std::make_unique<MetricsWriter>(options_.run_dir, action_names(config_.task()),
                                      ppo_->version(), config_.run().mlagents_metric_aliases());
}

// The whole run: collect a batch, check it, learn, publish, report, save; then evaluate.
int Learner::run(const std::function<bool()>& stop) {
  LearnerBusOptions options;
  options.run = config_.run().name();
  options.domain = config_.run().domain();
  options.slots = config_.rollout().slots();
  options.learner_epoch = epoch_;
  const std::size_t segment_bytes = 40000 + 80 * std::size_t{config_.rollout().steps_per_segment()};
  options.profile = choose_dds_profile(learner_receive_bytes(options.slots, segment_bytes));
  bus_ = std::make_unique<LearnerBus>(options);

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
      "run={} epoch={} dds={} receive_buffer_bytes={} slots={} steps_per_segment={} lead={} "
      "updates={}",
      options.run, epoch_, options.profile.name, options.profile.receive_buffer_bytes,
      options.slots, manifest.steps_per_segment, manifest.lead, updates_wanted_);

  if (manifest.lead == 1 && current_.policy_version > 0) publish_weights(previous_);
  publish_weights(current_);
  saved_ns_ = steady_now_ns();

  while (ppo_->version() < updates_wanted_) {
    if (!collect_batch(stop)) {
      if (bus_->superseded()) {
        log().error("a learner with epoch {} serves run {}: this one stops",
                    bus_->superseding_epoch(), options.run);
        return 1;
      }
      if (book_->failures() > kMaxFailures) {
        log().error("{} environments diverged, allowed {} in one session; the last one: {}",
                    book_->failures(), kMaxFailures, book_->last_failure());
        bus_->finish(std::int64_t{2'000'000'000});
        return 1;
      }
      save_checkpoint(std::nullopt);
      bus_->finish(std::int64_t{2'000'000'000});
      log().info("stopped steps={} of={} resume with the same run name", ppo_->steps_total(),
                 config_.rollout().max_steps());
      return 130;
    }
    const std::vector<RolloutSegment> segments = book_->take_batch();
    count_episodes(segments);
    std::int64_t mark = steady_now_ns();
    Batch batch = assemble(segments, shape_);
    if (!check_batch(batch)) return 1;
    time_check_s_ += seconds_since(mark);

    mark = steady_now_ns();
    say_phase(LearnerPhase::kUpdating);
    const UpdateStats stats =
        config_.run().updates()
            ? ppo_->update(batch, [this] { bus_->serve(*book_, steady_now_ns()); })
            : ppo_->skip_update(batch);
    time_update_s_ += seconds_since(mark);

    mark = steady_now_ns();
    previous_ = std::move(current_);
    current_ = ppo_->weights();
    current_.config_hash = config_hash_;
    publish_weights(current_);
    bus_->serve(*book_, steady_now_ns());
    time_publish_s_ += seconds_since(mark);
    report_update(stats);

    const bool last = ppo_->version() == updates_wanted_;
    const auto milestone =
        checkpoints_->crossed_milestone(ppo_->steps_total() - batch.rows(), ppo_->steps_total());
    if (last || milestone.has_value() ||
        seconds_since(saved_ns_) >= config_.run().checkpoint_interval_s()) {
      mark = steady_now_ns();
      save_checkpoint(milestone);
      time_save_s_ += seconds_since(mark);
    }
    if (const Result<void> balanced = book_->check_balance(); !balanced) {
      OMENTUM_CHECK(false, "ledger: {}", balanced.error());
    }
  }

  const double train_s = wall_s();
  log().info(
      "trained steps={} wall_s={:.1f} weights={} wait_s={:.1f} check_s={:.1f} update_s={:.1f} "
      "publish_s={:.1f} "
      "save_s={:.1f}",
      ppo_->steps_total(), train_s, hex(current_.weights_hash), time_wait_s_, time_check_s_,
      time_update_s_, time_publish_s_, time_save_s_);
  OnnxMetadata metadata;
  metadata.observation_names = observation_names(config_.task());
  metadata.action_names = action_names(config_.task());
  metadata.git_revision = git_revision();
  metadata.observation_units =
      "positions in W, -1 ... 1 over the workspace box; distances / workspace diagonal";
  if (const Result<void> exported =
          export_onnx(options_.run_dir + "/policy.onnx", shape_, current_, metadata);
      !exported) {
    log().warn("policy.onnx: {}", exported.error());
  }
  const bool evaluated = evaluate(stop);
  const Ledger ledger = book_->ledger();
  log().info(
      "ledger granted={} regranted={} received={} admitted={} duplicate={} stale={} invalid={} "
      "foreign={} "
      "overflow={} cancelled={} outstanding={} evaluated={} failed={} audit_mismatch={}",
      ledger.granted, ledger.regranted, ledger.received, ledger.admitted, ledger.duplicate,
      ledger.stale, ledger.invalid, ledger.foreign, ledger.overflow, ledger.cancelled,
      ledger.outstanding, ledger.evaluated, ledger.failed, ledger.audit_mismatch);
  say_phase(LearnerPhase::kDone);
  bus_->finish(std::int64_t{5'000'000'000});
  return evaluated ? 0 : 130;
}

void Learner::publish_weights(const PolicyWeights& weights) {
  if (const Result<void> sent = bus_->publish_weights(weights); !sent)
    log().warn("weights not sent: {}", sent.error());
  book_->announce_weights(weights.policy_version, weights.weights_hash);
}

bool Learner::collect_batch(const std::function<bool()>& stop) {
  const std::int64_t mark = steady_now_ns();
  say_phase(LearnerPhase::kWaiting);
  while (!book_->batch_complete()) {
    if (stop() || bus_->superseded() || book_->failures() > kMaxFailures) return false;
    bus_->serve(*book_, steady_now_ns());
    if (book_->batch_complete()) break;
    if (const std::optional<std::string> reason = refused_by_workers()) {
      bus_->finish(std::int64_t{2'000'000'000});
      throw_error("{}", one_line(*reason));
    }
    bus_->wait(std::int64_t{20'000'000});
  }
  time_wait_s_ += seconds_since(mark);
  return true;
}

// The scene is resolved by the workers. When this session has not one result and every worker of
// this build that is there says that it cannot, the run will never begin: better to stop with their
// reason.
std::optional<std::string> Learner::refused_by_workers() {
  std::optional<std::string> reason;
  bool able = book_->ledger().received > 0 || bus_->workers_ready() > 0;
  if (!able) {
    for (const WorkerStatus& worker : bus_->worker_statuses()) {
      if (worker.build_id != build_id()) continue;
      const bool refuses = worker.learner_epoch == epoch_ && worker.lanes == 0 &&
                           worker.phase == WorkerPhase::kStarting && !worker.warnings.empty();
      able = able || !refuses;
      if (refuses) reason = worker.warnings.back();
    }
  }
  if (able || !reason) {
    refused_since_ns_ = 0;
    return std::nullopt;
  }
  const std::int64_t now = steady_now_ns();
  if (refused_since_ns_ == 0) refused_since_ns_ = now;
  if (now - refused_since_ns_ < kRefusalNs) return std::nullopt;
  return reason;
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

void Learner::count_episodes(std::span<const RolloutSegment> segments) {
  episodes_->of_update.clear();
  for (const RolloutSegment& s : segments) {
    physics_ticks_ += s.physics_ticks;
    for (std::size_t i = 0; i < s.episode_end_step.size(); ++i) {
      const auto outcome = static_cast<Outcome>(s.episode_outcome[i]);
      Episodes::One one{};
      one.return_sum = s.episode_return[i];
      one.length = s.episode_length[i];
      one.exposure = static_cast<double>(s.episode_exposure[i]);
      one.success = outcome == Outcome::kTargetReached;
      one.held = s.episode_held[i] != 0;
      one.lost = outcome == Outcome::kGraspLost;
      episodes_->add(one);

      EpisodeSummary summary;
      summary.slot = s.slot;
      summary.episode = s.end_episode - (s.episode_end_step.size() - i);
      summary.first_version = summary.last_version = s.policy_version;
      summary.length_steps = s.episode_length[i];
      summary.return_sum = s.episode_return[i];
      summary.outcome = outcome;
      summary.exposure_fraction = s.episode_exposure[i];
      for (std::size_t k = 0; k < 3; ++k) {
        summary.start_position_in_world_m[k] =
            static_cast<double>(s.episode_start_position[3 * i + k]);
        summary.grasp_position_in_world_m[k] =
            static_cast<double>(s.episode_grasp_position[3 * i + k]);
      }
      if (const Result<void> sent = bus_->publish_summary(summary); !sent)
        log().debug("summary: {}", sent.error());
    }
  }
}

double Learner::wall_s() const { return wall_before_s_ + seconds_since(started_ns_); }

void Learner::report_update(const UpdateStats& stats) {
  const double spent = seconds_since(started_ns_);
  const double rate =
      static_cast<double>(ppo_->steps_total() - steps_before_) / std::max(spent, 1e-9);
  const double left =
      static_cast<double>(config_.rollout().max_steps() -
                          std::min(config_.rollout().max_steps(), ppo_->steps_total())) /
      std::max(rate, 1e-9);
  const Episodes& e = *episodes_;
  const double mean_return = e.mean([](const auto& o) { return o.return_sum; });
  const double mean_length = e.mean([](const auto& o) { return o.length; });
  const double exposure = e.mean([](const auto& o) { return o.exposure; });
  const double success = e.mean([](const auto& o) { return o.success ? 1.0 : 0.0; });
  const double held = e.mean([](const auto& o) { return o.held ? 1.0 : 0.0; });

  const BusStatistics bus = bus_->statistics();
  MetricsRow row(action_names(config_.task()));
  row.set_update(stats);
  row.set("charts/episodic_return", mean_return);
  row.set("charts/episodic_length", mean_length);
  row.set("charts/SPS", rate);
  row.set("charts/steps_total", static_cast<double>(ppo_->steps_total()));
  row.set("charts/physics_steps_total", static_cast<double>(physics_ticks_));
  row.set("charts/success_rate", success);
  row.set("charts/exposure_fraction", exposure);
  const double lag = config_.rollout().lead() == pb::LEAD_1 && stats.version > 1 ? 1 : 0;
  row.set("policy/lag_min", lag);
  row.set("policy/lag_mean", lag);
  row.set("policy/lag_max", lag);
  row.set("policy/logp_check_max", log_prob_check_max_);
  set_ledger(row);
  set_workers(row, bus);
  row.set("time/wait_s", time_wait_s_);
  row.set("time/check_s", time_check_s_);
  row.set("time/update_s", time_update_s_);
  row.set("time/publish_s", time_publish_s_);
  row.set("time/save_s", time_save_s_);
  if (const Result<void> written = metrics_->write(stats.version, wall_s(), row); !written) {
    log().warn("metrics: {}", written.error());
  }

  LearnerStatus status;
  status.policy_version = stats.version;
  status.batch = stats.version;
  status.steps_total = ppo_->steps_total();
  status.steps_per_s = rate;
  status.mean_return = mean_return;
  status.mean_length = mean_length;
  status.approx_kl = stats.approx_kl;
  status.entropy = stats.entropy;
  status.explained_variance = stats.explained_variance;
  status.weights_hash = current_.weights_hash;
  bus_->set_status(status);

  if (options_.quiet) return;
  std::printf(
      "update %llu/%llu  steps %llu  %5.1f %%  %.0f steps/s  left %s  reward/step %.4f  exposure "
      "%.3f  success %.2f  "
      "held %.2f  entropy %.3f  kl %.4f  clip %.3f  value_loss %.4f  workers %u  weights %s\n",
      static_cast<unsigned long long>(stats.version),
      static_cast<unsigned long long>(updates_wanted_),
      static_cast<unsigned long long>(ppo_->steps_total()),
      100.0 * static_cast<double>(stats.version) / static_cast<double>(updates_wanted_), rate,
      duration_text(left).c_str(), mean_length > 0 ? mean_return / mean_length : 0.0, exposure,
      success, held, stats.entropy, stats.approx_kl, stats.clip_fraction, stats.value_loss,
      bus.workers_alive, hex(current_.weights_hash).substr(0, 8).c_str());
  std::fflush(stdout);
}

void Learner::set_ledger(MetricsRow& row) const {
  const Ledger l = book_->ledger();
  row.set("ledger/granted", static_cast<double>(l.granted));
  row.set("ledger/regranted", static_cast<double>(l.regranted));
  row.set("ledger/received", static_cast<double>(l.received));
  row.set("ledger/admitted", static_cast<double>(l.admitted));
  row.set("ledger/duplicate", static_cast<double>(l.duplicate));
  row.set("ledger/stale", static_cast<double>(l.stale));
  row.set("ledger/invalid", static_cast<double>(l.invalid));
  row.set("ledger/cancelled", static_cast<double>(l.cancelled));
  row.set("ledger/outstanding", static_cast<double>(l.outstanding));
  row.set("ledger/audit_mismatch", static_cast<double>(l.audit_mismatch));
}

void Learner::set_workers(MetricsRow& row, const BusStatistics& bus) const {
  double lanes = 0;
  double rate = 0;
  double simulating = 0;
  double declined = 0;
  const std::vector<WorkerStatus> workers = bus_->worker_statuses();
  for (const WorkerStatus& w : workers) {
    lanes += w.lanes;
    rate += w.steps_per_s;
    simulating += w.sim_time_fraction / static_cast<double>(workers.size());
    declined += static_cast<double>(w.tasks_declined_config + w.tasks_declined_epoch +
                                    w.tasks_declined_no_weights + w.tasks_declined_state);
  }
  row.set("workers/alive", bus.workers_alive);
  row.set("workers/lanes", lanes);
  row.set("workers/steps_per_s", rate);
  row.set("workers/sim_time_fraction", simulating);
  row.set("workers/wait_fraction", workers.empty() ? 0 : 1 - simulating);
  row.set("workers/lost_leases", static_cast<double>(bus.worker_crashes));
  row.set("workers/declined", declined);
}

void Learner::save_checkpoint(std::optional<std::uint64_t> milestone) {
  pb::Checkpoint checkpoint;
  checkpoint.set_format_version(kCheckpointFormat);
  checkpoint.set_config_text(print_config(config_));
  checkpoint.set_config_hash(config_hash_);
  checkpoint.set_run_seed(config_.rollout().run_seed());
  checkpoint.set_git_revision(git_revision());
  checkpoint.set_build_id(build_id());
  ppo_->save(*checkpoint.mutable_ppo());
  if (config_.rollout().lead() == pb::LEAD_1 && ppo_->version() > 0) {
    to_disk(previous_, *checkpoint.mutable_previous_weights());
  }
  table_to_disk(book_->table(), kSimStateFormat, checkpoint);
  checkpoint.set_physics_steps_total(physics_ticks_);
  checkpoint.set_episodes_total(episodes_->total);
  checkpoint.set_wall_s(wall_s());
  const double score = episodes_->mean([](const auto& o) { return o.return_sum; });
  CheckpointStore::Save what;
  what.best = episodes_->recent.size() >= 100 && score > best_score_;
  what.milestone = milestone;
  if (what.best) best_score_ = score;
  checkpoint.set_best_score(best_score_);
  // A full disk must not end the training: go on, the last good file is untouched, the next update
  // tries again.
  if (const Result<void> saved = checkpoints_->save(checkpoint, what); !saved) {
    log().warn("checkpoint: {}", saved.error());
  } else {
    saved_ns_ = steady_now_ns();
  }
}

void Learner::say_phase(LearnerPhase phase) {
  LearnerStatus status;
  status.phase = phase;
  status.policy_version = ppo_->version();
  status.batch = ppo_->version();
  status.steps_total = ppo_->steps_total();
  status.weights_hash = current_.weights_hash;
  bus_->set_status(status);
}

bool Learner::run_evaluation_set(const EvaluationSet& set, const std::function<bool()>& stop,
                                 Evaluated& result) {
  book_->evaluate(evaluation_tasks(config_, set, current_.policy_version));
  while (!book_->evaluation_complete()) {
    if (stop() || bus_->superseded()) return false;
    bus_->serve(*book_, steady_now_ns());
    if (!book_->evaluation_complete()) bus_->wait(std::int64_t{20'000'000});
  }
  result.tasks = book_->granted_evaluation();
  result.segments = book_->take_evaluation();
  return true;
}

bool Learner::evaluate(const std::function<bool()>& stop) {
  RunSummary summary;
  summary.run_id = config_.run().name();
  summary.weights_hash = hex(current_.weights_hash);
  summary.config_hash = fmt::format("{:016x}", config_hash_);
  summary.git_revision = git_revision();
  summary.run_seed = config_.rollout().run_seed();
  summary.steps = ppo_->steps_total();
  summary.physics_steps = physics_ticks_;
  summary.updates = ppo_->version();
  summary.episodes = episodes_->total;
  summary.wall_s = wall_s();
  summary.mean_return = episodes_->mean([](const auto& o) { return o.return_sum; });
  const std::int64_t began = steady_now_ns();
  if (config_.evaluation().enabled()) {
    say_phase(LearnerPhase::kEvaluating);
    const std::string folder = options_.run_dir + "/evaluation";
    std::filesystem::create_directories(folder);
    std::filesystem::create_directories(options_.run_dir + "/recordings");
    double best_exposure = 0;
    std::vector<EvaluationSet> sets = evaluation_sets(config_);
    std::vector<Evaluated> results(sets.size());
    // The recorded set comes first: its frames tell how many particles the lattice has to try.
    for (std::size_t i = 0; i < sets.size(); ++i) {
      if (sets[i].start_set == StartSet::kGraspLattice) {
        fill_lattice(config_,
                     particles_of(results[0].segments, config_.evaluation().frame_stride()),
                     sets[i]);
      }
      if (sets[i].start_indices.empty()) continue;
      if (!run_evaluation_set(sets[i], stop, results[i])) return false;
      if (sets[i].start_set == StartSet::kGraspLattice)
        best_exposure = best_lattice_exposure(judge(sets[i], results[i].segments, 0));
    }
    for (std::size_t i = 0; i < sets.size(); ++i) {
      const EvaluationSet& set = sets[i];
      if (set.start_indices.empty()) continue;
      const std::vector<EpisodeResult> judged = judge(set, results[i].segments, best_exposure);
      write_evaluation_csv(folder + "/" + set.name + ".csv", config_, set, judged, best_exposure);
      EvaluationSummary entry;
      entry.name = set.name;
      entry.starts = judged.size();
      double failed = 0;
      for (const EpisodeResult& r : judged) {
        entry.target_reached += r.reached ? 1 : 0;
        entry.exposed += r.exposed ? 1 : 0;
        entry.grasp_held += r.grasp_held ? 1 : 0;
        failed += r.failed ? 1 : 0;
      }
      entry.values["best_exposure"] = best_exposure;
      entry.values["failed"] = failed;
      if (!options_.quiet) {
        std::printf(
            "evaluation %-16s starts %3llu  target_reached %3llu  exposed %3llu  grasp_held %3llu  "
            "best_exposure %.3f\n",
            set.name.c_str(), static_cast<unsigned long long>(entry.starts),
            static_cast<unsigned long long>(entry.target_reached),
            static_cast<unsigned long long>(entry.exposed),
            static_cast<unsigned long long>(entry.grasp_held), best_exposure);
        std::fflush(stdout);
      }
      summary.evaluations.push_back(entry);
      if (set.record) record_evaluation(set, results[i]);
    }
  }
  summary.timings["wait"] = time_wait_s_;
  summary.timings["check"] = time_check_s_;
  summary.timings["update"] = time_update_s_;
  summary.timings["publish"] = time_publish_s_;
  summary.timings["save"] = time_save_s_;
  summary.timings["evaluation"] = seconds_since(began);
  if (const Result<void> written = write_summary(options_.run_dir + "/summary.json", summary);
      !written) {
    throw_error("{}", written.error());
  }
  return true;
}

void Learner::record_evaluation(const EvaluationSet& set, const Evaluated& result) {
  RecordingContext context;
  context.name = set.name;
  context.config_text = print_config(config_);
  context.config_hash = config_hash_;
  context.git_revision = git_revision();
  context.control_period = config_.task().control_period_s() * config_.task().action_repeat();
  for (std::size_t i = 0; i < result.segments.size(); ++i) {
    const RolloutSegment& segment = result.segments[i];
    const RolloutTask& task = result.tasks[i];
    if (segment.failed != 0) continue;
    context.particles = particles_of(std::span(&segment, 1), task.frame_stride);
    const std::string path =
        fmt::format("{}/recordings/{}_{}.mcap", options_.run_dir, set.name, task.start_index);
    if (const Result<void> saved = save_episode(path, task, segment, context); !saved) {
      log().warn("recording: {}", saved.error());
    }
  }
}

}  // namespace omentum
