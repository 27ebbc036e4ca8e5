#include "mismatch/seen/seen_markers.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/check.h"
#include "mismatch/import/rigid.h"
#include "mismatch/intake/intake.h"
#include "mismatch/intake/signals.h"
#include "mismatch/recording/messages.h"
#include "mismatch/recording/text_table.h"

namespace omentum {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

constexpr double kUsualNoise = 1e-4;  // [m] where the intake finds no hold

double seconds(std::int64_t time_ns) { return static_cast<double>(time_ns) / 1e9; }

/// Where a marker is in a row; nothing where it was not seen.
std::optional<Vector3d> marker_at(const Series& series, std::size_t row, std::size_t marker) {
  const Vector3d p(series.at(row, 3 * marker), series.at(row, 3 * marker + 1),
                   series.at(row, 3 * marker + 2));
  return p.allFinite() ? std::optional<Vector3d>(p) : std::nullopt;
}

std::vector<std::string> names_of(const Series& series) {
  std::vector<std::string> names = marker_names(series);
  for (std::size_t k = names.size(); 3 * k < series.columns.size(); ++k)
    names.push_back(fmt::format("marker{}", k));
  return names;
}

MarkerNote::On role_of(const MarkerNotes& notes, const std::string& name) {
  const auto found = notes.by_name.find(name);
  return found == notes.by_name.end() ? MarkerNote::On::kTissue : found->second.on;
}

/// What brings the clamp of a row to where the scene has it; nothing where fewer than three of its
/// markers are seen.
std::optional<Isometry3d> clamp_motion(const Series& series, const std::vector<std::string>& names,
                                       std::size_t row, const MarkerNotes& notes) {
  std::vector<Vector3d> from, to;
  for (std::size_t k = 0; k < names.size(); ++k) {
    const auto place = notes.clamp.find(names[k]);
    const auto p = marker_at(series, row, k);
    if (place == notes.clamp.end() || !p) continue;
    from.push_back(*p);
    to.push_back(place->second);
  }
  if (from.size() < 3) return std::nullopt;
  const Result<RigidFit> fit = fit_rigid(from, to);
  if (!fit) throw_error("--markers: those of the clamp: {}", fit.error());
  return fit.value().X_TF;
}

/// Standard deviation of a number of a marker in holds [m].
double noise_of(const Recording& recording) {
  Recording alone;
  alone.info = recording.info;
  for (const auto& [topic, series] : recording.series) {
    if (topic == "markers" || topic.ends_with("_commanded")) alone.series[topic] = series;
  }
  for (const NoiseFigures& noise : take_in(alone).noise) {
    if (noise.topic == "markers" && noise.sd > 0) return noise.sd;
  }
  return kUsualNoise;
}

/// How far markers that both frames show are from where they were, in the mean [m].
double way_between(const SeenFrame& before, const SeenFrame& frame) {
  double sum = 0, count = 0;
  for (const SeenMarker& seen : frame.markers) {
    const auto same = std::ranges::find(before.markers, seen.marker, &SeenMarker::marker);
    if (same == before.markers.end()) continue;
    sum += (seen.p - same->p).norm();
    ++count;
  }
  return count > 0 ? sum / count : 0;
}

/// When a body that was held begins to fall: before it is fast, and its way grows with the square
/// of the time. A marker that jumps to and fro is no fall.
double release_of(const std::vector<SeenFrame>& frames, const std::string& path) {
  constexpr double kSlow = 0.05, kFast = 0.5;  // of the highest speed
  constexpr double kAtAll = 0.005;             // [m/s]
  constexpr std::size_t kBeside = 2;           // frames, whose middle counts
  std::vector<double> speed = {0}, steady;
  for (std::size_t k = 1; k < frames.size(); ++k)
    speed.push_back(way_between(frames[k - 1], frames[k]) / (frames[k].t - frames[k - 1].t));
  for (std::size_t k = 0; k < speed.size(); ++k) {
    const std::size_t from = k - std::min(k, kBeside), to = std::min(k + kBeside + 1, speed.size());
    steady.push_back(median({speed.begin() + static_cast<std::ptrdiff_t>(from),
                             speed.begin() + static_cast<std::ptrdiff_t>(to)}));
  }
  const double highest = *std::ranges::max_element(steady);
  if (!(highest > kAtAll)) {
    throw_error(
        "{}: the body was held at the start and no marker is faster than {} mm/s: it is never let "
        "go",
        path, 1e3 * kAtAll);
  }
  const auto fast = static_cast<std::size_t>(
      std::ranges::find_if(steady, [&](double v) { return v > kFast * highest; }) - steady.begin());
  std::size_t rests = fast;
  while (rests > 0 && speed[rests] > kSlow * highest) --rests;
  // Two frames of the fall, the first of them already some way from rest.
  const std::size_t first = std::min(rests + 2, frames.size() - 1);
  const std::size_t second = std::min(rests + 3, frames.size() - 1);
  const double a = std::sqrt(way_between(frames[rests], frames[first]));
  const double b = std::sqrt(way_between(frames[rests], frames[second]));
  const double t = frames[first].t;
  if (!(b > a)) return frames[rests].t;
  return std::clamp(t - a * (frames[second].t - t) / (b - a), frames[rests].t, t);
}

}  // namespace

MarkerNotes read_marker_notes(const std::string& path) {
  const TextTable table = TextTable::read(path, {});
  MarkerNotes notes;
  const std::size_t name = table.column("name"), on = table.column("on");
  const std::array<std::size_t, 3> axes = {table.column("x_m"), table.column("y_m"),
                                           table.column("z_m")};
  for (std::size_t row = 0; row < table.rows(); ++row) {
    MarkerNote note;
    const std::string_view place = table.cell(row, on);
    if (place == "clamp") {
      note.on = MarkerNote::On::kClamp;
    } else if (place == "other") {
      note.on = MarkerNote::On::kOther;
    } else if (place != "tissue") {
      throw_error("{}: \"{}\", allowed tissue, clamp, other", table.place(row, on), place);
    }
    Vector3d p;
    for (std::size_t k = 0; k < 3; ++k)
      p[static_cast<Eigen::Index>(k)] = table.number(row, axes[k]);
    if (p.allFinite()) note.p_B = p;
    if (!notes.by_name.emplace(table.cell(row, name), note).second)
      throw_error("{}: a second line of that marker", table.place(row, name));
  }
  return notes;
}

void find_clamp(const Recording& recording, MarkerNotes& notes) {
  const auto on_clamp = std::ranges::count_if(
      notes.by_name, [](const auto& entry) { return entry.second.on == MarkerNote::On::kClamp; });
  const Series* series = recording.find("markers");
  if (on_clamp == 0 || series == nullptr) return;
  if (on_clamp < 3)
    throw_error("--markers: {} of the clamp, needed 3 to say how it stands, or none", on_clamp);
  const std::vector<std::string> names = names_of(*series);
  for (std::size_t k = 0; k < names.size(); ++k) {
    if (role_of(notes, names[k]) != MarkerNote::On::kClamp) continue;
    std::array<std::vector<double>, 3> seen;
    for (std::size_t row = 0; row < series->rows(); ++row) {
      const auto p = marker_at(*series, row, k);
      for (std::size_t axis = 0; p && axis < 3; ++axis)
        seen[axis].push_back((*p)[static_cast<Eigen::Index>(axis)]);
    }
    if (!seen[0].empty())
      notes.clamp[names[k]] = Vector3d(median(seen[0]), median(seen[1]), median(seen[2]));
  }
  if (notes.clamp.size() != static_cast<std::size_t>(on_clamp))
    throw_error("--markers: of the clamp {} of {} are never seen", on_clamp - notes.clamp.size(),
                on_clamp);
}

void add_markers(const Recording& recording, const std::string& path, const MarkerNotes& notes,
                 Observation& made, std::vector<std::string>& warnings) {
  const Series* series = recording.find("markers");
  if (series == nullptr) return;
  const std::vector<std::string> names = names_of(*series);
  std::vector<int> number(names.size(), -1);
  for (std::size_t k = 0; k < names.size(); ++k) {
    if (role_of(notes, names[k]) != MarkerNote::On::kTissue) continue;
    number[k] = static_cast<int>(made.markers.size());
    made.markers.push_back(names[k]);
  }
  std::vector<SeenFrame> frames;
  std::size_t no_clamp = 0;
  for (std::size_t row = 0; row < series->rows(); ++row) {
    SeenFrame frame;
    frame.t = seconds(series->time_ns[row]);
    Isometry3d X = Isometry3d::Identity();
    if (!notes.clamp.empty()) {
      const auto motion = clamp_motion(*series, names, row, notes);
      no_clamp += motion ? 0 : 1;
      if (!motion) continue;
      X = *motion;
    }
    for (std::size_t k = 0; k < names.size(); ++k) {
      const auto p = number[k] >= 0 ? marker_at(*series, row, k) : std::nullopt;
      if (p) frame.markers.push_back({number[k], X * *p});
    }
    if (!frame.markers.empty()) frames.push_back(std::move(frame));
  }
  if (no_clamp > 0) {
    warnings.push_back(
        fmt::format("{}: in {} of {} rows fewer than three markers of the clamp are "
                    "seen; they are left out",
                    path, no_clamp, series->rows()));
  }
  if (frames.empty()) return;
  made.marker_rows = frames.size();
  made.marker_noise = noise_of(recording);
  if (made.held) {
    const pb::RecordingStart& start = recording.info.start();
    if (start.has_release_time_s()) {
      made.released = start.release_time_s();
    } else if (recording.info.has_start()) {
      made.released = release_of(frames, path);
    }
    constexpr double kBefore = 0.3;  // [s] it rests until then
    const double begin = std::min(made.released - kBefore, frames.back().t);
    std::erase_if(frames, [&](const SeenFrame& frame) { return frame.t < begin; });
  }
  for (const std::size_t k : evenly_chosen(frames.size(), kMostMarkerFrames))
    made.frames.push_back(std::move(frames[k]));
  std::ranges::stable_sort(made.frames, {}, &SeenFrame::t);
}

ToolTrack standing_track(const Series& markers, const std::string& path, const Scene& scene) {
  constexpr double kAside = 0.3;  // [m] above the body
  constexpr double kAfter = 0.3;  // [s] what the clock may be off
  Vector3d tip = Vector3d::Zero();
  for (const Vector3d& p : scene.tissue.particles)
    tip += scene.tissue.X_WB * p / static_cast<double>(scene.tissue.particles.size());
  tip.z() += kAside;
  ToolTrack track;
  track.path = path;
  track.time = {seconds(markers.time_ns.front()), seconds(markers.time_ns.back()) + kAfter};
  track.p_WT.assign(2, tip);
  track.jaw_rad.assign(2, std::numbers::pi);
  return track;
}

void number_markers(std::vector<Observation>& observations, std::vector<std::string>& warnings) {
  std::map<std::string, int> number;
  for (const Observation& o : observations) {
    for (const SeenFrame& frame : o.frames) {
      for (const SeenMarker& seen : frame.markers)
        number[o.markers[static_cast<std::size_t>(seen.marker)]] = -1;
    }
  }
  std::vector<std::string> names;
  for (const auto& [name, unused] : number) names.push_back(name);
  std::vector<std::string> kept;
  for (const std::size_t k : evenly_chosen(names.size(), kMostMarkers)) {
    number[names[k]] = static_cast<int>(kept.size());
    kept.push_back(names[k]);
  }
  if (kept.size() < names.size()) {
    warnings.push_back(
        fmt::format("markers: {} of {} are looked at, evenly chosen", kept.size(), names.size()));
  }
  for (Observation& o : observations) {
    for (SeenFrame& frame : o.frames) {
      for (SeenMarker& seen : frame.markers)
        seen.marker = number.at(o.markers[static_cast<std::size_t>(seen.marker)]);
      std::erase_if(frame.markers, [](const SeenMarker& seen) { return seen.marker < 0; });
      std::ranges::sort(frame.markers, {}, &SeenMarker::marker);
    }
    std::erase_if(o.frames, [](const SeenFrame& frame) {
      return frame.points.empty() && frame.markers.empty();
    });
    o.markers = kept;
  }
}

}  // namespace omentum
