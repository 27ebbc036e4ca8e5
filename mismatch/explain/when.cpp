#include "mismatch/explain/when.h"

#include <algorithm>
#include <cmath>

#include "mismatch/explain/block_errors.h"

namespace omentum {
namespace {

constexpr double kClear = 3;  // [nats] of a frame

/// What the tool does at a time: away from where the recording begins is up.
std::string phase_at(const ToolTrack& track, double t) {
  constexpr double kAway = 5e-4;   // [m]
  constexpr double kStill = 1e-3;  // [m/s]
  constexpr double kSpan = 0.05;   // [s] to either side
  const Eigen::Vector3d begin = track.tip_at(track.begin());
  const double away = (track.tip_at(t) - begin).norm();
  const double before = (track.tip_at(t - kSpan) - begin).norm();
  const double after = (track.tip_at(t + kSpan) - begin).norm();
  const double speed = (track.tip_at(t + kSpan) - track.tip_at(t - kSpan)).norm() / (2 * kSpan);
  if (speed < kStill) return away < kAway ? "rest" : "hold";
  return after >= before ? "lift" : "return";
}

/// The change point with the largest gain behind it, and those that are less by what 90 % allow.
void set_onset(const std::vector<FrameGain>& frames, When& when) {
  constexpr double kNinety = 1.35;  // [nats] half of chi square of one number
  std::vector<double> behind(frames.size() + 1, 0);
  for (std::size_t f = frames.size(); f-- > 0;) behind[f] = behind[f + 1] + frames[f].gain;
  const auto best = static_cast<std::size_t>(std::ranges::max_element(behind) - behind.begin());
  std::size_t low = best, high = best;
  while (low > 0 && behind[low - 1] > behind[best] - kNinety) --low;
  while (high + 1 < frames.size() && behind[high + 1] > behind[best] - kNinety) ++high;
  // The change lies between a frame without and the next with it.
  const auto between = [&](std::size_t f) {
    return f == 0 ? frames[0].t : 0.5 * (frames[f - 1].t + frames[f].t);
  };
  when.onset = between(best);
  when.onset_low = low == 0 ? frames[0].t : frames[low - 1].t;
  when.onset_high = frames[high].t;
}

}  // namespace

std::vector<When> when_of(const BaseFit& base, const BaseFit& model) {
  std::vector<When> found;
  for (const std::size_t r : base.fitted) {
    const std::vector<FrameGain> frames = frame_gains(base, model, r);
    When when;
    when.recording = base.data.observations[r].name;
    bool open = false;
    for (const FrameGain& frame : frames) {
      if (frame.gain < kClear) {
        open = false;
        continue;
      }
      if (!open) when.intervals.emplace_back(frame.t, frame.t);
      when.intervals.back().second = frame.t;
      open = true;
      const std::string phase = phase_at(base.data.observations[r].track, frame.t);
      if (std::ranges::count(when.phases, phase) == 0) when.phases.push_back(phase);
    }
    if (when.intervals.empty()) continue;
    set_onset(frames, when);
    found.push_back(std::move(when));
  }
  return found;
}

}  // namespace omentum
