#include "dvrk_gateway/bus/bus_policy_source.h"

#include <fmt/core.h>

#include <chrono>
#include <thread>
#include <utility>

#include "core/check.h"
#include "core/clock.h"
#include "core/config.h"
#include "core/hash.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr std::int64_t kLookNs = 50'000'000;  // stop flag
constexpr std::int64_t kFirstTellNs = 2'000'000'000;
constexpr std::int64_t kTellNs = 60'000'000'000;
constexpr int kTakenAtOnce = 4096;
constexpr std::int32_t kWeightsDepth = 8;  // beside those of a stranger
constexpr std::size_t kMostSources = 16;   // of weights, before strangers' go

template <typename Record, typename Fn>
void take_all(BusReader<Record>& reader, Fn&& fn) {
  if (const Result<int> taken = reader.take(kTakenAtOnce, fn); !taken)
    log().error("event=take_failed reason=\"{}\"", taken.error());
}

}  // namespace

BusPolicySource::Readers::Readers(const dds::Participant& participant, const std::string& run)
    : manifests(participant, run_partition(run), "gateway-manifest"),
      learners(participant, run_partition(run), "gateway-learner"),
      weights(participant, run_partition(run), "gateway-weights", kWeightsDepth),
      waitset(participant) {
  waitset.attach(manifests.raw());
  waitset.attach(learners.raw());
  waitset.attach(weights.raw());
}

BusPolicySource::BusPolicySource(const dds::Participant& participant, const std::string& run)
    : run_(run), policy_id_(static_cast<std::uint32_t>(fnv1a64(run))) {
  BusPolicySource::join(participant);
}

void BusPolicySource::leave() {
  // Identities of participants are of the participant that saw them.
  choice_ = {};
  newest_.clear();
  readers_.reset();
}

void BusPolicySource::join(const dds::Participant& participant) {
  readers_.emplace(participant, run_);
}

void BusPolicySource::wait_for_arrivals() {
  if (readers_) {
    readers_->waitset.wait(kLookNs);
  } else {
    std::this_thread::sleep_for(std::chrono::nanoseconds(kLookNs));
  }
  take_arrivals();
}

std::unique_ptr<BusPolicySource> BusPolicySource::wait(GatewayBus& bus, const std::string& run,
                                                       const std::function<bool()>& stop) {
  std::unique_ptr<BusPolicySource> source(new BusPolicySource(bus.participant(), run));
  std::int64_t tell_ns = steady_now_ns() + kFirstTellNs;
  while (!stop()) {
    const std::int64_t began_ns = steady_now_ns();
    source->wait_for_arrivals();
    if (source->begin()) return source;
    const std::int64_t now_ns = steady_now_ns();
    bus.watch(now_ns, now_ns - began_ns - kLookNs);
    if (bus.is_deaf(source->heard_ns_, true, now_ns)) {
      BusMember* const member = source.get();
      if (const Result<void> joined = bus.join_anew({&member, 1}); !joined)
        log().warn("event=rejoin_failed reason=\"{}\"", joined.error());
    }
    if (now_ns < tell_ns) continue;
    tell_ns = now_ns + kTellNs;
    log().warn("--policy bus: waiting for the policy of a learner: start learner --run {}", run);
  }
  return nullptr;
}

void BusPolicySource::take_arrivals() {
  if (!readers_) return;
  take_all(readers_->manifests, [this](Arrival<RunManifest>&& arrival) {
    if (arrival.info.valid && arrival.record.run_id == run_)
      choice_.offered(arrival.info.participant, std::move(arrival.record));
  });
  take_all(readers_->learners, [this](Arrival<LearnerStatus>&& arrival) {
    const bool alive = arrival.info.valid && arrival.info.state == dds::InstanceState::kAlive;
    if (!alive || arrival.record.run_id != run_) return;
    heard_ns_ = steady_now_ns();
    choice_.spoke(arrival.info.participant, arrival.record.learner_epoch, heard_ns_);
  });
  take_all(readers_->weights, [this](Arrival<PolicyWeights>&& arrival) {
    const PolicyWeights& weights = arrival.record;
    if (!arrival.info.valid || weights.policy_id != policy_id_) return;
    if (hash_weights(weights.parameters, weights.obs_mean, weights.obs_inv_std) !=
        weights.weights_hash) {
      refuse(fmt::format("version {}: not of the hash that it names", weights.policy_version));
      return;
    }
    const std::uint64_t participant = arrival.info.participant;
    const LearnerChoice::Learner* learner = choice_.choose(steady_now_ns());
    if (!newest_.contains(participant) && newest_.size() >= kMostSources) {
      std::erase_if(newest_, [learner](const auto& source) {
        return learner == nullptr || source.first != learner->participant;
      });
    }
    newest_[participant] = std::move(arrival.record);
  });
}

const PolicyWeights* BusPolicySource::newer() {
  const LearnerChoice::Learner* learner = choice_.choose(steady_now_ns());
  if (learner == nullptr) return nullptr;
  const auto found = newest_.find(learner->participant);
  if (found == newest_.end() || found->second.learner_epoch != learner->manifest.learner_epoch)
    return nullptr;
  const bool same = policy_ && found->second.weights_hash == policy_->weights().weights_hash &&
                    found->second.policy_version == policy_->weights().policy_version;
  return same ? nullptr : &found->second;
}

bool BusPolicySource::begin() {
  const PolicyWeights* weights = newer();
  if (weights == nullptr) return false;
  const RunManifest& manifest = choice_.choose(steady_now_ns())->manifest;
  config_ = parse_config("manifest of run " + run_, manifest.config_text);
  config_hash_ = config_hash(config_);
  if (config_hash_ != manifest.config_hash) {
    throw_error(
        "--policy bus: this build reads the configuration of run {} differently (hash {:016x}, "
        "the learner's {:016x})",
        run_, config_hash_, manifest.config_hash);
  }
  policy_ = fitting_policy(fmt::format("--policy bus, version {}", weights->policy_version),
                           config_, *weights);
  return true;
}

Policy& BusPolicySource::for_next_episode() {
  take_arrivals();
  const PolicyWeights* weights = newer();
  if (weights == nullptr) return *policy_;
  if (refused_weights_ && refused_weights_->weights_hash == weights->weights_hash) return *policy_;
  try {
    if (weights->config_hash != config_hash_)
      throw_error("version {}: of another configuration", weights->policy_version);
    policy_ = fitting_policy(fmt::format("version {}", weights->policy_version), config_, *weights);
  } catch (const Error& error) {
    refused_weights_ = *weights;
    refuse(error.what());
  }
  return *policy_;
}

void BusPolicySource::refuse(const std::string& reason) {
  ++refused_;
  log().warn("event=policy_refused total={} reason=\"{}\"", refused_, reason);
}

}  // namespace omentum
