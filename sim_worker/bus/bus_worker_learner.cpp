// Which learner a worker follows, its configuration, and its weights.
#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

#include "core/check.h"
#include "core/clock.h"
#include "core/log.h"
#include "sim_worker/bus/bus_worker.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;
constexpr std::size_t kWeightsKept = 2;    // lead 1 has two versions alive
constexpr std::size_t kMaxSources = 8;     // of weights, before strangers' go
constexpr std::int64_t kJoinNs = 2 * kS;   // a learner that was started together joins within it
constexpr std::int64_t kTellNs = 60 * kS;  // what waits is told of this often
constexpr std::size_t kMaxEarly = 4096;
constexpr std::int64_t kTellEpochNs = kS / 2;
constexpr std::int64_t kAskNs = 1 * kS;  // for the address of a learner that is not heard
// A configuration that does not fit is tried again after this long, then twice it ...: a file that
// was missing may be there.
constexpr std::int64_t kFirstRetryNs = 10 * kS;
constexpr std::int64_t kMostRetryNs = 320 * kS;
constexpr std::int64_t kWeightsLateNs = 4 * kS;  // the learner sends them again every 2 s
constexpr std::int64_t kDeafAskedNs = 20 * kS;   // while it simulates for others
constexpr int kJoinTries = 60;
constexpr auto kJoinAgain = std::chrono::milliseconds(500);

bool names(const std::vector<std::uint32_t>& ids, std::uint32_t id) {
  return std::ranges::find(ids, id) != ids.end();
}

}  // namespace

void BusWorker::follow(const LearnerChoice::Learner& learner) {
  const RunManifest& manifest = learner.manifest;
  const bool same = learner.participant == learner_ && manifest_ &&
                    manifest_->learner_epoch == manifest.learner_epoch &&
                    manifest_->config_hash == manifest.config_hash;
  if (same) return;
  log().info("event=follow_learner run={} epoch={} before={}", options_.run, manifest.learner_epoch,
             epoch_);
  learner_ = learner.participant;
  epoch_ = manifest.learner_epoch;
  manifest_ = manifest;
  prepared_ = false;
  retry_span_ns_ = 0;
  // The status names the epoch before for a moment: a learner whose folder does not know of it must
  // see it (docs/wire.md 4.2), and may not have found our writer yet.
  epoch_told_from_ns_ = status_.learner_epoch == 0 ? 0 : steady_now_ns() + kTellEpochNs;
  learner_gone_ = false;
  listed_ns_ = steady_now_ns();
  unheard_ = false;
  status_.warnings.clear();  // they were meant for another learner
  // Tasks of the other learner go; its finished segments stay, this one may admit them.
  status_.tasks_abandoned += pending_.size();
  pending_.clear();
  status_sent_ns_ = 0;
  for (auto& [participant, task] : std::exchange(early_, {})) accept(participant, std::move(task));
}

void BusWorker::take_arrivals() {
  WorkerInbox inbox = bus_->take();
  for (Arrival<RunManifest>& arrival : inbox.manifests) {
    if (arrival.info.valid) choice_.offered(arrival.info.participant, std::move(arrival.record));
  }
  take_learners(inbox.learners);
  take_weights(std::move(inbox.weights));
  for (Arrival<RolloutTask>& arrival : inbox.tasks)
    accept(arrival.info.participant, std::move(arrival.record));
  take_commands(inbox.commands);
  for (Arrival<SimulationGrant>& arrival : inbox.simulations)
    simulations_.take(std::move(arrival), *bus_, steady_now_ns());
  count_wrong(inbox.wrong_weights, inbox.dropped);
}

void BusWorker::take_learners(const std::vector<Arrival<LearnerStatus>>& learners) {
  for (const auto& [learner, info] : learners) {
    if (!info.valid || info.state != dds::InstanceState::kAlive) {
      if (learner.learner_epoch == epoch_) learner_gone_ = true;
      continue;
    }
    choice_.spoke(info.participant, learner.learner_epoch, steady_now_ns());
    if (learner.learner_epoch != epoch_ || info.participant != learner_) continue;
    learner_at_ns_ = steady_now_ns();
    deaf_.heard(learner_at_ns_);
    learner_gone_ = false;
    if (names(learner.worker_ids, status_.worker_id)) listed_ns_ = learner_at_ns_;
    unheard_ = names(learner.unheard_worker_ids, status_.worker_id);
    if (learner.phase == LearnerPhase::kDone) done_ = true;
    tell_if_barred(learner);
  }
  if (const LearnerChoice::Learner* learner = choice_.choose(steady_now_ns())) {
    learner_at_ns_ = learner->spoke_ns;
    follow(*learner);
  }
}

void BusWorker::take_commands(const std::vector<Arrival<ControlCommand>>& commands) {
  for (const auto& [command, info] : commands) {
    if (command.action != ControlAction::kDrain || command.worker_id != status_.worker_id) continue;
    log().info("event=drained issuer={} request={}", command.issuer, command.request);
    drained_ = true;
    ControlReply reply;
    reply.run_id = options_.run;
    reply.request = command.request;
    reply.program = "sim_worker";
    reply.worker_id = status_.worker_id;
    reply.done = true;
    reply.text = fmt::format("worker {} hands its work back and leaves", status_.worker_id);
    if (const Result<void> sent = bus_->replies().write(reply); !sent) warn(sent.error());
  }
}

/// Why this worker, or the learner, seems to be deaf; empty while neither does.
std::string BusWorker::deafness(std::int64_t now_ns) {
  const bool alone = learner_gone_ || now_ns - learner_at_ns_ > kLearnerFreshNs;
  if (alone) listed_ns_ = matched_ns_ = now_ns;
  if (!deaf_.may_join_anew(now_ns)) return {};
  if (alone) {
    const bool simulates =
        simulations_.in_progress() > 0 || (asked_ns_ > 0 && now_ns - asked_ns_ < kTellNs);
    // Who asks for simulations, which anybody may, must not keep it deaf.
    if (simulates && now_ns - deaf_.joined_ns() < kDeafAskedNs) return {};
    if (!deaf_.is_too_long(deaf_.heard_ns(), now_ns) || !bus_->sees_a_learner()) return {};
    return "a learner is there and is not heard";
  }
  if (unheard_) return "the learner does not hear this worker, or is not heard";
  if (deaf_.is_too_long(listed_ns_, now_ns)) return "the learner does not know this worker";
  if (deaf_.is_too_long(matched_ns_, now_ns))
    return "the learner's reader of segments or writer of tasks is not found";
  if (weights_missed_ns_ > 0 && now_ns - weights_missed_ns_ > kWeightsLateNs)
    return "weights do not arrive";
  return {};
}

/// A participant is made anew where this one is deaf, where the learner's name means another
/// address by now, and after the end of the certificate: then throws Error unless it was renewed.
void BusWorker::rejoin_if_needed(std::int64_t now_ns) {
  const bool expired = bus_->expired();
  const std::string deaf = expired ? "" : deafness(now_ns);
  const bool alone = learner_gone_ || now_ns - learner_at_ns_ > kLearnerFreshNs;
  if (deaf.empty()) {
    if ((!alone && !expired) || !options_.find_profile || now_ns - profile_asked_ns_ < kAskNs)
      return;
  }
  profile_asked_ns_ = now_ns;
  Result<DdsProfile> profile = options_.profile;
  if (options_.find_profile) profile = options_.find_profile();
  if (!profile) return;
  if (!deaf.empty()) {
    deaf_.gives_up();
    return rejoin(profile.value(), deaf, now_ns);
  }
  if (profile.value().uri == bus_->uri() && !expired) return;
  rejoin(profile.value(),
         expired ? "the certificate was renewed" : "the learner's host has another address",
         now_ns);
}

void BusWorker::rejoin(const DdsProfile& profile, const std::string& reason, std::int64_t now_ns) {
  log().info("event=rejoin reason=\"{}\"", reason);
  const bool expired = bus_->expired();
  for (int tries = 1;; ++tries) {
    try {
      join(profile);
      break;
    } catch (const Error& error) {
      // What was free a moment ago will be again; a certificate that has ended will not be valid.
      if (tries >= kJoinTries || expired) throw;
      log().warn("event=rejoin_failed reason=\"{}\"", error.what());
      std::this_thread::sleep_for(kJoinAgain);
    }
  }
  // Identities of participants are of the participant that saw them.
  choice_ = {};
  learner_ = 0;
  weights_.clear();
  early_.clear();
  publish_status(now_ns);
}

void BusWorker::tell_if_barred(const LearnerStatus& learner) {
  std::string reason;
  for (std::size_t i = 0; i < learner.barred_worker_ids.size(); ++i) {
    if (learner.barred_worker_ids[i] == status_.worker_id) reason = learner.barred_reasons[i];
  }
  if (reason == barred_for_) return;
  barred_for_ = reason;
  if (reason.empty()) {
    log().info("event=not_barred_any_more");
  } else {
    log().warn("event=barred reason=\"{}\" the learner gives no tasks for a while", reason);
  }
}

/// Without a learner the worker says at once and every minute what to start.
void BusWorker::tell_while_alone(std::int64_t now_ns) {
  const bool served =
      manifest_ && setup_error_.empty() && now_ns - learner_at_ns_ < kLearnerFreshNs;
  if (simulations_.in_progress() > 0) asked_ns_ = now_ns;
  const bool simulates = asked_ns_ > 0 && now_ns - asked_ns_ < kTellNs;
  if (served || simulates) {
    alone_since_ns_ = 0;
    return;
  }
  if (alone_since_ns_ == 0) alone_since_ns_ = now_ns;
  waited_too_long_ = options_.max_wait_ns > 0 && now_ns - alone_since_ns_ > options_.max_wait_ns;
  if (waited_too_long_) log().error("no learner to work for in the time of --max-wait");
  if (now_ns - alone_since_ns_ < kJoinNs) return;
  if (alone_told_ns_ > alone_since_ns_ && now_ns - alone_told_ns_ < kTellNs) return;
  alone_told_ns_ = now_ns;
  log().warn("waiting for a learner: start learner --run {} --set run.domain={}{}{}", options_.run,
             options_.domain,
             setup_error_.empty() ? "" : "; the present one does not fit: ", setup_error_);
}

/// Counts what came from somebody who is not the learner; told once and then every minute.
void BusWorker::count_stranger(const char* what) {
  ++strangers_;
  const std::int64_t now = steady_now_ns();
  if (stranger_told_ns_ > 0 && now - stranger_told_ns_ < kTellNs) return;
  stranger_told_ns_ = now;
  warn(fmt::format("{} of a participant that is not the learner ignored, {} so far", what,
                   strangers_));
}

void BusWorker::prepare() {
  if (!manifest_) return;
  const std::int64_t now = steady_now_ns();
  if (prepared_ && (setup_error_.empty() || now < retry_ns_)) return;
  prepared_ = true;
  retry_span_ns_ = std::clamp(2 * retry_span_ns_, kFirstRetryNs, kMostRetryNs);
  retry_ns_ = now + retry_span_ns_;
  setup_error_.clear();
  const auto require_same = [this](const char* what, std::uint64_t own, std::uint64_t learner) {
    if (!setup_error_.empty() || own == learner) return;
    setup_error_ = fmt::format("{} {:016x} differs from the learner's {:016x}", what, own, learner);
  };
  require_same("build", options_.build_id, manifest_->build_id);
  const bool other = !setup_.backend || setup_.config_hash != manifest_->config_hash;
  if (setup_error_.empty() && other) {
    try {
      setup_ = options_.make_setup(*manifest_);
      OMENTUM_CHECK(setup_.backend != nullptr);
      policy_.reset();
    } catch (const Error& error) {
      setup_ = {};
      setup_error_ = error.what();
    }
  }
  require_same("config_hash", setup_.config_hash, manifest_->config_hash);
  require_same("layout_hash", setup_.shape.layout_hash(), manifest_->layout_hash);
  status_.lanes = setup_.backend ? static_cast<std::uint32_t>(setup_.backend->lanes()) : 0;
  if (!setup_error_.empty()) {
    warn(setup_error_);
  } else {
    status_.warnings.clear();
  }
  status_sent_ns_ = 0;
}

void BusWorker::take_weights(std::vector<Arrival<PolicyWeights>> arrivals) {
  for (Arrival<PolicyWeights>& arrival : arrivals) {
    PolicyWeights& weights = arrival.record;
    const std::uint64_t participant = arrival.info.participant;
    if (participant == learner_) {
      status_.policy_version = weights.policy_version;
      weights_missed_ns_ = 0;
    } else if (learner_ != 0 && weights.learner_epoch <= epoch_) {
      count_stranger("weights");
      // Two learners started within a second have one epoch: the other may be followed next.
      if (weights.learner_epoch < epoch_) continue;
    }
    // Those of a new learner may arrive before its manifest: kept apart by where they come from.
    if (!weights_.contains(participant) && weights_.size() > kMaxSources)
      std::erase_if(weights_, [this](const auto& source) { return source.first != learner_; });
    std::deque<PolicyWeights>& kept = weights_[participant];
    kept.push_back(std::move(weights));
    if (kept.size() > kWeightsKept) kept.pop_front();
  }
}

void BusWorker::accept(std::uint64_t participant, RolloutTask task) {
  if (participant != learner_) {
    // The first tasks of a new learner may arrive before its manifest.
    if (task.learner_epoch <= epoch_) count_stranger("task");
    if (task.learner_epoch < epoch_) return;
    if (early_.size() >= kMaxEarly) return count_wrong(0, 1);
    early_.emplace_back(participant, std::move(task));
    return;
  }
  ++status_.tasks_received;
  deaf_.helped();
  if (task.learner_epoch != epoch_ || task.worker_id != status_.worker_id) {
    ++status_.tasks_declined_epoch;
    status_sent_ns_ = 0;
    return;
  }
  if (pending_.push(std::move(task), steady_now_ns())) ++status_.tasks_abandoned;
}

}  // namespace omentum
