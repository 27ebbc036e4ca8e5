// What a worker says: its status, warnings and frames.
#include <unistd.h>

#include <algorithm>
#include <array>

#include "core/clock.h"
#include "core/hash.h"
#include "core/log.h"
#include "sim_worker/bus/bus_worker.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;
constexpr std::size_t kMaxWarnings = 8;
constexpr std::uint64_t kThrottledNs = kStatusPeriodNs / 4;  // of the time between two statuses

std::string host_name() {
  std::array<char, 256> name{};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "unknown";
}

}  // namespace

std::uint32_t make_worker_id() {
  // Two workers in one process (tests) differ by the clock.
  const std::string identity = fmt::format("{} {} {}", host_name(), getpid(), wall_now_ns());
  const std::uint64_t hash = fnv1a64(identity);
  return std::max(std::uint32_t{1}, static_cast<std::uint32_t>(hash ^ (hash >> 32)));
}

WorkerStatus first_worker_status(const BusWorkerOptions& options) {
  WorkerStatus status;
  status.worker_id = make_worker_id();
  status.host = host_name();
  status.program_version = options.program_version;
  status.pid = static_cast<std::uint32_t>(getpid());
  status.build_id = options.build_id;
  status.socket_receive_buffer_bytes = options.profile.receive_buffer_bytes;
  return status;
}

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
  if (now >= epoch_told_from_ns_) status_.learner_epoch = epoch_;
  status_.tasks_in_progress =
      pending_.size() + running_ + outbox_.size() + simulations_.in_progress();
  const dds::WriterCounters counters = bus_->segments().counters();
  status_.rexmit_bytes = counters.rexmit_bytes;
  status_.throttle_count = counters.throttle_count;
  raise_alarms(counters.time_throttle_ns - status_.time_throttle_ns);
  status_.time_throttle_ns = counters.time_throttle_ns;
  status_.alarms = alarms_.texts();
  status_.alarms_raised = alarms_.raised();
  status_sent_ns_ = now;
  heartbeat_.beat(now);
  const Result<void> ok = bus_->status().write(status_);
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
  status_.tasks_abandoned += outbox_.size() + simulations_.in_progress();
  outbox_.clear();
  say(WorkerPhase::kDraining);
  bus_->segments().wait_for_acknowledgments(kS);
  const Result<void> ok = bus_->status().dispose(status_);
  if (!ok) log().warn("event=status_not_disposed reason=\"{}\"", ok.error());
  bus_->status().wait_for_acknowledgments(kS);
  log().info("event=worker_leaves run={} segments={} abandoned={}", options_.run,
             status_.segments_published, status_.tasks_abandoned);
}

/// `throttled_ns`: writes waited for readers so long since the last status.
void BusWorker::raise_alarms(std::uint64_t throttled_ns) {
  const std::uint64_t timeouts =
      status_.write_timeouts - std::exchange(timeouts_, status_.write_timeouts);
  alarms_.set(
      "reader_stopped", timeouts > 0 || throttled_ns > kThrottledNs,
      "a reliable reader of rollout/segment does not take them: every worker waits for it until "
      "its lease ends; tools must read best effort");
  profile_alarms_.raise(alarms_, options_.profile, steady_now_ns());
}

void BusWorker::count_wrong(std::uint64_t wrong_weights, std::uint64_t dropped) {
  wrong_weights_ += wrong_weights;
  dropped_ += dropped;
  if (wrong_weights > 0)
    warn(fmt::format("weights that do not match their hash: {} so far", wrong_weights_));
  if (dropped > 0) warn(fmt::format("samples of a flood dropped: {} so far", dropped_));
}

/// Of the environments that somebody watches, each at its own rate.
void BusWorker::publish_frames(std::span<const RolloutTask> tasks, std::int64_t now_ns) {
  const Snapshots* states = setup_.backend->snapshots();
  for (std::size_t lane = 0; lane < tasks.size() && states != nullptr; ++lane) {
    const RolloutTask& task = tasks[lane];
    if (!(task.live_frames_hz > 0)) continue;
    std::int64_t& sent = frame_sent_ns_[task.slot];
    if (sent > 0 && static_cast<float>(now_ns - sent) * 1e-9F * task.live_frames_hz < 1) continue;
    sent = now_ns;
    const int index = static_cast<int>(lane);
    const EpisodeFacts facts = setup_.backend->clock(index);
    SimFrame frame;
    frame.slot = task.slot;
    frame.run_id = options_.run;
    frame.worker_id = status_.worker_id;
    frame.policy_version = task.policy_version;
    frame.episode = facts.episode;
    frame.episode_step = facts.episode_step;
    frame.sim_time_s = facts.episode_step * setup_.decision_s;
    frame.tool_position_in_world_m = facts.tool_position;
    frame.grasped = facts.held;
    states->positions(index, frame.particle_positions_in_world_m);
    if (const Result<void> sent_ok = bus_->frames().write(frame); !sent_ok) {
      warn(sent_ok.error());
    } else {
      ++status_.frames_published;
    }
  }
}

}  // namespace omentum
