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
constexpr std::int64_t kParkNs = 5 * kS;  // docs/wire.md 1: then a task without weights is declined
constexpr std::int64_t kKeepSegmentNs = 30 * kS;  // B5
constexpr std::int64_t kPollNs = 50 * kMs;        // stop flag
constexpr std::int64_t kRetryNs = 10 * kMs;       // delivery
constexpr std::size_t kMaxWarnings = 8;
// Samples that a reader keeps beside those of a stranger who writes to the same instances.
constexpr std::int32_t kWeightsDepth = 64;
constexpr std::int32_t kTaskDepth = 8;

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
      weights_reader_(participant_, run_partition(options_.run), "worker-weights", kWeightsDepth),
      task_reader_(participant_, worker_partition(options_.run, status_.worker_id), "worker-tasks",
                   kTaskDepth),
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
    tell_while_alone(now);
    if (waited_too_long_) break;
    decline_unfit(now);
    flush(now);
    // While segments wait for delivery no new group is begun.
    if (outbox_.empty()) {
      std::vector<TaskQueue::Entry> group = pending_.next_group(
          status_.lanes, [this](const RolloutTask& task) { return check(task) == Check::kReady; },
          now);
      if (!group.empty()) run_group(std::move(group), stop);
    }
    flush(steady_now_ns());
    // Ready only when the learner's segment reader is matched.
    const bool ready = setup_.backend != nullptr && segment_writer_.matched() > 0;
    say(ready ? (running_ + pending_.size() > 0 ? WorkerPhase::kCollecting : WorkerPhase::kIdle)
              : WorkerPhase::kStarting);
    if (steady_now_ns() - status_sent_ns_ >= kStatusPeriodNs) publish_status(steady_now_ns());
  }
  leave();
  return waited_too_long_ ? 1 : 0;
}

const PolicyWeights* BusWorker::weights_of(const RolloutTask& task) const {
  const auto own = weights_.find(learner_);
  if (own == weights_.end()) return nullptr;
  for (const PolicyWeights& weights : own->second) {
    if (weights.learner_epoch == epoch_ && weights.policy_version == task.policy_version &&
        weights.weights_hash == task.weights_hash) {
      return &weights;
    }
  }
  return nullptr;
}

BusWorker::Check BusWorker::check(const RolloutTask& task) const {
  if (!manifest_ || !prepared_) return Check::kWait;
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
    const auto own = weights_.find(learner_);
    if (verdict == Check::kNoWeights && own != weights_.end() &&
        entry.task.policy_version < own->second.front().policy_version) {
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
    // Who computed the segment and when; no part of the result or of its CRC.
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
