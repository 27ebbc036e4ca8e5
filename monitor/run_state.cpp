#include "monitor/run_state.h"

#include <fmt/core.h>

#include <algorithm>
#include <array>

namespace omentum {
namespace {

constexpr std::size_t kMaxRows = 1024;    // as many workers as a learner lists
constexpr std::size_t kMaxPoints = 1000;  // of a curve: more than a page has pixels

std::int64_t signed_of(std::uint64_t value) { return static_cast<std::int64_t>(value); }

template <std::size_t N, typename E>
const char* name_in(const std::array<const char*, N>& names, E value) {
  const auto index = static_cast<std::size_t>(value);
  return index < N ? names[index] : "unknown";
}

/// What a worker or a robot says of itself; its end comes by itself or with its last word.
template <typename Row, typename Status>
void hear(std::map<std::uint32_t, Row>& rows, std::uint32_t id, Arrival<Status>&& arrival,
          std::int64_t now_ns) {
  if (arrival.info.valid) {
    if (rows.size() >= kMaxRows && !rows.contains(id)) {
      rows.erase(std::ranges::min_element(
          rows, {}, [](const auto& entry) { return entry.second.heard_at_ns; }));
    }
    rows[id] = {std::move(arrival.record), now_ns, false};
  }
  if (arrival.info.state == dds::InstanceState::kDisposed) {
    rows.erase(id);
  } else if (const auto found = rows.find(id);
             arrival.info.state == dds::InstanceState::kNoWriters && found != rows.end()) {
    found->second.lost = true;
  }
}

}  // namespace

void RunState::apply(Arrival<LearnerStatus>&& arrival, std::int64_t now_ns) {
  const std::uint32_t epoch = arrival.record.learner_epoch;
  if (learner_ && epoch < learner_->learner_epoch) return;  // of an older session
  if (arrival.info.valid) {
    const bool new_session = !learner_ || epoch != learner_->learner_epoch;
    const bool new_update =
        new_session || arrival.record.policy_version != learner_->policy_version;
    learner_ = std::move(arrival.record);
    learner_heard_at_ns_ = now_ns;
    learner_lost_ = false;
    // A session that was resumed has no figures before its first update, nor a rate.
    if (new_update && learner_->policy_version > 0 && learner_->steps_per_s > 0) add_to_curve();
  }
  if (arrival.info.state != dds::InstanceState::kAlive && learner_ &&
      epoch == learner_->learner_epoch)
    learner_lost_ = true;
}

void RunState::add_to_curve() {
  // A resumed run goes back to its checkpoint.
  while (!curve_.empty() && curve_.back().steps >= learner_->steps_total) curve_.pop_back();
  if (updates_seen_++ % curve_stride_ != 0) return;
  curve_.push_back({learner_->steps_total, learner_->mean_return, learner_->mean_length,
                    learner_->approx_kl, learner_->entropy, learner_->explained_variance,
                    learner_->steps_per_s});
  if (curve_.size() < kMaxPoints) return;
  for (std::size_t k = 0; 2 * k < curve_.size(); ++k) curve_[k] = curve_[2 * k];
  curve_.resize((curve_.size() + 1) / 2);
  curve_stride_ *= 2;
}

void RunState::apply(Arrival<WorkerStatus>&& arrival, std::int64_t now_ns) {
  const std::uint32_t id = arrival.record.worker_id;
  hear(workers_, id, std::move(arrival), now_ns);
}

void RunState::apply(Arrival<RunManifest>&& arrival, std::int64_t /*now_ns*/) {
  if (!arrival.info.valid) return;
  if (manifest_ && arrival.record.learner_epoch < manifest_->learner_epoch) return;
  manifest_ = std::move(arrival.record);
}

void RunState::apply(Arrival<EpisodeSummary>&& arrival, std::int64_t /*now_ns*/) {
  if (!arrival.info.valid) return;
  ++episodes_;
  if (arrival.record.outcome == Outcome::kTargetReached) ++targets_reached_;
}

void RunState::apply(Arrival<RobotStatus>&& arrival, std::int64_t now_ns) {
  const std::uint32_t id = arrival.record.gateway_id;
  hear(robots_, id, std::move(arrival), now_ns);
}

Presence RunState::learner_presence(std::int64_t now_ns) const {
  if (!learner_ || learner_lost_) return Presence::kLost;
  return now_ns - learner_heard_at_ns_ > kSilentNs ? Presence::kSilent : Presence::kAlive;
}

Presence RunState::presence_of(const WorkerRow& row, std::int64_t now_ns) {
  if (row.lost) return Presence::kLost;
  return now_ns - row.heard_at_ns > kSilentNs ? Presence::kSilent : Presence::kAlive;
}

Presence RunState::presence_of(const RobotRow& row, std::int64_t now_ns) {
  if (row.lost) return Presence::kLost;
  return now_ns - row.heard_at_ns > kSilentNs ? Presence::kSilent : Presence::kAlive;
}

LedgerBalance balance_of(const Ledger& l) {
  // Unsigned as far as the difference: what a stranger sends may be anything.
  return {signed_of(l.received -
                    (l.admitted + l.duplicate + l.stale + l.invalid + l.foreign + l.overflow)),
          signed_of(l.granted - (l.admitted + l.outstanding + l.cancelled + l.regranted))};
}

std::uint64_t version_lag(const RunState& state, const WorkerStatus& worker) {
  if (!state.learner() || worker.learner_epoch != state.learner()->learner_epoch) return 0;
  const std::uint64_t newest = state.learner()->policy_version;
  return newest > worker.policy_version ? newest - worker.policy_version : 0;
}

double share_done(const LearnerStatus& learner) {
  if (learner.steps_wanted == 0) return 0;
  return std::min(
      1.0, static_cast<double>(learner.steps_total) / static_cast<double>(learner.steps_wanted));
}

std::optional<double> seconds_left(const LearnerStatus& learner) {
  if (!(learner.steps_per_s > 0) || learner.steps_wanted == 0) return std::nullopt;
  if (learner.steps_total >= learner.steps_wanted) return 0.0;
  return static_cast<double>(learner.steps_wanted - learner.steps_total) / learner.steps_per_s;
}

namespace {

void add_training_alarms(std::vector<std::string>& alarms, const RunState& state,
                         std::int64_t now_ns) {
  const Presence presence = state.learner_presence(now_ns);
  if (presence == Presence::kLost && state.learner()->phase != LearnerPhase::kDone)
    alarms.emplace_back("learner: lost (crashed or unreachable)");
  if (presence == Presence::kSilent) alarms.emplace_back("learner: silent (hung or stopped)");
  if (!balance_of(*state.learner()).balanced())
    alarms.emplace_back("ledger: does not balance (docs/wire.md 4.3)");
  for (const std::string& alarm : state.learner()->alarms) alarms.push_back("learner: " + alarm);
  for (std::size_t k = 0; k < state.learner()->barred_worker_ids.size(); ++k) {
    alarms.push_back(fmt::format("worker {}: gets no task: {}",
                                 state.learner()->barred_worker_ids[k],
                                 state.learner()->barred_reasons[k]));
  }
  for (const auto& [id, row] : state.workers()) {
    const Presence worker = RunState::presence_of(row, now_ns);
    if (worker != Presence::kAlive)
      alarms.push_back(fmt::format("worker {} on {}: {}", id, row.status.host, name_of(worker)));
    for (const std::string& alarm : row.status.alarms)
      alarms.push_back(fmt::format("worker {} on {}: {}", id, row.status.host, alarm));
  }
}

void add_robot_alarms(std::vector<std::string>& alarms, const RunState& state,
                      std::int64_t now_ns) {
  for (const auto& [id, row] : state.robots()) {
    const std::string who = fmt::format("robot {} of {}", row.status.robot, row.status.host);
    const Presence robot = RunState::presence_of(row, now_ns);
    if (robot != Presence::kAlive) {
      alarms.push_back(fmt::format("{}: {}", who, name_of(robot)));
    } else if (row.status.phase == RobotPhase::kStopped) {
      alarms.push_back(fmt::format("{}: stopped: {}", who, row.status.reason_text));
    }
  }
}

}  // namespace

std::vector<std::string> alarms_of(const RunState& state, std::int64_t now_ns) {
  std::vector<std::string> alarms;
  if (state.learner()) {
    add_training_alarms(alarms, state, now_ns);
  } else if (state.robots().empty()) {  // a robot runs a policy of a file without a learner
    alarms.emplace_back("no learner of this run has spoken yet");
  }
  add_robot_alarms(alarms, state, now_ns);
  return alarms;
}

const char* name_of(LearnerPhase phase) {
  constexpr std::array<const char*, 6> kNames{"waiting",    "updating", "saving",
                                              "evaluating", "paused",   "done"};
  return name_in(kNames, phase);
}

const char* name_of(WorkerPhase phase) {
  constexpr std::array<const char*, 4> kNames{"starting", "idle", "collecting", "draining"};
  return name_in(kNames, phase);
}

const char* name_of(RobotPhase phase) {
  constexpr std::array<const char*, 5> kNames{"listening", "waiting", "ready", "active", "stopped"};
  return name_in(kNames, phase);
}

const char* name_of(Presence presence) {
  constexpr std::array<const char*, 3> kNames{"alive", "silent", "lost"};
  return name_in(kNames, presence);
}

}  // namespace omentum
