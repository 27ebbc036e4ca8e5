#include "sim_worker/bus/bus_worker.h"

#include <algorithm>
#include <utility>

#include "core/check.h"
#include "core/clock.h"
#include "core/log.h"
#include "core/scheduling.h"

namespace omentum {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kS = 1'000 * kMs;
constexpr std::int64_t kParkNs = 5 * kS;  // docs/wire.md 1: then a task without weights is declined
// So long a segment waits for a reader and a learner that speaks, then it is dropped and counted
// (docs/wire.md 5.2).
constexpr std::int64_t kKeepSegmentNs = 30 * kS;
constexpr std::int64_t kPollNs = 50 * kMs;   // stop flag
constexpr std::int64_t kRetryNs = 10 * kMs;  // delivery

BusWorkerOptions checked(BusWorkerOptions options) {
  check_run_name(options.run);
  OMENTUM_CHECK(options.make_setup && options.rollout);
  return options;
}

}  // namespace

BusWorker::BusWorker(BusWorkerOptions options)
    : options_(checked(std::move(options))),
      status_(first_worker_status(options_)),
      heartbeat_(options_.heartbeat),
      deaf_(status_.worker_id),
      simulations_(status_.worker_id, options_.build_id, options_.simulate) {
  join(options_.profile);
}

void BusWorker::join(const DdsProfile& profile) {
  simulations_.forget_writers();
  bus_.reset();  // the domain has one configuration per process
  options_.profile = profile;
  bus_ = std::make_unique<WorkerBus>(
      WorkerBusOptions{options_.run, options_.domain, profile, status_.worker_id, {}});
  listed_ns_ = matched_ns_ = steady_now_ns();
  deaf_.joined(listed_ns_);
  weights_missed_ns_ = 0;
  unheard_ = false;
}

int BusWorker::run(const std::function<bool()>& stop) {
  yield_to_bus();  // after join(): its threads do not
  publish_status(steady_now_ns());
  while (!stop() && !done_ && !drained_) {
    std::int64_t now = steady_now_ns();
    std::int64_t timeout = kPollNs;
    if (!outbox_.empty() || simulations_.has_answers()) timeout = kRetryNs;
    if (simulations_.can_begin()) timeout = 0;
    if (const std::int64_t hold = pending_.hold_until_ns(); hold > 0)
      timeout = std::clamp<std::int64_t>(hold - now, 0, timeout);
    bus_->wait(timeout);
    deaf_.watch(steady_now_ns(), steady_now_ns() - now - timeout, [this] {
      const dds::Discovery::Count count = bus_->discovered();
      return Deafness::Around{count.found, count.known, waited_for_core_ns()};
    });
    take_arrivals();
    prepare();
    now = steady_now_ns();
    tell_while_alone(now);
    rejoin_if_needed(now);
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
    serve_simulations(stop);
    // Ready only when both ways to the learner are there: a task that is written before its reader
    // has found its writer is lost, and is the credit of a lane.
    const bool ready =
        setup_.backend != nullptr && bus_->segments().matched() > 0 && bus_->hears_tasks();
    if (ready || setup_.backend == nullptr) matched_ns_ = now;
    const WorkerPhase phase =
        ready ? (running_ + pending_.size() > 0 ? WorkerPhase::kCollecting : WorkerPhase::kIdle)
              : WorkerPhase::kStarting;
    say(simulations_.in_progress() > 0 ? WorkerPhase::kCollecting : phase);
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
    if (weights_missed_ns_ == 0) weights_missed_ns_ = steady_now_ns();
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
      options_.rollout(*setup_.backend, policy_of(tasks.front()), tasks, [this, &stop, &tasks] {
        const std::int64_t now = steady_now_ns();
        if (bus_->has_arrivals()) take_arrivals();
        if (now - status_sent_ns_ >= kStatusPeriodNs) publish_status(now);
        publish_frames(tasks, now);
        return stop() || done_ || drained_;
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
// simulations

bool BusWorker::learner_speaks(std::int64_t now) const {
  return !learner_gone_ && learner_at_ns_ > 0 && now - learner_at_ns_ < kLearnerFreshNs;
}

/// A learner goes first: nothing is simulated while one speaks, and what runs is given back.
void BusWorker::serve_simulations(const std::function<bool()>& stop) {
  const auto give_back = [this](std::int64_t now) {
    if (learner_speaks(now))
      simulations_.decline_all("it works for the learner of this run", *bus_);
  };
  const std::int64_t begin = steady_now_ns();
  give_back(begin);
  simulations_.flush(*bus_, begin);
  if (simulations_.can_begin()) {
    say(WorkerPhase::kCollecting);
    simulations_.run_next([this, &stop] {
      const std::int64_t now = steady_now_ns();
      if (bus_->has_arrivals()) take_arrivals();
      count_simulations();
      if (now - status_sent_ns_ >= kStatusPeriodNs) publish_status(now);
      return stop() || done_ || drained_ || learner_speaks(now);
    });
    const std::int64_t end = steady_now_ns();
    busy_ns_ += end - begin;
    give_back(end);
    simulations_.flush(*bus_, end);
  }
  count_simulations();
}

void BusWorker::count_simulations() {
  const SimulationServer::Counts counts = simulations_.take_counts();
  status_.tasks_received += counts.received;
  status_.segments_published += counts.published;
  status_.tasks_abandoned += counts.abandoned;
  status_.write_timeouts += counts.timeouts;
  status_.steps += counts.steps;
}

// -----------------------------------------------------------------------------------------
// delivery

bool BusWorker::deliverable(std::int64_t now) const {
  return !bus_->expired() && bus_->segments().matched() > 0 && learner_speaks(now);
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
    const Result<void> ok = bus_->segments().write(outbox_.front().segment);
    if (!ok && bus_->segments().timed_out()) {
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

}  // namespace omentum
