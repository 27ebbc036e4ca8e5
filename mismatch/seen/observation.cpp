#include "mismatch/seen/observation.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "mismatch/intake/signals.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/table_columns.h"
#include "mismatch/seen/commanded.h"
#include "mismatch/seen/seen_markers.h"
#include "mismatch/seen/unreadable_frame.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kMargin = 0.3;      // [s] behind the last frame: what the clock may be off
constexpr double kLargestCloud = 3;  // [m]

/// Pose of the camera: that of the recording, else the scene's.
void set_camera(const pb::RecordingCamera& camera, const Scene& scene, Observation& made) {
  made.p_WC = scene.camera.position;
  made.R_WC = scene.camera.R_WC;
  made.rays = camera.p_m_size() == 3 || scene.config.has_camera();
  if (!made.rays) {
    constexpr double kAbove = 1;  // [m] of what no camera sees
    made.p_WC = scene.tissue.X_WB.translation() + kAbove * Vector3d::UnitZ();
    made.R_WC.setIdentity();
  }
  if (camera.p_m_size() != 3) return;
  made.p_WC = Vector3d(camera.p_m(0), camera.p_m(1), camera.p_m(2));
  if (camera.view_direction_size() != 3 || camera.up_size() != 3) return;
  const Vector3d axis(camera.view_direction(0), camera.view_direction(1), camera.view_direction(2));
  const Vector3d up(camera.up(0), camera.up(1), camera.up(2));
  if (!(axis.cross(up).norm() > 1e-6 * axis.norm() * up.norm())) return;
  made.R_WC.col(2) = -axis.normalized();
  made.R_WC.col(0) = axis.cross(up).normalized();
  made.R_WC.col(1) = made.R_WC.col(2).cross(made.R_WC.col(0));
}

/// So high above the board of a scene [m].
Eigen::Hyperplane<double, 3> plane_above_board(const Scene& scene, double height) {
  for (const RigidShape& body : scene.bodies) {
    if (body.role != pb::ROLE_BOARD || body.kind != RigidShape::Kind::kHalfSpace) continue;
    const Vector3d up = body.X_WS.linear().col(2);
    return {up, body.X_WS.translation() + height * up};
  }
  throw_error("--above-board-mm: the scene has no board (rigid_body with half_space, ROLE_BOARD)");
}

/// Of the track what is done before `until`, and a row there.
void cut_track(double until, ToolTrack& track) {
  if (!(until < track.end())) return;
  const Vector3d tip = track.tip_at(until);
  const double jaw = track.jaw_rad.empty() ? 0 : track.jaw_at(until);
  const auto keep = static_cast<std::size_t>(
      std::lower_bound(track.time.begin(), track.time.end(), until) - track.time.begin());
  track.time.resize(keep);
  track.p_WT.resize(keep);
  track.time.push_back(until);
  track.p_WT.push_back(tip);
  if (track.lines.size() > keep) track.lines.resize(keep + 1);
  if (track.jaw_rad.empty()) return;
  track.jaw_rad.resize(keep);
  track.jaw_rad.push_back(jaw);
}

bool has_tool(const Recording& recording) {
  return recording.find("tool") != nullptr || recording.find("tool_commanded") != nullptr;
}

/// Path of the tool; of a recording of markers without one, jaws that stand aside.
void set_commands(const Recording& recording, const std::string& path, const Scene& scene,
                  Observation& made, std::vector<std::string>& warnings) {
  const pb::RecordingStart& start = recording.info.start();
  made.held = scene.config.has_held_start();
  made.released = scene.config.held_start().until_s();
  if ((start.held_markers() || start.held_tip()) && !made.held) {
    throw_error(
        "{}: the body was held at the start, and scene.held_start, which says where, is "
        "missing",
        path);
  }
  const Series* markers = recording.find("markers");
  if (markers == nullptr || has_tool(recording)) {
    made.track = tool_track_of(recording, path, scene_tool_mount(scene), warnings);
    return;
  }
  made.track = standing_track(*markers, path, scene);
  constexpr double kShortest = 0.0025;  // [s]
  made.period = std::clamp(0.5 * median_period(*markers), kShortest, made.period);
}

/// Force on the tool around the frames, less its mean before the jaws close.
void add_forces(const Recording& recording, const std::string& path, Observation& made,
                std::vector<std::string>& warnings) {
  constexpr double kBeside = 0.05;  // [s] to either side of a frame
  const Series* series = recording.find("force");
  if (series == nullptr) return;
  const std::array<std::size_t, 3> columns = {series->find("fx_N"), series->find("fy_N"),
                                              series->find("fz_N")};
  const std::vector<std::string> unknown = never_known(*series);
  const bool whole =
      std::ranges::none_of(unknown, [](const std::string& name) { return name.starts_with('f'); });
  if (!whole || std::ranges::find(columns, series->columns.size()) != columns.end()) {
    warnings.push_back(fmt::format("{}: a force needs fx, fy and fz; it is not used", path));
    return;
  }
  const auto mean = [&](const auto& wanted) -> std::optional<Vector3d> {
    Vector3d sum = Vector3d::Zero();
    double count = 0;
    for (std::size_t row = 0; row < series->rows(); ++row) {
      const Vector3d f(series->at(row, columns[0]), series->at(row, columns[1]),
                       series->at(row, columns[2]));
      if (!f.allFinite() || !wanted(static_cast<double>(series->time_ns[row]) / 1e9)) continue;
      sum += f;
      ++count;
    }
    return count > 0 ? std::optional<Vector3d>(sum / count) : std::nullopt;
  };
  const ToolTrack& track = made.track;
  const auto closes =
      std::ranges::find_if(track.jaw_rad, [&](double jaw) { return jaw <= made.grasp.closed_rad; });
  const auto row = static_cast<std::size_t>(closes - track.jaw_rad.begin());
  const double closed = row < track.jaw_rad.size() ? track.time[row] : track.begin();
  const auto zero = mean([&](double t) { return t < closed; });
  if (!zero) {
    warnings.push_back(fmt::format(
        "{}: no force before the jaws close, so that its zero is not known: it is not used", path));
    return;
  }
  double last = -std::numeric_limits<double>::infinity();
  for (SeenFrame& frame : made.frames) {
    // Of the many frames of markers each tells once.
    if (frame.points.empty() && frame.t < last + 2 * kBeside) continue;
    const auto near = [&](double from, double to) {
      return mean([&](double t) { return t >= frame.t + from && t <= frame.t + to; });
    };
    const auto value = near(-kBeside, kBeside);
    if (!value || frame.t < closed) continue;
    const auto before = near(-kBeside, 0), after = near(0, kBeside);
    frame.force = SeenForce{*value - *zero, 0};
    last = frame.t;
    if (before && after) frame.force->change = (*after - *before).norm() / kBeside;
  }
}

/// What is known of it before anything is looked at.
Observation begin_observation(const std::string& name, const std::string& path,
                              const Recording& recording, const Scene& scene,
                              std::vector<std::string>& warnings) {
  Observation made;
  made.name = name;
  set_commands(recording, path, scene, made, warnings);
  const pb::Grip& grip = scene.config.tool().grip();
  made.grasp.patch_radius_m = grip.shape() == pb::GRIP_RECTANGLE
                                  ? std::max(grip.half_x_m(), grip.half_y_m())
                                  : grip.half_x_m();
  made.held_out = recording.info.held_out();
  made.repeat_of = recording.info.repeat_of();
  made.clock_sd = recording.info.clock_offset_uncertainty_s();
  set_camera(recording.info.camera(), scene, made);
  return made;
}

/// Throws UnreadableFrame.
Cloud fetch_cloud(const std::string& path, const Frames<Cloud>& clouds, std::size_t k) {
  try {
    return clouds.fetch(k);
  } catch (const Error& error) {
    throw UnreadableFrame(fmt::format("{}: {}", path, error.what()));
  }
}

/// Where the jaws close on the tissue.
void find_pinch(const Recording& recording, const std::string& path, const Scene& scene,
                Observation& made, std::vector<std::string>& warnings) {
  // The tissue may hang as far from its flat shape as it is long.
  Eigen::AlignedBox3d flat;
  for (const Vector3d& p : scene.tissue.particles) flat.extend(p);
  const std::vector<PinchCircle> pinches =
      pinches_of(made.track, scene, made.grasp, flat.sizes().maxCoeff());
  made.pinched = !pinches.empty();
  if (made.pinched) {
    made.pinch = pinches.front().centre - pinches.front().displaced;
  } else if (has_tool(recording)) {
    warnings.push_back(
        fmt::format("{}: the jaws close nowhere near the tissue: it is held by nothing", path));
  }
}

}  // namespace

std::vector<std::size_t> evenly_chosen(std::size_t count, std::size_t most) {
  std::vector<std::size_t> list;
  const std::size_t wanted = std::min(count, most);
  for (std::size_t k = 0; k < wanted; ++k)
    list.push_back(wanted > 1 ? k * (count - 1) / (wanted - 1) : 0);
  return list;
}

bool Observation::has_points() const {
  return std::ranges::any_of(frames, [](const SeenFrame& frame) { return !frame.points.empty(); });
}

bool Observation::has_force() const {
  return std::ranges::any_of(frames,
                             [](const SeenFrame& frame) { return frame.force.has_value(); });
}

Observation observe(const std::string& name, const std::string& path, const Recording& recording,
                    const Scene& scene, std::vector<std::string>& warnings) {
  return observe(name, path, recording, scene, {}, {}, warnings);
}

Observation observe(const std::string& name, const std::string& path, const Recording& recording,
                    const Scene& scene, const MarkerNotes& notes, const CloudChoice& chosen,
                    std::vector<std::string>& warnings) {
  Observation made = begin_observation(name, path, recording, scene, warnings);
  made.rays = made.rays && !chosen.fused;
  const CloudMask mask(scene, made.track.travel(), recording.info.registration_uncertainty_m());
  const Frames<Cloud> clouds = seen_clouds(recording);
  if (chosen.skipped > 0 && chosen.skipped >= clouds.size()) {
    throw_error("{}: {} clouds, of which {} are skipped: none is left", path, clouds.size(),
                chosen.skipped);
  }
  if (chosen.above_board) made.lowest = plane_above_board(scene, *chosen.above_board);
  for (const std::size_t chosen_cloud :
       evenly_chosen(clouds.size() - chosen.skipped, kMostFrames)) {
    const std::size_t k = chosen.skipped + chosen_cloud;
    SeenFrame frame;
    frame.t = static_cast<double>(clouds.time_ns[k]) / 1e9;
    const Cloud cloud = fetch_cloud(path, clouds, k);
    Eigen::AlignedBox3d all;
    const Vector3d tip = made.track.tip_at(frame.t);
    std::vector<Vector3d> near;
    for (const Eigen::Vector3f& point : cloud) {
      const Vector3d p = point.cast<double>();
      all.extend(p);
      const bool low = made.lowest && made.lowest->signedDistance(p) < 0;
      const CloudPart part = low ? CloudPart::kBoard : mask.part_of(p, tip);
      ++made.parts.count[static_cast<std::size_t>(part)];
      if (part == CloudPart::kTissue) near.push_back(p);
    }
    if (!(all.sizes().maxCoeff() <= kLargestCloud)) {
      throw_error("{}: the cloud at {:.6g} s is {:.3g} m across, allowed {} m: in metres?", path,
                  frame.t, all.sizes().maxCoeff(), kLargestCloud);
    }
    ++made.clouds;
    made.share_seen.push_back(mask.share_seen(near));
    for (const std::size_t i : evenly_chosen(near.size(), kMostPoints))
      frame.points.push_back(near[i]);
    if (!frame.points.empty()) made.frames.push_back(std::move(frame));
  }
  const bool seen = !made.frames.empty();
  add_markers(recording, path, notes, made, warnings);
  if (clouds.size() == 0 && made.frames.empty()) {
    throw_error(
        "{}: no cloud, needed clouds.csv, depth.csv, /cloud or /depth, and no marker on "
        "tissue, markers.csv or /markers",
        path);
  }
  if (clouds.size() > 0 && !seen) {
    throw_error(
        "{}: no point of a cloud that can be tissue at rest or moved ({}): in metres, in W?", path,
        print_parts(made.clouds, made.parts));
  }
  add_forces(recording, path, made, warnings);
  if (made.held && !has_tool(recording))  // it rests until then
    made.track.time.front() = std::max(made.track.begin(), made.frames.front().t);
  cut_track(made.frames.back().t + kMargin, made.track);
  find_pinch(recording, path, scene, made, warnings);
  return made;
}

Observation observe_commands(const std::string& name, const std::string& path,
                             const Recording& recording, const Scene& scene,
                             std::span<const double> times, std::vector<std::string>& warnings) {
  Observation made = begin_observation(name, path, recording, scene, warnings);
  for (const double t : times) made.frames.push_back({t, {}, {}, {}});
  if (!times.empty()) cut_track(times.back() + kMargin, made.track);
  find_pinch(recording, path, scene, made, warnings);
  return made;
}

Observation stretched(const Observation& observation, double factor) {
  Observation made = observation;
  for (double& t : made.track.time) t *= factor;
  for (SeenFrame& frame : made.frames) frame = {factor * frame.t, {}, {}, {}};
  return made;
}

void set_frame_period(const std::string& path, double period, Recording& recording) {
  const std::vector<std::int64_t>& frames =
      recording.clouds.size() > 0 ? recording.clouds.time_ns : recording.depth.time_ns;
  if (frames.size() < 2)
    throw_error("--frame-period-s: {}: {} clouds, needed 2 or more", path, frames.size());
  std::vector<std::int64_t> apart;
  for (std::size_t k = 1; k < frames.size(); ++k) apart.push_back(frames[k] - frames[k - 1]);
  const auto middle = apart.begin() + static_cast<std::ptrdiff_t>((apart.size() - 1) / 2);
  std::nth_element(apart.begin(), middle, apart.end());
  const double factor = 1e9 * period / static_cast<double>(*middle);
  const auto stretch = [&](std::vector<std::int64_t>& times) {
    for (std::int64_t& t : times) t = std::llround(factor * static_cast<double>(t));
  };
  for (auto& [topic, series] : recording.series) stretch(series.time_ns);
  stretch(recording.clouds.time_ns);
  stretch(recording.depth.time_ns);
  stretch(recording.color.time_ns);
  pb::RecordingInfo& info = recording.info;
  if (info.has_tool_rate_hz()) info.set_tool_rate_hz(info.tool_rate_hz() / factor);
  if (info.start().has_release_time_s())
    info.mutable_start()->set_release_time_s(factor * info.start().release_time_s());
}

std::vector<Observation> few_frames(std::vector<Observation> observations, std::size_t most) {
  for (Observation& seen : observations) {
    // So many clouds, and so many frames of markers.
    std::array<std::vector<std::size_t>, 2> kinds;
    for (std::size_t k = 0; k < seen.frames.size(); ++k)
      kinds[seen.frames[k].points.empty() ? 1 : 0].push_back(k);
    std::vector<std::size_t> few;
    for (const std::vector<std::size_t>& kind : kinds) {
      for (std::size_t k = 1; k <= std::min(most, kind.size()); ++k)
        few.push_back(kind[k * kind.size() / std::min(most, kind.size()) - 1]);
    }
    std::ranges::sort(few);
    std::vector<SeenFrame> left;
    for (const std::size_t k : few) left.push_back(seen.frames[k]);
    seen.frames = std::move(left);
  }
  return observations;
}

FirstFrames first_frames(std::vector<Observation> observations, double seconds, std::size_t most) {
  FirstFrames made{std::move(observations)};
  for (Observation& seen : made.observations) {
    std::vector<SeenFrame> first;
    for (const SeenFrame& frame : seen.frames) {
      if (frame.t <= seen.released + seconds) first.push_back(frame);
    }
    if (first.empty()) first.push_back(seen.frames.front());
    made.all = made.all && first.size() == seen.frames.size();
    seen.frames.clear();
    for (const std::size_t k : evenly_chosen(first.size(), most)) seen.frames.push_back(first[k]);
    cut_track(seen.frames.back().t + kMargin, seen.track);
  }
  return made;
}

void number_conditions(std::vector<Observation>& observations) {
  constexpr double kOnePlace = 0.006;  // [m]
  std::vector<Eigen::Vector2d> places;
  for (Observation& o : observations) {
    const auto found = std::find_if(places.begin(), places.end(), [&](const Eigen::Vector2d& p) {
      return (p - o.pinch).norm() < kOnePlace;
    });
    o.condition = static_cast<int>(found - places.begin());
    if (found == places.end()) places.push_back(o.pinch);
  }
}

}  // namespace omentum
