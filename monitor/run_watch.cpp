#include "monitor/run_watch.h"

#include "core/clock.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr int kTakeLimit = 4096;  // at once: all workers of the largest run

template <typename Record>
void take_all(BusReader<Record>& reader, const std::function<void(Arrival<Record>&&)>& fn) {
  if (const Result<int> taken = reader.take(kTakeLimit, fn); !taken)
    log().warn("event=not_taken reason=\"{}\"", taken.error());
}

}  // namespace

RunWatch::RunWatch(const dds::Participant& participant, const std::string& run, bool with_frames)
    : learner_(participant, tool_partitions(run), "tool-learner"),
      workers_(participant, tool_partitions(run), "tool-workers"),
      manifest_(participant, tool_partitions(run), "tool-manifest"),
      episodes_(participant, tool_partitions(run), "tool-episodes"),
      robots_(participant, tool_partitions(run), "tool-robots"),
      waitset_(participant) {
  waitset_.attach(learner_.raw());
  waitset_.attach(workers_.raw());
  waitset_.attach(manifest_.raw());
  waitset_.attach(episodes_.raw());
  waitset_.attach(robots_.raw());
  if (!with_frames) return;
  frames_.emplace(participant, tool_partitions(run), "tool-frames");
  waitset_.attach(frames_->raw());
}

void RunWatch::wait(std::int64_t timeout_ns) { waitset_.wait(timeout_ns); }

void RunWatch::take_into(RunState& state, const std::function<void(SimFrame&&)>& on_frame) {
  const std::int64_t now = steady_now_ns();
  take_all<LearnerStatus>(learner_, [&](auto&& a) { state.apply(std::move(a), now); });
  take_all<WorkerStatus>(workers_, [&](auto&& a) { state.apply(std::move(a), now); });
  take_all<RunManifest>(manifest_, [&](auto&& a) { state.apply(std::move(a), now); });
  take_all<EpisodeSummary>(episodes_, [&](auto&& a) { state.apply(std::move(a), now); });
  take_all<RobotStatus>(robots_, [&](auto&& a) { state.apply(std::move(a), now); });
  if (!frames_) return;
  take_all<SimFrame>(*frames_, [&](auto&& a) {
    if (a.info.valid) on_frame(std::move(a.record));
  });
}

std::uint64_t RunWatch::refused() const {
  return learner_.refused() + workers_.refused() + manifest_.refused() + episodes_.refused() +
         robots_.refused() + (frames_ ? frames_->refused() : 0);
}

bool RunLink::join() {
  participant_ = join_run(options_, name_);
  if (!participant_) return false;
  watch_ = std::make_unique<RunWatch>(*participant_, options_.run, with_frames_);
  asked_ns_ = steady_now_ns();
  return true;
}

bool RunLink::is_deaf(const RunState& state, std::int64_t now_ns) {
  constexpr std::int64_t kAskNs = 10'000'000'000;
  if (now_ns - asked_ns_ < kAskNs) return false;
  asked_ns_ = now_ns;
  if (!state.learner() || state.learner_presence(now_ns) == Presence::kAlive ||
      state.learner()->phase == LearnerPhase::kDone)
    return false;
  return participant_->sees("omentum-learner");
}

void RunLink::leave() {
  watch_.reset();
  participant_.reset();
}

}  // namespace omentum
