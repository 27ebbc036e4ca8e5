// The drain thread of the bus: takes what arrives and sends the status, also while the learner
// thread is busy.
#include <pthread.h>

#include <algorithm>

#include "core/clock.h"
#include "core/log.h"
#include "core/scheduling.h"
#include "learner/bus.h"

namespace omentum {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kStatusPeriodNs = 500 * kMs;
constexpr std::int64_t kRatePeriodNs = 1'000 * kMs;
constexpr int kTakenAtOnce = 64;
// Of two learners that do not know of each other the younger one ends within this time.
constexpr std::int64_t kYoungerEndsNs = 3'000 * kMs;
constexpr std::size_t kMostCommands = 64;  // of a flood; an operator sends one

}  // namespace

void LearnerBus::drain(const std::stop_token& stop) {
  pthread_setname_np(pthread_self(), "bus-drain");
  const ShortSlices of_this_thread;
  while (!stop.stop_requested()) {
    const std::int64_t now = steady_now_ns();
    send_status(now);
    waitset_.wait(
        std::max(kMs, std::min(kStatusPeriodNs, status_sent_ns_ + kStatusPeriodNs - now)));
    drain_worker_status();  // first: whose segments count
    drain_segments();
    drain_learner_status();
    drain_commands();
    drain_mirrored();
  }
}

void LearnerBus::drain_segments() {
  // Never stops taking: a full reader would stall every topic of this process (docs/wire.md 5.1).
  const Result<int> taken =
      segment_reader_->take(kTakenAtOnce, [this](Arrival<RolloutSegment>&& arrival) {
        if (!arrival.info.valid) return;
        const std::size_t bytes = wire_bytes(arrival.record);
        const std::lock_guard lock(mutex_);
        if (arrival.record.source != Source::kSimulation) {
          // Of a gateway: for tools, never trained on.
          ++statistics_.foreign;
          ++statistics_.of_robots;
          if (mirror_) mirror_->segment(arrival.record);
          return;
        }
        // A segment counts only from the process that announced its worker.
        if (!workers_.is_process_of(arrival.record.worker_id, arrival.info.participant)) {
          ++statistics_.foreign;
          return;
        }
        if (mirror_) mirror_->segment(arrival.record);
        if (const auto own = segments_of_.find(arrival.record.worker_id); own != segments_of_.end())
          ++own->second;
        statistics_.bytes_up += bytes;
        if (ring_.size() >= ring_capacity_) {
          overflown_.emplace_back(arrival.record.slot, arrival.record.task_hash);
        } else {
          ring_.push_back(std::move(arrival.record));
          ring_peak_ = std::max(ring_peak_, ring_.size());
        }
      });
  if (!taken) log().error("event=take_failed reason=\"{}\"", taken.error());
  bool wake = false;
  {
    const std::lock_guard lock(mutex_);
    const std::uint64_t lost = segment_reader_->raw().lost();
    const std::uint64_t full = segment_reader_->raw().rejected();
    const std::uint64_t refused = segment_reader_->refused();
    if (lost > statistics_.lost) log().error("event=segments_lost total={}", lost);
    // Only a sender without tasks can fill the reader. Told once.
    if (full > 0 && statistics_.full == 0) log().error("event=segment_reader_full flood=true");
    if (refused > statistics_.refused) {
      log().warn("event=segment_refused total={} reason=\"{}\"", refused,
                 segment_reader_->last_refusal());
    }
    wake = refused > statistics_.refused || !ring_.empty() || !overflown_.empty();
    statistics_.lost = lost;
    statistics_.full = full;
    statistics_.refused = refused;
  }
  if (wake) something_.notify_all();
}

void LearnerBus::drain_worker_status() {
  bool changed = false;
  const Result<int> taken =
      worker_reader_.take(1024, [this, &changed](Arrival<WorkerStatus>&& arrival) {
        using Event = WorkerList::Event;
        const std::lock_guard lock(mutex_);
        const std::uint32_t id = arrival.record.worker_id;
        const Event event = workers_.note(std::move(arrival), steady_now_ns());
        statistics_.workers_alive = workers_.count_alive();
        if (event == Event::kRefused) {
          ++statistics_.id_conflicts;
          log().warn(
              "event=worker_refused reason=\"its id or its process is a live worker, or {} speak\" "
              "worker={} total={}",
              WorkerList::kMostWorkers, id, workers_.refused());
          return;
        }
        if (event == Event::kNothing) return;
        const ListedWorker& worker = *workers_.find(id);
        if (mirror_ && worker.alive) mirror_->worker(worker.status);
        if (mirror_ && (event == Event::kLeft || event == Event::kCrashed))
          mirror_->gone(worker.status);
        statistics_.worker_leaves += event == Event::kLeft ? 1 : 0;
        statistics_.worker_crashes += event == Event::kCrashed ? 1 : 0;
        changed = true;
      });
  if (!taken) log().error("event=take_failed reason=\"{}\"", taken.error());
  if (changed) something_.notify_all();
}

void LearnerBus::drain_learner_status() {
  const Result<int> taken = learner_reader_.take(256, [this](Arrival<LearnerStatus>&& arrival) {
    if (!arrival.info.valid || arrival.record.run_id != options_.run) return;
    if (arrival.info.state != dds::InstanceState::kAlive) return;
    const std::uint32_t epoch = arrival.record.learner_epoch;
    const std::int64_t now = steady_now_ns();
    if (epoch < options_.learner_epoch && arrival.record.phase != LearnerPhase::kDone) {
      older_epoch_.store(epoch);
      { const std::lock_guard lock(mutex_); }  // or a wait() that is about to sleep would miss it
      something_.notify_all();
    }
    if (epoch <= options_.learner_epoch || epoch <= superseding_epoch()) return;
    if (std::exchange(younger_epoch_, epoch) != epoch) {
      younger_since_ns_ = now;
      log().warn("event=younger_learner run={} epoch={} its_epoch={}", options_.run,
                 options_.learner_epoch, epoch);
    }
    if (now - younger_since_ns_ < kYoungerEndsNs) return;
    superseding_epoch_.store(epoch);
    log().error("event=superseded run={} epoch={} by_epoch={}", options_.run,
                options_.learner_epoch, epoch);
    something_.notify_all();
  });
  if (!taken) log().error("event=take_failed reason=\"{}\"", taken.error());
}

void LearnerBus::drain_commands() {
  const Result<int> taken =
      command_reader_.take(kTakenAtOnce, [this](Arrival<ControlCommand>&& arrival) {
        if (!arrival.info.valid || arrival.record.run_id != options_.run) return;
        if (HubMirror::is_forwarded(arrival.record)) return;
        if (mirror_ && arrival.record.action == ControlAction::kDrain)
          mirror_->forward(arrival.record);
        const std::lock_guard lock(mutex_);
        const bool repeated = std::any_of(
            commands_.begin(), commands_.end(),
            [&](const ControlCommand& c) { return c.request == arrival.record.request; });
        if (repeated) return;
        if (commands_.size() < kMostCommands) {
          commands_.push_back(std::move(arrival.record));
        } else {
          log().warn("event=command_dropped reason=\"a flood\"");  // the log counts what repeats
        }
      });
  if (!taken) log().error("event=take_failed reason=\"{}\"", taken.error());
  if (taken && taken.value() > 0) something_.notify_all();
}

void LearnerBus::drain_mirrored() {
  if (!mirror_) return;
  const Result<int> frames = frame_reader_->take(kTakenAtOnce, [this](Arrival<SimFrame>&& arrival) {
    if (arrival.info.valid) mirror_->frame(arrival.record);
  });
  const Result<int> replies =
      reply_reader_->take(kTakenAtOnce, [this](Arrival<ControlReply>&& arrival) {
        if (arrival.info.valid && arrival.record.worker_id != 0) mirror_->reply(arrival.record);
      });
  const Result<int> robots =
      robot_reader_->take(kTakenAtOnce, [this](Arrival<RobotStatus>&& arrival) {
        if (arrival.info.valid) mirror_->robot(arrival.record);
      });
  if (!frames || !replies || !robots) log().error("event=take_failed topic=mirrored");
}

void LearnerBus::send_status(std::int64_t now_ns) {
  if (superseded() || !speaks_) {
    status_sent_ns_ = now_ns;
    return;
  }
  LearnerStatus status;
  {
    const std::lock_guard lock(mutex_);
    if (!status_urgent_ && now_ns - status_sent_ns_ < kStatusPeriodNs) return;
    status_urgent_ = false;
    if (now_ns - rate_from_ns_ >= kRatePeriodNs) {
      const double seconds = static_cast<double>(now_ns - rate_from_ns_) * 1e-9;
      status_.bytes_up_per_s = static_cast<double>(statistics_.bytes_up - rate_bytes_up_) / seconds;
      status_.bytes_down_per_s =
          static_cast<double>(statistics_.bytes_down - rate_bytes_down_) / seconds;
      rate_from_ns_ = now_ns;
      rate_bytes_up_ = statistics_.bytes_up;
      rate_bytes_down_ = statistics_.bytes_down;
    }
    status_.workers_alive = statistics_.workers_alive;
    status_.worker_ids.clear();
    status_.worker_phases.clear();
    status_.worker_steps_per_s.clear();
    for (const WorkerStatus& worker : workers_.alive()) {
      status_.worker_ids.push_back(worker.worker_id);
      status_.worker_phases.push_back(static_cast<std::uint8_t>(worker.phase));
      status_.worker_steps_per_s.push_back(worker.steps_per_s);
    }
    status = status_;
  }
  status_sent_ns_ = now_ns;
  const Result<void> ok = status_writer_.write(status);
  if (!ok) log().warn("event=status_not_sent reason=\"{}\"", ok.error());
}

}  // namespace omentum
