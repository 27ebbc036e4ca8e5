#include "sim_worker/bus/bus_worker.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <utility>

#include "core/check.h"
#include "core/clock.h"
#include "core/hash.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kS = 1'000 * kMs;
constexpr std::int64_t kStatusPeriodNs = 500 * kMs;
constexpr std::int64_t kLearnerFreshNs = 3 * kS;  // a learner speaks twice a second
constexpr std::int64_t kParkNs = 5 * kS;  // docs/wire.md 1: then a task without weights is declined
constexpr std::int64_t kKeepSegmentNs = 30 * kS;  // B5
constexpr std::int64_t kPollNs = 50 * kMs;        // stop flag
constexpr std::int64_t kRetryNs = 10 * kMs;       // delivery
constexpr std::size_t kWeightsKept = 2;           // lead 1 has two versions alive
constexpr std::size_t kMaxWarnings = 8;

std::string host_name() {
  std::array<char, 256> name{};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "unknown";
}

BusWorkerOptions checked(BusWorkerOptions options) {
  check_run_name(options.run);
  OMENTUM_CHECK(options.make_setup && options.rollout);
  return options;
}

WorkerStatus first_status(const BusWorkerOptions& options) {
  WorkerStatus status;
  status.worker_id = make_worker_id();
  status.host = host_name();
  status.program_version = options.program_version;
  status.pid = static_cast<std::uint32_t>(getpid());
  status.build_id = options.build_id;
  status.socket_receive_buffer_bytes = options.profile.receive_buffer_bytes;
  return status;
}

}  // namespace

std::uint32_t make_worker_id() {
  // Two workers in one process (tests) differ by the clock.
  const std::string identity = fmt::format("{} {} {}", host_name(), getpid(), wall_now_ns());
  const std::uint64_t hash = fnv1a64(identity);
  return std::max(std::uint32_t{1}, static_cast<std::uint32_t>(hash ^ (hash >> 32)));
}

BusWorker::BusWorker(BusWorkerOptions options)
    : options_(checked(std::move(options))),
      policy_id_(static_cast<std::uint32_t>(fnv1a64(options_.run))),
      status_(first_status(options_)),
      participant_(options_.domain, options_.profile.uri, "omentum-worker"),
      learner_reader_(participant_, run_partition(options_.run), "worker-learner"),
      manifest_reader_(participant_, run_partition(options_.run), "worker-manifest"),
      weights_reader_(participant_, run_partition(options_.run), "worker-weights"),
      task_reader_(participant_, worker_partition(options_.run, status_.worker_id), "worker-tasks"),
      segment_writer_(participant_, public_partitions(options_.run), "worker-segments"),
      status_writer_(participant_, public_partitions(options_.run), "worker-status"),
      waitset_(participant_) {
  waitset_.attach(learner_reader_.raw());
  waitset_.attach(manifest_reader_.raw());
  waitset_.attach(weights_reader_.raw());
  waitset_.attach(task_reader_.raw());
}

int BusWorker::run(const std::function<bool()>& stop) {
  publish_status(steady_now_ns());
  while (!stop() && !done_) {
    std::int64_t now = steady_now_ns();
    std::int64_t timeout = kPollNs;
    if (!outbox_.empty()) timeout = kRetryNs;
    if (const std::int64_t hold = pending_.hold_until_ns(); hold > 0)
      timeout = std::clamp<std::int64_t>(hold - now, 0, timeout);
    waitset_.wait(timeout);
    take_control();
    prepare();
    take_weights();
    take_tasks();
    now = steady_now_ns();
    decline_unfit(now);
    flush(now);
    // Work that cannot be delivered is kept, but no more is made.
    if (outbox_.empty()) {
      std::vector<TaskQueue::Entry> group = pending_.next_group(
          status_.lanes, [this](const RolloutTask& task) { return check(task) == Check::kReady; },
          now);
      if (!group.empty()) run_group(std::move(group), stop);
    }
    flush(steady_now_ns());
    // Listed as ready only when the learner can hear the results.
    const bool ready = setup_.backend != nullptr && segment_writer_.matched() > 0;
    say(ready ? (running_ + pending_.size() > 0 ? WorkerPhase::kCollecting : WorkerPhase::kIdle)
              : WorkerPhase::kStarting);
    if (steady_now_ns() - status_sent_ns_ >= kStatusPeriodNs) publish_status(steady_now_ns());
  }
  leave();
  return 0;
}

// ------------------------------------------------------------------------------------------ intake

void BusWorker::follow(std::uint32_t epoch) {
  if (epoch <= epoch_) return;
  log().info("event=follow_learner run={} epoch={} before={}", options_.run, epoch, epoch_);
  epoch_ = epoch;
  status_.learner_epoch = epoch;
  learner_gone_ = false;
  learner_at_ns_ = 0;
  manifest_.reset();
  weights_.clear();
  status_.warnings.clear();  // they were meant for an older learner
  // Tasks of the older learner; finished segments stay, they may still be wanted.
  status_.tasks_abandoned += pending_.size();
  pending_.clear();
  status_sent_ns_ = 0;
}

void BusWorker::take_control() {
  const Result<int> statuses = learner_reader_.take(64, [this](Arrival<LearnerStatus>&& arrival) {
    const LearnerStatus& learner = arrival.record;
    if (learner.run_id != options_.run || learner.learner_epoch < epoch_) return;
    if (!arrival.info.valid || arrival.info.state != dds::InstanceState::kAlive) {
      if (learner.learner_epoch == epoch_) learner_gone_ = true;
      return;
    }
    follow(learner.learner_epoch);
    learner_at_ns_ = steady_now_ns();
    learner_gone_ = false;
    if (learner.phase == LearnerPhase::kDone) done_ = true;
  });
  if (!statuses) log().error("event=take_failed reason=\"{}\"", statuses.error());
  const Result<int> manifests = manifest_reader_.take(64, [this](Arrival<RunManifest>&& arrival) {
    if (!arrival.info.valid || arrival.record.run_id != options_.run) return;
    follow(arrival.record.learner_epoch);
    if (arrival.record.learner_epoch == epoch_) manifest_ = std::move(arrival.record);
  });
  if (!manifests) log().error("event=take_failed reason=\"{}\"", manifests.error());
}

void BusWorker::prepare() {
  if (!manifest_ || setup_epoch_ == epoch_) return;
  setup_epoch_ = epoch_;
  setup_error_.clear();
  if (options_.build_id != manifest_->build_id) {
    setup_error_ = fmt::format("build {:016x} differs from the learner's {:016x}",
                               options_.build_id, manifest_->build_id);
  } else if (!setup_.backend || setup_.config_hash != manifest_->config_hash) {
    try {
      setup_ = options_.make_setup(*manifest_);
      OMENTUM_CHECK(setup_.backend != nullptr);
      policy_.reset();
    } catch (const Error& error) {
      setup_ = {};
      setup_error_ = error.what();
    }
  }
  if (setup_error_.empty() && setup_.config_hash != manifest_->config_hash) {
    setup_error_ = fmt::format("config_hash {:016x} differs from the learner's {:016x}",
                               setup_.config_hash, manifest_->config_hash);
  }
  if (setup_error_.empty() && setup_.shape.layout_hash() != manifest_->layout_hash) {
    setup_error_ = fmt::format("layout_hash {:016x} differs from the learner's {:016x}",
                               setup_.shape.layout_hash(), manifest_->layout_hash);
  }
  status_.lanes = setup_.backend ? static_cast<std::uint32_t>(setup_.backend->lanes()) : 0;
  if (!setup_error_.empty()) warn(setup_error_);
  status_sent_ns_ = 0;
}

void BusWorker::take_weights() {
  const Result<int> taken = weights_reader_.take(64, [this](Arrival<PolicyWeights>&& arrival) {
    PolicyWeights& weights = arrival.record;
    if (!arrival.info.valid || weights.policy_id != policy_id_) return;
    follow(weights.learner_epoch);
    if (weights.learner_epoch != epoch_) return;
    if (hash_weights(weights.parameters, weights.obs_mean, weights.obs_inv_std) !=
        weights.weights_hash) {
      warn(fmt::format("weights {} do not match their hash", weights.policy_version));
      return;
    }
    status_.policy_version = weights.policy_version;
    weights_.push_back(std::move(weights));
    if (weights_.size() > kWeightsKept) weights_.pop_front();
  });
  if (!taken) log().error("event=take_failed reason=\"{}\"", taken.error());
}

void BusWorker::take_tasks() {
  const Result<int> taken = task_reader_.take(4096, [this](Arrival<RolloutTask>&& arrival) {
    if (!arrival.info.valid) return;
    accept(std::move(arrival.record));
  });
  if (!taken) log().error("event=take_failed reason=\"{}\"", taken.error());
}

void BusWorker::accept(RolloutTask task) {
  ++status_.tasks_received;
  follow(task.learner_epoch);
  if (task.learner_epoch < epoch_ || task.worker_id != status_.worker_id) {
    ++status_.tasks_declined_epoch;
    status_sent_ns_ = 0;
    return;
  }
  if (pending_.push(std::move(task), steady_now_ns())) ++status_.tasks_abandoned;
}

const PolicyWeights* BusWorker::weights_of(const RolloutTask& task) const {
  for (const PolicyWeights& weights : weights_) {
    if (weights.policy_version == task.policy_version &&
        weights.weights_hash == task.weights_hash) {
      return &weights;
    }
  }
  return nullptr;
}

BusWorker::Check BusWorker::check(const RolloutTask& task) const {
  // The manifest of a new learner may be behind its first tasks.
  if (!manifest_ || setup_epoch_ != epoch_) return Check::kWait;
  if (!setup_error_.empty() || task.config_hash != setup_.config_hash) return Check::kConfig;
  const Snapshots* states = setup_.backend->snapshots();
  if (task.state_format != (states != nullptr ? states->state_format() : 0)) return Check::kState;
  const PolicyWeights* weights = weights_of(task);
  if (weights == nullptr) return Check::kNoWeights;
  if (weights->layout_hash != setup_.shape.layout_hash() ||
      weights->parameters.size() != setup_.shape.parameter_count()) {
    return Check::kConfig;
  }
  return Check::kReady;
}

void BusWorker::decline(const RolloutTask& task, Check reason) {
  std::string text;
  if (reason == Check::kNoWeights) {
    ++status_.tasks_declined_no_weights;
    text = fmt::format("no weights {} for slot {}", task.policy_version, task.slot);
  } else if (reason == Check::kState) {
    ++status_.tasks_declined_state;
    text = fmt::format("state of slot {}: format {} or hash does not fit", task.slot,
                       task.state_format);
  } else {
    ++status_.tasks_declined_config;
    text = setup_error_.empty() ? fmt::format("configuration of slot {} does not fit", task.slot)
                                : setup_error_;
  }
  warn(text);
  status_sent_ns_ = 0;
}

void BusWorker::decline_unfit(std::int64_t now_ns) {
  pending_.erase_if([this, now_ns](const TaskQueue::Entry& entry) {
    const Check verdict = check(entry.task);
    const bool late = now_ns - entry.at_ns > kParkNs;
    const bool parked = verdict == Check::kWait || verdict == Check::kNoWeights;
    if (verdict == Check::kReady || (parked && !late)) return false;
    if (verdict == Check::kNoWeights && !weights_.empty() &&
        entry.task.policy_version < weights_.front().policy_version) {
      ++status_.tasks_abandoned;  // a second grant of a batch that is over: nobody waits for it
    } else {
      decline(entry.task, verdict);
    }
    return true;
  });
}

// -----------------------------------------------------------------------------------------
// rollouts

Policy& BusWorker::policy_of(const RolloutTask& task) {
  const PolicyWeights* weights = weights_of(task);
  OMENTUM_CHECK(weights != nullptr);
  if (!policy_ || policy_->weights().policy_version != weights->policy_version ||
      policy_->weights().weights_hash != weights->weights_hash) {
    policy_ = std::make_unique<Policy>(setup_.shape, *weights);
  }
  return *policy_;
}

void BusWorker::run_group(std::vector<TaskQueue::Entry> group, const std::function<bool()>& stop) {
  const std::int64_t begin = steady_now_ns();
  std::vector<RolloutTask> tasks;
  std::vector<std::int64_t> arrived;
  for (TaskQueue::Entry& pending : group) {
    RolloutTask& task = pending.task;
    if (!task.reset && hash_state(task.start_state) != task.start_hash) {
      decline(task, Check::kState);
      continue;
    }
    arrived.push_back(pending.at_ns);
    tasks.push_back(std::move(task));
  }
  if (tasks.empty()) return;
  running_ = static_cast<std::uint32_t>(tasks.size());
  say(WorkerPhase::kCollecting);
  std::vector<RolloutSegment> segments =
      options_.rollout(*setup_.backend, policy_of(tasks.front()), tasks, [this, &stop] {
        const std::int64_t now = steady_now_ns();
        if (now - status_sent_ns_ >= kStatusPeriodNs) {
          take_control();
          publish_status(now);
        }
        return stop() || done_;
      });
  running_ = 0;
  const std::int64_t end = steady_now_ns();
  busy_ns_ += end - begin;
  pending_.group_ran(begin, end);
  if (segments.empty()) {  // stopped
    status_.tasks_abandoned += tasks.size();
    return;
  }
  OMENTUM_CHECK(segments.size() == tasks.size());
  for (std::size_t i = 0; i < segments.size(); ++i) {
    RolloutSegment& segment = segments[i];
    const RolloutTask& task = tasks[i];
    // Identity of this answer; none of it is part of the result or of its CRC.
    segment.grant = task.grant;
    segment.worker_id = status_.worker_id;
    segment.build_id = options_.build_id;
    segment.learner_epoch = task.learner_epoch;
    segment.granted_at_ns = task.granted_at_ns;
    segment.wait_time_ns = begin - arrived[i];
    if (segment.compute_time_ns == 0) segment.compute_time_ns = end - begin;
    status_.steps += segment.steps;
    outbox_.push_back({std::move(segment), end});
  }
}

// -----------------------------------------------------------------------------------------
// delivery

bool BusWorker::deliverable(std::int64_t now) const {
  return segment_writer_.matched() > 0 && !learner_gone_ && learner_at_ns_ > 0 &&
         now - learner_at_ns_ < kLearnerFreshNs;
}

void BusWorker::flush(std::int64_t now) {
  while (!outbox_.empty()) {
    if (!deliverable(now)) {
      // A volatile writer without readers drops silently: keep the segment until a learner is back.
      if (now - outbox_.front().at_ns <= kKeepSegmentNs) return;
      ++status_.tasks_abandoned;
      outbox_.pop_front();
      continue;
    }
    const Result<void> ok = segment_writer_.write(outbox_.front().segment);
    if (!ok && segment_writer_.timed_out()) {
      ++status_.write_timeouts;  // nothing was stored: the same segment again, after a look at stop
      return;
    }
    if (ok) {
      ++status_.segments_published;
    } else {
      ++status_.tasks_abandoned;
      warn(ok.error());
    }
    outbox_.pop_front();
  }
}

// -------------------------------------------------------------------------------------------
// status

void BusWorker::say(WorkerPhase phase) {
  if (status_.phase == phase) return;
  const bool matters = status_.phase == WorkerPhase::kStarting || phase == WorkerPhase::kStarting ||
                       phase == WorkerPhase::kDraining;
  status_.phase = phase;
  if (matters) publish_status(steady_now_ns());  // idle <-> collecting goes out with the next beat
}

void BusWorker::publish_status(std::int64_t now) {
  const double seconds = static_cast<double>(now - status_sent_ns_) * 1e-9;
  if (status_sent_ns_ > 0 && seconds > 0.1) {
    status_.steps_per_s = static_cast<double>(status_.steps - steps_sent_) / seconds;
    status_.sim_time_fraction = std::min(1.0, static_cast<double>(busy_ns_) * 1e-9 / seconds);
    steps_sent_ = status_.steps;
    busy_ns_ = 0;
  }
  status_.tasks_in_progress = pending_.size() + running_ + outbox_.size();
  const dds::WriterCounters counters = segment_writer_.counters();
  status_.rexmit_bytes = counters.rexmit_bytes;
  status_.throttle_count = counters.throttle_count;
  status_.time_throttle_ns = counters.time_throttle_ns;
  status_sent_ns_ = now;
  const Result<void> ok = status_writer_.write(status_);
  if (!ok) log().warn("event=status_not_sent reason=\"{}\"", ok.error());
}

void BusWorker::warn(const std::string& text) {
  if (!status_.warnings.empty() && status_.warnings.back() == text) return;
  log().warn("event=worker_warning text=\"{}\"", text);
  status_.warnings.push_back(text);
  if (status_.warnings.size() > kMaxWarnings) status_.warnings.erase(status_.warnings.begin());
}

void BusWorker::leave() {
  status_.tasks_abandoned += pending_.size();
  pending_.clear();
  flush(steady_now_ns());
  status_.tasks_abandoned += outbox_.size();
  outbox_.clear();
  say(WorkerPhase::kDraining);
  segment_writer_.wait_for_acknowledgments(kS);
  const Result<void> ok = status_writer_.dispose(status_);
  if (!ok) log().warn("event=status_not_disposed reason=\"{}\"", ok.error());
  status_writer_.wait_for_acknowledgments(kS);
  log().info("event=worker_leaves run={} segments={} abandoned={}", options_.run,
             status_.segments_published, status_.tasks_abandoned);
}

}  // namespace omentum
