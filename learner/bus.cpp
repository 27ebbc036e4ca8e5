#include "learner/bus.h"

#include <algorithm>

#include "core/check.h"
#include "core/clock.h"
#include "core/hash.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kSilentNs = 2'000 * kMs;  // deadline of worker status, docs/wire.md 3
constexpr std::int64_t kRetireNs = 5'000 * kMs;  // a dead worker's reader is gone after the lease
constexpr std::int64_t kReportPeriodNs = 100 * kMs;  // ledger into the status
constexpr std::int64_t kMatchPollNs = 5 * kMs;
constexpr std::int64_t kRepeatPeriodNs = 2'000 * kMs;
constexpr std::size_t kWeightsKept = 2;  // lead 1 has two versions alive
constexpr std::int64_t kWarnPeriodNs = 10'000 * kMs;
constexpr std::size_t kLeastRing = 64;
constexpr std::size_t kMostBarredTold = 64;
constexpr std::size_t kRepliesKept = 64;
constexpr std::size_t kMostKnown = 4096;
constexpr std::uint32_t kWritersPerS = 64;  // a flood of made-up workers must not take all the time
constexpr std::int64_t kUnheardNs = 5'000 * kMs;  // longer than a lease and a second grant
constexpr std::size_t kMostUnheardTold = 64;

// Runs in the member initialisers: nothing may be created for a run that cannot have a partition.
LearnerBusOptions checked(LearnerBusOptions options) {
  check_run_name(options.run);
  OMENTUM_CHECK(options.slots >= 1);
  return options;
}

}  // namespace

LearnerBus::LearnerBus(const LearnerBusOptions& options)
    : options_(checked(options)),
      policy_id_(static_cast<std::uint32_t>(fnv1a64(options_.run))),
      ring_capacity_(std::max<std::size_t>(kLeastRing, std::size_t{4} * options_.slots)),
      participant_(options_.domain, options_.profile.uri, "omentum-learner"),
      manifest_writer_(participant_, public_partitions(options_.run), "learner-manifest"),
      weights_writer_(participant_, public_partitions(options_.run), "learner-weights"),
      summary_writer_(participant_, public_partitions(options_.run), "learner-summary"),
      status_writer_(participant_, public_partitions(options_.run), "learner-status"),
      segment_reader_(std::in_place, participant_, run_partition(options_.run), "learner-segments",
                      static_cast<std::int32_t>(ring_capacity_)),
      worker_reader_(participant_, run_partition(options_.run), "learner-workers"),
      learner_reader_(participant_, run_partition(options_.run), "learner-epochs"),
      command_reader_(participant_, run_partition(options_.run), "learner-commands"),
      reply_writer_(participant_, public_partitions(options_.run), "learner-replies"),
      waitset_(participant_),
      heartbeat_(options_.heartbeat) {
  status_.run_id = options_.run;
  status_.learner_epoch = options_.learner_epoch;
  waitset_.attach(segment_reader_->raw());
  waitset_.attach(worker_reader_.raw());
  waitset_.attach(learner_reader_.raw());
  waitset_.attach(command_reader_.raw());
  if (options_.profile.discovery == Discovery::kHub) {
    mirror_.emplace(participant_, options_.run);
    frame_reader_.emplace(participant_, run_partition(options_.run), "learner-frames");
    reply_reader_.emplace(participant_, run_partition(options_.run), "learner-worker-replies");
    waitset_.attach(frame_reader_->raw());
    waitset_.attach(reply_reader_->raw());
    robot_reader_.emplace(participant_, run_partition(options_.run), "learner-robots");
    waitset_.attach(robot_reader_->raw());
  }
  drain_thread_ = std::jthread([this](const std::stop_token& stop) { drain(stop); });
}

LearnerBus::~LearnerBus() {
  drain_thread_.request_stop();
  waitset_.wake();
  drain_thread_.join();
  segment_reader_.reset();  // first: while it is full nothing else can go
}

// -------------------------------------------------------------------------------------- publishing

Result<void> LearnerBus::publish_manifest(RunManifest manifest) {
  if (superseded()) return {};
  manifest.run_id = options_.run;
  manifest.learner_epoch = options_.learner_epoch;
  manifest_ = std::move(manifest);
  const Result<void> written = manifest_writer_.write(manifest_);
  speaks_ = true;
  waitset_.wake();
  return written;
}

std::uint32_t LearnerBus::listen_for_older(std::int64_t timeout_ns) {
  std::unique_lock lock(mutex_);
  something_.wait_for(lock, std::chrono::nanoseconds(timeout_ns),
                      [this] { return older_epoch() != 0 || superseded(); });
  return older_epoch();
}

Result<void> LearnerBus::publish_weights(PolicyWeights weights) {
  if (superseded()) return {};
  weights.policy_id = policy_id_;
  weights.learner_epoch = options_.learner_epoch;
  weights.published_at_ns = wall_now_ns();
  const std::size_t bytes = wire_bytes(weights);
  {
    const std::lock_guard lock(mutex_);
    statistics_.bytes_down += bytes * statistics_.workers_alive;
  }
  sent_weights_.push_back(std::move(weights));
  if (sent_weights_.size() > kWeightsKept) sent_weights_.pop_front();
  return weights_writer_.write(sent_weights_.back());
}

/// Sends again what a worker says it lacks: the manifest while it follows another learner, weights
/// after a decline. A sample can get lost where a lease ran out on a busy machine.
void LearnerBus::repeat_for_workers(std::int64_t now_ns) {
  if (manifest_.run_id.empty() || now_ns - repeated_ns_ < kRepeatPeriodNs) return;
  const bool behind = std::any_of(served_.begin(), served_.end(), [this](const auto& entry) {
    return entry.second.last.learner_epoch != options_.learner_epoch;
  });
  if (!behind && !weights_wanted_) return;
  repeated_ns_ = now_ns;
  bool ok = !behind || manifest_writer_.write(manifest_).has_value();
  if (std::exchange(weights_wanted_, false)) {
    for (const PolicyWeights& weights : sent_weights_)
      ok = weights_writer_.write(weights).has_value() && ok;
  }
  if (!ok) log().warn("event=not_sent_again");
}

Result<void> LearnerBus::publish_summary(const EpisodeSummary& summary) {
  if (superseded()) return {};
  return summary_writer_.write(summary);
}

void LearnerBus::set_status(const LearnerStatus& status) {
  const std::lock_guard lock(mutex_);
  const LearnerStatus old = std::exchange(status_, status);
  status_.run_id = options_.run;
  status_.learner_epoch = options_.learner_epoch;
  static_cast<Ledger&>(status_) = static_cast<const Ledger&>(old);
  status_.oldest_task_age_s = old.oldest_task_age_s;
  status_.bytes_up_per_s = old.bytes_up_per_s;
  status_.bytes_down_per_s = old.bytes_down_per_s;
  status_.barred_worker_ids = old.barred_worker_ids;
  status_.barred_reasons = old.barred_reasons;
  status_.unheard_worker_ids = old.unheard_worker_ids;
  status_.alarms = old.alarms;
  status_.alarms_raised = old.alarms_raised;
  if (old.phase != status_.phase) {
    status_urgent_ = true;
    waitset_.wake();
  }
}

void LearnerBus::report_book(const TaskBook& book, std::int64_t now_ns) {
  if (now_ns - reported_ns_ < kReportPeriodNs) return;
  reported_ns_ = now_ns;
  const Ledger ledger = book.ledger();
  const double age = book.oldest_task_age_s(now_ns);
  std::vector<std::uint32_t> ids;
  std::vector<std::string> reasons;
  for (const Barred& barred : book.barred(now_ns)) {
    const bool told =
        std::find(barred_told_.begin(), barred_told_.end(), barred.worker_id) != barred_told_.end();
    if (!told) {
      log().warn("event=worker_barred {} for_s={:.0f} reason=\"{}\"",
                 describe_worker(barred.worker_id), barred.for_s, barred.reason);
    }
    if (ids.size() >= kMostBarredTold) continue;
    ids.push_back(barred.worker_id);
    reasons.push_back(barred.reason);
  }
  barred_told_ = ids;
  raise_alarms();
  const std::lock_guard lock(mutex_);
  status_.alarms = alarms_.texts();
  status_.alarms_raised = alarms_.raised();
  static_cast<Ledger&>(status_) = ledger;
  status_.oldest_task_age_s = age;
  status_.barred_worker_ids = std::move(ids);
  status_.barred_reasons = std::move(reasons);
}

std::string LearnerBus::describe_worker(std::uint32_t id) const {
  const auto found = known_.find(id);
  if (found == known_.end()) return fmt::format("worker={}", id);
  const WorkerStatus& worker = found->second;
  return fmt::format("worker={} host={} pid={} build={:016x}", id, worker.host, worker.pid,
                     worker.build_id);
}

// ---------------------------------------------------------------------------------- learner thread

bool LearnerBus::wait(std::int64_t timeout_ns) {
  // Matching of a new worker's task writer is not an event here: look again soon.
  const bool matching = std::any_of(served_.begin(), served_.end(),
                                    [](const auto& entry) { return !entry.second.joined; });
  if (matching) timeout_ns = std::min(timeout_ns, kMatchPollNs);
  std::unique_lock lock(mutex_);
  return something_.wait_for(lock, std::chrono::nanoseconds(timeout_ns), [this] {
    return !ring_.empty() || !overflown_.empty() || !commands_.empty() || workers_.has_changed() ||
           superseded();
  });
}

void LearnerBus::serve(TaskBook& book, std::int64_t now_ns) {
  heartbeat_.beat(steady_now_ns());
  if (expired()) return;
  std::deque<RolloutSegment> segments;
  std::vector<std::pair<std::uint32_t, std::uint64_t>> overflown;
  std::vector<std::pair<std::uint32_t, ListedWorker>> changed;
  std::uint64_t refused = 0;
  std::uint64_t foreign = 0, of_robots = 0;
  {
    const std::lock_guard lock(mutex_);
    segments.swap(ring_);
    overflown.swap(overflown_);
    refused = statistics_.refused;
    foreign = statistics_.foreign;
    of_robots = statistics_.of_robots;
    changed = workers_.take_changed();
  }
  std::string invalid;
  for (RolloutSegment& segment : segments) {
    const std::uint64_t failures = book.failures();
    if (book.receive(std::move(segment), now_ns) == Verdict::kInvalid)
      invalid = book.failures() > failures ? book.last_failure() : book.last_refusal();
  }
  if (!invalid.empty()) log().warn("event=segment_invalid last=\"{}\"", invalid);
  for (const auto& [slot, hash] : overflown) book.overflowed(slot, hash);
  if (foreign > foreign_told_) book.foreign(foreign - std::exchange(foreign_told_, foreign));
  if (of_robots > robots_told_) {
    robots_told_ = of_robots;
    log().info("event=segment_of_robot total={} reason=\"never trained on\"", of_robots);
  }
  const std::uint64_t strangers = foreign - of_robots;
  if (strangers > strangers_told_ &&
      (foreign_warned_ns_ == 0 || now_ns - foreign_warned_ns_ > kWarnPeriodNs)) {
    strangers_told_ = strangers;
    foreign_warned_ns_ = now_ns;
    log().warn("event=segment_of_stranger total={} reason=\"not from the process of its worker\"",
               strangers);
  }
  if (refused > refused_told_) book.refused(refused - std::exchange(refused_told_, refused));
  for (const auto& [id, seen] : changed) follow_worker(book, id, seen, now_ns);

  for (auto& [id, served] : served_) {
    if (!served.joined && served.last.lanes > 0 && served.last.phase != WorkerPhase::kStarting &&
        served.last.phase != WorkerPhase::kDraining && served.writer->matched() > 0) {
      served.joined = true;
      book.worker_joined(id, served.last.lanes);
      log().info("event=worker_joined worker={} host={} pid={} lanes={}", id, served.last.host,
                 served.last.pid, served.last.lanes);
    }
  }
  if (now_ns - reported_ns_ >= kReportPeriodNs) {
    serve_late_ones(now_ns);
    follow_silence(book);
    find_unheard(book, steady_now_ns());
  }
  std::erase_if(retired_, [now = steady_now_ns()](const auto& entry) {
    return entry.first->matched() == 0 || now > entry.second;
  });
  if (!superseded()) {
    repeat_for_workers(now_ns);
    if (!paused_) write_grants(book, now_ns);
  }
  report_book(book, now_ns);
}

void LearnerBus::follow_silence(TaskBook& book) {
  const std::lock_guard lock(mutex_);
  for (auto& [id, served] : served_) {
    const ListedWorker* seen = workers_.find(id);
    // One that makes its scene, before it joins, has nothing to say yet.
    const bool silent =
        served.joined && seen != nullptr && steady_now_ns() - seen->at_ns > kSilentNs;
    if (std::exchange(served.silent, silent) == silent) continue;
    book.worker_silent(id, silent);
    log().warn("event=worker_{} worker={}", silent ? "silent" : "speaks_again", id);
  }
}

void LearnerBus::follow_worker(TaskBook& book, std::uint32_t id, const ListedWorker& seen,
                               std::int64_t now_ns) {
  if (seen.status.learner_epoch < options_.learner_epoch)
    epoch_of_workers_ = std::max(epoch_of_workers_, seen.status.learner_epoch);
  const auto found = served_.find(id);
  const bool anew = found != served_.end() && found->second.speaks_as != seen.writer;
  if (found != served_.end() && (!seen.alive || anew)) {
    log().info("event=worker_{} worker={} host={}", seen.crashed || anew ? "lost" : "left", id,
               found->second.last.host);
    book.worker_left(id);
    retire(found);
  }
  if (!seen.alive) return;
  if (found == served_.end() || anew) return serve_worker(id, seen, now_ns);
  Served& served = found->second;
  const WorkerStatus before = std::exchange(served.last, seen.status);
  if (!seen.status.warnings.empty() && seen.status.warnings != before.warnings) {
    log().warn("event=worker_warning worker={} host={} text=\"{}\"", id, seen.status.host,
               seen.status.warnings.back());
  }
  if (!served.joined) return;
  follow_declines(book, id, before, seen.status, now_ns);
  if (served.last.phase == WorkerPhase::kDraining || served.last.lanes != before.lanes) {
    // Leaving, or another width after a new manifest: what it held is granted again.
    book.worker_left(id);
    served.joined = false;
  }
}

/// Makes its task writer. What cannot be made now is tried again (serve_late_ones()).
void LearnerBus::serve_worker(std::uint32_t id, const ListedWorker& seen, std::int64_t now_ns) {
  if (now_ns - writers_from_ns_ >= 1'000 * kMs) {
    writers_from_ns_ = now_ns;
    writers_made_ = 0;
  }
  if (writers_made_ >= kWritersPerS) return;
  ++writers_made_;
  Served served;
  try {
    served.writer = std::make_unique<BusWriter<RolloutTask>>(
        participant_, worker_partition(options_.run, id), fmt::format("learner-tasks-w{}", id));
  } catch (const Error& error) {  // entities have an end, and a certificate too
    log().warn("event=worker_not_served reason=\"{}\" worker={}", error.what(), id);
    return;
  }
  served.last = seen.status;
  served.speaks_as = seen.writer;
  served.since_ns = served.fine_ns = steady_now_ns();
  {
    const std::lock_guard lock(mutex_);
    segments_of_[id] = 0;
  }
  if (known_.size() >= kMostKnown)
    std::erase_if(known_, [this](const auto& entry) { return !served_.contains(entry.first); });
  known_[id] = seen.status;
  served_.insert_or_assign(id, std::move(served));
}

void LearnerBus::serve_late_ones(std::int64_t now_ns) {
  std::vector<std::pair<std::uint32_t, ListedWorker>> late;
  {
    const std::lock_guard lock(mutex_);
    if (workers_.count_alive() <= served_.size()) return;
    for (const WorkerStatus& worker : workers_.alive()) {
      if (late.size() < kWritersPerS && !served_.contains(worker.worker_id))
        late.emplace_back(worker.worker_id, *workers_.find(worker.worker_id));
    }
  }
  for (const auto& [id, seen] : late) serve_worker(id, seen, now_ns);
}

void LearnerBus::retire(std::map<std::uint32_t, Served>::iterator worker) {
  {
    const std::lock_guard lock(mutex_);
    segments_of_.erase(worker->first);
  }
  // Deleting a writer waits for readers that have not acknowledged; a dead one never will.
  retired_.emplace_back(std::move(worker->second.writer), steady_now_ns() + kRetireNs);
  served_.erase(worker);
}

/// Reliable topics can be parted for good by datagrams that anybody can forge (docs/trust.md 2):
/// workers that speak and are granted tasks of which nothing comes, or that fell silent although
/// their process is there, are asked to join anew. Two participants that have just met are not
/// parted.
void LearnerBus::find_unheard(const TaskBook& book, std::int64_t now_ns) {
  std::vector<std::uint32_t> unheard;
  std::map<std::uint32_t, std::uint64_t> received;
  std::map<std::uint32_t, std::int64_t> spoke_ns;
  {
    const std::lock_guard lock(mutex_);
    received = segments_of_;
    for (const auto& [id, served] : served_) {
      const ListedWorker* seen = workers_.find(id);
      spoke_ns[id] = seen != nullptr ? seen->at_ns : now_ns;
    }
  }
  for (auto& [id, served] : served_) {
    const WorkerStatus& last = served.last;
    const bool computes =
        last.tasks_in_progress > 0 && last.segments_published == served.fine_published;
    const std::uint64_t count = received[id];
    // One that makes its scene has nothing to say, and gets nothing.
    const bool unmatched = !served.joined && last.lanes > 0 && served.writer->matched() == 0;
    const bool waits = served.joined && book.grants_of(id) > 0 && !paused_ && !computes;
    if ((!waits && !unmatched) || count != served.fine_received) {
      served.fine_ns = now_ns;
      served.fine_received = count;
      served.fine_published = last.segments_published;
    }
    const bool silent = served.joined && now_ns - spoke_ns[id] > kUnheardNs;
    if ((silent || now_ns - served.fine_ns > kUnheardNs) && unheard.size() < kMostUnheardTold)
      unheard.push_back(id);
  }
  const std::lock_guard lock(mutex_);
  if (!unheard.empty() && unheard != status_.unheard_worker_ids)
    log().warn("event=workers_unheard workers={} they are asked to join anew", unheard.size());
  status_.unheard_worker_ids = std::move(unheard);
}

void LearnerBus::follow_declines(TaskBook& book, std::uint32_t id, const WorkerStatus& before,
                                 const WorkerStatus& after, std::int64_t now_ns) {
  const bool config = after.tasks_declined_config > before.tasks_declined_config;
  const bool state = after.tasks_declined_state > before.tasks_declined_state;
  const bool weights = after.tasks_declined_no_weights > before.tasks_declined_no_weights;
  const bool epoch = after.tasks_declined_epoch > before.tasks_declined_epoch;
  if (!config && !state && !weights && !epoch) return;
  const char* reason = config ? "config" : state ? "state" : weights ? "no_weights" : "epoch";
  const std::string said = after.warnings.empty() ? "" : after.warnings.back();
  book.worker_declined(id, config || state ? fmt::format("declines by {}: {}", reason, said) : "",
                       now_ns);
  weights_wanted_ = weights_wanted_ || weights;
  log().warn("event=worker_declined worker={} host={} reason={} said=\"{}\"", id, after.host,
             reason, said);
}

void LearnerBus::write_grants(TaskBook& book, std::int64_t now_ns) {
  std::uint64_t bytes = 0;
  for (RolloutTask& task : book.grant(now_ns)) {
    if (const auto watched = watched_.find(task.slot); watched != watched_.end())
      task.live_frames_hz = watched->second;
    const auto served = served_.find(task.worker_id);
    const Result<void> ok = served == served_.end() ? Result<void>(Failure{"worker is unknown"})
                                                    : served->second.writer->write(task);
    if (!ok) {
      book.undelivered(task);
      log().warn("event=task_not_written worker={} slot={} reason=\"{}\"", task.worker_id,
                 task.slot, ok.error());
      continue;
    }
    bytes += wire_bytes(task);
    if (options_.profile.task_spacing_ns > 0) {
      // Pacing, not synchronisation: the receiver's socket buffer is smaller than the burst.
      std::this_thread::sleep_for(std::chrono::nanoseconds(options_.profile.task_spacing_ns));
    }
  }
  if (bytes == 0) return;
  const std::lock_guard lock(mutex_);
  statistics_.bytes_down += bytes;
}

void LearnerBus::raise_alarms() {
  std::size_t ring = 0;
  std::uint64_t full = 0;
  {
    const std::lock_guard lock(mutex_);
    ring = std::exchange(ring_peak_, 0);
    full = statistics_.full;
  }
  std::uint64_t lanes = 0;
  for (const auto& [id, served] : served_) lanes += served.joined ? served.last.lanes : 0;
  alarms_.set("ring", 4 * ring >= 3 * ring_capacity_,
              fmt::format("{} of {} places for segments are taken: the learner does not keep up",
                          ring, ring_capacity_));
  alarms_.set("flood", full > 0,
              "the segment reader was full: somebody sends segments without tasks");
  alarms_.set(
      "slots", lanes > options_.slots,
      fmt::format("{} lanes of workers share {} slots: some stand idle; raise rollout.slots "
                  "in a new run or stop workers",
                  lanes, options_.slots));
  profile_alarms_.raise(alarms_, options_.profile, steady_now_ns());
}

std::vector<ControlCommand> LearnerBus::take_commands() {
  std::vector<ControlCommand> commands;
  {
    const std::lock_guard lock(mutex_);
    commands.swap(commands_);
  }
  // Operators repeat a command until they hear of it: it is obeyed once and answered each time.
  std::erase_if(commands, [this](const ControlCommand& command) {
    const auto before = std::find_if(
        replies_.begin(), replies_.end(),
        [&command](const ControlReply& reply) { return reply.request == command.request; });
    if (before == replies_.end()) return false;
    send(*before);
    return true;
  });
  return commands;
}

void LearnerBus::reply(const ControlCommand& command, bool done, const std::string& text) {
  ControlReply reply;
  reply.run_id = options_.run;
  reply.request = command.request;
  reply.program = "learner";
  reply.done = done;
  reply.text = text;
  send(reply);
  replies_.push_back(std::move(reply));
  if (replies_.size() > kRepliesKept) replies_.pop_front();
}

void LearnerBus::send(const ControlReply& reply) {
  if (const Result<void> sent = reply_writer_.write(reply); !sent)
    log().warn("event=reply_not_sent reason=\"{}\"", sent.error());
}

void LearnerBus::watch_slot(std::uint32_t slot, float hz) {
  if (hz > 0) {
    watched_[slot] = hz;
  } else {
    watched_.erase(slot);
  }
}

bool LearnerBus::finish(std::int64_t timeout_ns) {
  std::unique_lock lock(mutex_);
  status_.phase = LearnerPhase::kDone;
  status_urgent_ = true;
  waitset_.wake();
  return something_.wait_for(lock, std::chrono::nanoseconds(timeout_ns),
                             [this] { return statistics_.workers_alive == 0 || superseded(); });
}

BusStatistics LearnerBus::statistics() const {
  const std::lock_guard lock(mutex_);
  return statistics_;
}

std::vector<WorkerStatus> LearnerBus::worker_statuses() const {
  const std::lock_guard lock(mutex_);
  return workers_.alive();
}

std::uint32_t LearnerBus::workers_ready() const {
  std::uint32_t ready = 0;
  for (const auto& [id, served] : served_) ready += served.joined && !served.silent ? 1 : 0;
  return ready;
}

}  // namespace omentum
