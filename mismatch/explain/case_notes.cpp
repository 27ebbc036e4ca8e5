#include "mismatch/explain/case_notes.h"

#include <fmt/format.h>

#include <algorithm>

namespace omentum {
namespace {

/// Whether some cloud was taken while the jaws had led the tissue away from where they took it.
bool shows_a_lift(const Observation& seen) {
  constexpr double kMoved = 1e-3;  // [m]
  const ToolTrack& track = seen.track;
  const auto closed =
      std::ranges::find_if(track.jaw_rad, [&](double jaw) { return jaw <= seen.grasp.closed_rad; });
  const auto row = static_cast<std::size_t>(closed - track.jaw_rad.begin());
  const double taken = row < track.jaw_rad.size() ? track.time[row] : track.begin();
  return std::ranges::any_of(seen.frames, [&](const SeenFrame& frame) {
    return frame.t > taken && (track.tip_at(frame.t) - track.tip_at(taken)).norm() > kMoved;
  });
}

}  // namespace

void drop_frames_without_commands(std::vector<Observation>& observations,
                                  std::vector<std::string>& warnings) {
  constexpr double kBehind = 0.1;  // [s] that clocks may be off
  for (Observation& seen : observations) {
    const double end = seen.track.end();
    const std::size_t before = seen.frames.size();
    std::erase_if(seen.frames, [&](const SeenFrame& frame) { return frame.t > end + kBehind; });
    if (seen.frames.size() == before) continue;
    warnings.push_back(fmt::format(
        "{}: its commands end at {:.2f} s: {} of its {} frames, which are later, are not looked at",
        seen.name, end, before - seen.frames.size(), before));
  }
  std::erase_if(observations, [](const Observation& seen) { return seen.frames.empty(); });
}

std::vector<std::string> case_notes(std::span<const Observation> observations) {
  std::vector<std::string> notes;
  const auto is_fitted = [](const Observation& seen) { return !seen.held_out; };
  const auto fitted = std::ranges::count_if(observations, is_fitted);
  const auto count = static_cast<std::ptrdiff_t>(observations.size());
  if (fitted == 1) {
    notes.emplace_back(
        "one recording is fitted: it locates and tests, and confirms nothing; record next the same "
        "again, a lift at another pinch, and one to hold out");
  } else if (fitted == count) {
    notes.emplace_back(
        "no recording is held out (held_out of recording.txtpb): what is named is not confirmed; "
        "hold one out whose pinch, height or speed no other has");
  }
  if (fitted > 1 && std::ranges::all_of(observations, [](const Observation& seen) {
        return seen.repeat_of.empty();
      })) {
    notes.emplace_back(
        "no recording repeats another (repeat_of of recording.txtpb): how far repeats differ is "
        "not known; record one of them again");
  }
  for (const Observation& seen : observations) {
    if (!seen.rays) {
      notes.push_back(seen.name +
                      ": no camera pose is stated: points are compared with what is nearest, not "
                      "along rays; state camera of recording.txtpb");
    }
    if (seen.pinched && !shows_a_lift(seen)) {
      notes.push_back(seen.name +
                      ": its clouds show the tissue before it is moved alone: they say nothing of "
                      "what acts in a lift; record clouds while it is lifted");
    }
  }
  if (std::ranges::none_of(
          observations, [&](const Observation& seen) { return is_fitted(seen) && seen.pinched; })) {
    notes.emplace_back(
        "no recording that is fitted takes hold of the tissue: only what acts at rest can show; "
        "record a lift");
  }
  return notes;
}

}  // namespace omentum
