#include "dvrk_gateway/bus/robot_bus.h"

#include <unistd.h>

#include <array>

#include "core/clock.h"
#include "core/log.h"
#include "core/segment_fields.h"
#include "sim_worker/bus/bus_worker.h"

namespace omentum {
namespace {

constexpr std::int64_t kPeriodNs = 100'000'000;
/// A reader that does not take segments must not hold up a robot: the oldest go.
constexpr std::int32_t kSegmentsKept = 16;

std::string host_name() {
  std::array<char, 256> name{};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "unknown";
}

}  // namespace

RobotBus::Writers::Writers(const dds::Participant& joined, const std::string& run)
    : participant(joined),
      status(joined, public_partitions(run), "gateway-robot"),
      segments(joined, public_partitions(run), "gateway-segments", kSegmentsKept),
      summaries(joined, public_partitions(run), "gateway-summary") {}

RobotBus::RobotBus(const dds::Participant& participant, const RobotBusOptions& options,
                   const SafetySetup& setup)
    : run_(options.run),
      gateway_id_(make_worker_id()),
      build_id_(options.build_id),
      account_(setup) {
  shared_.gateway_id = gateway_id_;
  shared_.run_id = options.run;
  shared_.robot = options.arm;
  shared_.host = host_name();
  shared_.pid = static_cast<std::uint32_t>(getpid());
  shared_.program_version = options.program_version;
  shared_.dry_run = options.dry_run;
  RobotBus::join(participant);
}

RobotBus::~RobotBus() { RobotBus::leave(); }

void RobotBus::leave() {
  const std::lock_guard alone(joining_);
  if (!writers_) return;
  if (const Result<void> left = writers_->status.dispose(shared_); !left)
    log().debug("robot/state: {}", left.error());
  writers_.reset();
}

void RobotBus::join(const dds::Participant& participant) {
  const std::lock_guard alone(joining_);
  writers_.emplace(participant, run_);
}

void RobotBus::pin(const PolicyWeights& weights) {
  const std::lock_guard lock(mutex_);
  shared_.policy_version = weights.policy_version;
  shared_.weights_hash = weights.weights_hash;
}

void RobotBus::on_period(const Period& period) {
  account_.add(period);
  armed_ = period.judgement.memory.phase == SafetyPhase::kActive;
  const bool changed = account_.status().phase != published_phase_;
  if (!changed && period.began_ns - published_ns_ < kPeriodNs) return;
  // This thread hears the operator, too: it waits for nobody.
  const std::shared_lock joined(joining_, std::try_to_lock);
  if (!joined || !writers_) return;
  published_ns_ = period.began_ns;
  published_phase_ = account_.status().phase;
  publish();
}

void RobotBus::publish() {
  if (writers_->participant.expired())
    return count_failure("the certificate has ended, nobody hears this gateway: start it anew");
  RobotStatus status = account_.status();
  {
    const std::lock_guard lock(mutex_);
    status.gateway_id = shared_.gateway_id;
    status.run_id = shared_.run_id;
    status.robot = shared_.robot;
    status.host = shared_.host;
    status.pid = shared_.pid;
    status.program_version = shared_.program_version;
    status.dry_run = shared_.dry_run;
    status.policy_version = shared_.policy_version;
    status.weights_hash = shared_.weights_hash;
    status.episodes = shared_.episodes;
    status.segments_published = shared_.segments_published;
    status.write_failures = shared_.write_failures;
  }
  status.sent_at_ns = wall_now_ns();
  if (const Result<void> sent = writers_->status.write(status); !sent) count_failure(sent.error());
}

void RobotBus::on_episode(const RolloutTask& task, const RolloutSegment& segment) {
  RolloutSegment tagged = segment;
  tagged.source = Source::kDvrk;
  tagged.worker_id = gateway_id_;
  tagged.build_id = build_id_;
  tagged.payload_crc32c = segment_crc(tagged);
  const std::shared_lock joined(joining_);
  if (!writers_) return count_failure("an episode ended while this gateway is not on the bus");
  const Result<void> sent = writers_->segments.write(tagged);
  if (!sent) count_failure(sent.error());
  for (std::size_t i = 0; i < tagged.episode_end_step.size(); ++i) {
    EpisodeSummary summary = summary_of(tagged, i);
    summary.episode = task.episode + i;
    if (const Result<void> told = writers_->summaries.write(summary); !told)
      count_failure(told.error());
  }
  const std::lock_guard lock(mutex_);
  ++shared_.episodes;
  if (sent) ++shared_.segments_published;
}

void RobotBus::count_failure(const std::string& reason) {
  log().warn("event=not_published reason=\"{}\"", reason);  // the log counts what repeats
  const std::lock_guard lock(mutex_);
  ++shared_.write_failures;
}

}  // namespace omentum
