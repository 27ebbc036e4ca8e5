#include "report/replay3d.h"

#include <fmt/core.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <span>
#include <utility>

#include "core/constants.h"
#include "report/html.h"
#include "report/section_parts.h"
#include "report/skin.h"

namespace omentum {
namespace {

constexpr std::size_t kMaxFrames = 120;
constexpr double kBoardHeight = -0.0005;  // [m] under bodies standing on z = 0: no flicker

const char* kind_of(pb::BodyRole role) {
  switch (role) {
    case pb::ROLE_TUMOUR:
      return "tumour";
    case pb::ROLE_OBSTACLE:
      return "obstacle";
    case pb::ROLE_BOARD:
      return "board";
    case pb::ROLE_ORGAN:
      break;
  }
  return "organ";
}

/// Maps the box of the scene to int16 per axis.
class Quantiser {
 public:
  explicit Quantiser(const Eigen::AlignedBox3d& box) : low_(box.min()), size_(box.sizes()) {}

  void add(const Eigen::Vector3d& p) {
    for (int axis = 0; axis < 3; ++axis) {
      const double place = (p[axis] - low_[axis]) / size_[axis];
      const double share = std::isfinite(place) ? std::clamp(place, 0.0, 1.0) : 0;
      const auto value = static_cast<std::int16_t>(std::lround(share * 65535) - 32768);
      std::array<char, 2> raw{};
      std::memcpy(raw.data(), &value, 2);
      bytes_.append(raw.data(), 2);
    }
  }
  void add(std::span<const float> positions) {
    for (std::size_t k = 0; k + 2 < positions.size(); k += 3) {
      add(Eigen::Vector3f(positions[k], positions[k + 1], positions[k + 2]).cast<double>());
    }
  }
  /// What was added so far, as base64; starts anew.
  std::string take() {
    std::string text = base64(bytes_);
    bytes_.clear();
    return text;
  }

 private:
  Eigen::Vector3d low_, size_;
  std::string bytes_;
};

using Json = nlohmann::ordered_json;

Json json_triangles(const std::vector<Eigen::Vector3i>& triangles) {
  Json out = Json::array();
  for (const Eigen::Vector3i& t : triangles) {
    for (int corner = 0; corner < 3; ++corner) out.push_back(t[corner]);
  }
  return out;
}

Json json_point(const Eigen::Vector3d& p) { return {p.x(), p.y(), p.z()}; }

/// To 1 / `parts`, so that the text is short.
double rounded(double value, double parts) { return std::round(value * parts) / parts; }

/// The text of a document inside a script element, which nothing in it may end.
std::string script_text(const Json& json) {
  std::string text;
  for (const char c : json.dump(-1, ' ', false, Json::error_handler_t::replace)) {
    if (c == '<') {
      text += "\\u003c";  // stands in strings only
    } else {
      text += c;
    }
  }
  return text;
}

/// The surface of a body in W with few enough triangles for a web page.
TriangleMesh page_mesh(const RigidShape& body) {
  TriangleMesh mesh;
  switch (body.kind) {
    case RigidShape::Kind::kSphere:
    case RigidShape::Kind::kEllipsoid:
      mesh = make_ellipsoid_mesh(body.size, 23, 36);
      break;
    case RigidShape::Kind::kBox:
      mesh = make_box_mesh(body.size);
      break;
    case RigidShape::Kind::kMesh:
      if (body.surface.vertices.size() <= 65535) mesh = body.surface;  // indices are 16 bits wide
      break;
    case RigidShape::Kind::kHalfSpace:
      break;
  }
  for (Eigen::Vector3d& p : mesh.vertices) p = body.X_WS * p;
  return mesh;
}

TriangleMesh board_mesh(const Scene& scene) {
  const Eigen::Vector3d low = scene.workspace_min - Eigen::Vector3d::Constant(0.02);
  const Eigen::Vector3d high = scene.workspace_max + Eigen::Vector3d::Constant(0.02);
  TriangleMesh mesh;
  constexpr int kCells = 12;  // small faces, so that the 2-D fallback can sort them by depth
  for (int j = 0; j <= kCells; ++j) {
    for (int i = 0; i <= kCells; ++i) {
      mesh.vertices.emplace_back(low.x() + (high.x() - low.x()) * i / kCells,
                                 low.y() + (high.y() - low.y()) * j / kCells, kBoardHeight);
      if (i == kCells || j == kCells) continue;
      const int k = i + (kCells + 1) * j;
      mesh.triangles.emplace_back(k, k + 1, k + kCells + 2);
      mesh.triangles.emplace_back(k, k + kCells + 2, k + kCells + 1);
    }
  }
  return mesh;
}

/// What of a scene does not move, or is drawn at rest.
struct StillBodies {
  std::vector<TriangleMesh> meshes;
  std::vector<std::string> kinds;
};

StillBodies still_bodies(const Scene& scene) {
  StillBodies still{{board_mesh(scene)}, {"board"}};
  for (const RigidShape& body : scene.bodies) {
    TriangleMesh mesh = page_mesh(body);
    if (mesh.triangles.empty()) continue;
    still.meshes.push_back(std::move(mesh));
    still.kinds.emplace_back(kind_of(body.role));
  }
  if (scene.soft_body) {
    TriangleMesh mesh{{}, scene.soft_body->body.surface_triangles};
    for (const Eigen::Vector3d& p : scene.soft_body->body.particles)
      mesh.vertices.push_back(scene.soft_body->body.X_WB * p);
    still.meshes.push_back(std::move(mesh));
    still.kinds.emplace_back(kind_of(scene.soft_body->role));
  }
  return still;
}

/// Everything of the page's data but the episodes.
Json scene_json(const Scene& scene, const StillBodies& still, const Eigen::AlignedBox3d& box,
                const SurfaceSkin& skin, Quantiser& quantiser) {
  Json bodies = Json::array();
  for (std::size_t k = 0; k < still.meshes.size(); ++k) {
    for (const Eigen::Vector3d& p : still.meshes[k].vertices) quantiser.add(p);
    bodies.push_back({{"kind", still.kinds[k]},
                      {"data", quantiser.take()},
                      {"triangles", json_triangles(still.meshes[k].triangles)}});
  }
  Eigen::AlignedBox3d rest;  // of the tissue, which the first view shows whole
  for (const Eigen::Vector3d& p : scene.tissue.particles) rest.extend(p);
  const double size = rest.diagonal().norm();
  const Eigen::Vector3d target =
      scene.tissue.X_WB * rest.center() + 0.1 * size * Eigen::Vector3d(1, -1, 1);
  return {{"low", json_point(box.min())},
          {"high", json_point(box.max())},
          {"vertices", skin.vertices()},
          {"triangles", json_triangles(scene.tissue.surface_triangles)},
          {"bodies", bodies},
          {"target", json_point(target)},
          {"yaw", 1.05},
          {"pitch", 0.52},
          {"distance", 2.8 * size},
          {"roll", scene.config.tool().roll_deg() * kDegree},
          {"speed", 2}};
}

constexpr const char* kPane =
    "<div class=\"pane\"><canvas tabindex=\"0\" role=\"img\" aria-label=\"3-D view of the episode "
    "below; arrow keys turn it, plus and minus zoom, 0 goes back to the first view\"></canvas><div "
    "class=\"over\"><select aria-label=\"episode\"{}></select><span class=\"state\"></span></div>"
    "</div>\n";
constexpr const char* kHint =
    "<p class=\"hint\">Drag to turn, wheel or pinch to zoom, double click to go back to the first "
    "view. By keyboard, in a view: arrow keys, + and -, 0.</p>\n";

/// So many of `count`, evenly chosen with first and last.
std::vector<std::size_t> evenly(std::size_t count, std::size_t most) {
  std::vector<std::size_t> list;
  const std::size_t wanted = std::min(count, most);
  for (std::size_t k = 0; k < wanted; ++k)
    list.push_back(wanted > 1 ? k * (count - 1) / (wanted - 1) : 0);
  return list;
}

struct EpisodeText {
  Json json;
  std::string block;
};

EpisodeText episode_text(const ReplayEpisode& episode, std::size_t number, const SurfaceSkin& skin,
                         Quantiser& quantiser) {
  const EpisodeRecording& recording = *episode.recording;
  const std::size_t width = std::size_t{3} * recording.context.particles;
  Json times = Json::array(), held = Json::array(), exposure = Json::array();
  const std::vector<std::size_t> frames = evenly(recording.frame_steps.size(), kMaxFrames);
  for (const std::size_t frame : frames) {
    const FrameState state = frame_state(recording, frame);
    times.push_back(rounded(state.time, 1e3));
    held.push_back(state.held ? 1 : 0);
    exposure.push_back(std::isfinite(state.exposure) ? rounded(state.exposure, 1e4) : 0.0);
    quantiser.add(skin.apply(std::span(recording.segment.frame_positions_in_world_m)
                                 .subspan(frame * width, 3 * skin.particles())));
  }
  const std::string positions = quantiser.take();
  for (const std::size_t frame : frames) quantiser.add(frame_state(recording, frame).tool_position);
  EpisodeText text;
  const std::string block = fmt::format("replay-block-{}", number);
  Json turns = Json::array();
  const std::vector<RollPitchYaw> angles =
      turns_of_steps(recording.segment, recording.context.config_text);
  for (const std::size_t frame : frames) {
    if (angles.empty()) break;
    const std::size_t step = std::min<std::size_t>(recording.frame_steps[frame], angles.size() - 1);
    for (int k = 0; k < 3; ++k) turns.push_back(rounded(angles[step][k], 1e4));
  }
  text.json = {{"label", episode.label}, {"block", block},       {"times", times},
               {"held", held},           {"exposure", exposure}, {"tool_data", quantiser.take()}};
  if (!angles.empty()) text.json["turns"] = turns;
  text.block = fmt::format("<script type=\"text/plain\" id=\"{}\">{}</script>\n", block, positions);
  return text;
}

/// Everything that will be shown lies in this box [m, W].
Eigen::AlignedBox3d extent_of(const std::vector<TriangleMesh>& meshes,
                              const std::vector<ReplayEpisode>& episodes) {
  Eigen::AlignedBox3d box;
  for (const TriangleMesh& mesh : meshes) {
    for (const Eigen::Vector3d& p : mesh.vertices) box.extend(p);
  }
  for (const ReplayEpisode& episode : episodes) {
    const auto extend = [&](const std::vector<float>& positions) {
      for (std::size_t k = 0; k + 2 < positions.size(); k += 3) {
        const Eigen::Vector3f p(positions[k], positions[k + 1], positions[k + 2]);
        if (p.allFinite()) box.extend(p.cast<double>());
      }
    };
    extend(episode.recording->segment.frame_positions_in_world_m);
    extend(episode.recording->segment.tool_positions_in_world_m);
  }
  return box;
}

bool can_show(const Scene& scene, const ReplayEpisode& episode) {
  const EpisodeRecording& recording = *episode.recording;
  return !recording.frame_steps.empty() && recording.segment.steps > 0 &&
         recording.segment.tool_positions_in_world_m.size() ==
             std::size_t{3} * recording.segment.steps &&
         recording.context.particles == scene.points();
}

}  // namespace

FrameState frame_state(const EpisodeRecording& recording, std::size_t frame) {
  const RolloutSegment& segment = recording.segment;
  FrameState state;
  state.step = recording.frame_steps[frame];
  state.time = state.step * recording.context.control_period;
  state.tool_position.fill(std::numeric_limits<float>::quiet_NaN());
  state.exposure = std::numeric_limits<float>::quiet_NaN();
  const std::size_t after =
      std::min(state.step, segment.steps);  // steps whose result the frame shows
  const std::vector<float>& tools = segment.tool_positions_in_world_m;
  if (after > 0 && 3 * after <= tools.size()) {
    std::copy_n(tools.data() + 3 * (after - 1), 3, state.tool_position.data());
  } else if (after == 0 && segment.episode_start_position_in_world_m.size() >= 3) {
    std::copy_n(segment.episode_start_position_in_world_m.data(), 3, state.tool_position.data());
  } else if (tools.size() >= 3) {
    std::copy_n(tools.data(), 3, state.tool_position.data());
  }
  if (!segment.exposures.empty()) {
    state.exposure =
        segment.exposures[std::min(after > 0 ? after - 1 : 0, segment.exposures.size() - 1)];
  }
  if (after < segment.flags.size()) {
    state.held = (segment.flags[after] & step_flag::kHeld) != 0;
  } else if (!segment.episode_held.empty()) {
    state.held = segment.episode_held[0] != 0;
  } else if (!segment.flags.empty()) {
    const std::uint8_t last = segment.flags.back();
    state.held = (last & step_flag::kHeld) != 0 && (last & step_flag::kGraspLost) == 0;
  }
  return state;
}

namespace {

/// Panes, slider and hint of a page of recorded frames.
std::string panes_and_controls(std::size_t episodes) {
  std::string html = "<div class=\"replay\">\n";
  for (int pane = 0; pane < (episodes > 1 ? 2 : 1); ++pane) html += fmt::format(kPane, "");
  html +=
      "</div>\n<div class=\"controls\"><button id=\"replay-play\" type=\"button\">Play</button>"
      "<input id=\"replay-time\" type=\"range\" min=\"0\" value=\"0\" aria-label=\"time\">"
      "<span class=\"time\" id=\"replay-clock\"></span></div>\n";
  return html + kHint;
}

}  // namespace

std::string make_replay_markup(const Scene& scene, const std::vector<ReplayEpisode>& all) {
  std::vector<ReplayEpisode> episodes;
  std::copy_if(all.begin(), all.end(), std::back_inserter(episodes),
               [&](const ReplayEpisode& episode) { return can_show(scene, episode); });
  if (episodes.empty() || SurfaceSkin(scene.tissue).vertices() > 65535) {
    return missing(
        "No recording with frames of this sheet: run the evaluation with recordings on.");
  }
  const StillBodies still = still_bodies(scene);
  const Eigen::AlignedBox3d box = extent_of(still.meshes, episodes);
  const SurfaceSkin skin(scene.tissue);
  Quantiser quantiser(box);
  Json data = scene_json(scene, still, box, skin, quantiser);
  Json shown = Json::array();
  std::string blocks;
  for (std::size_t k = 0; k < episodes.size(); ++k) {
    EpisodeText text = episode_text(episodes[k], k, skin, quantiser);
    shown.push_back(std::move(text.json));
    blocks += text.block;
  }
  std::string html = panes_and_controls(episodes.size());
  data["episodes"] = shown;
  html +=
      "<script type=\"application/json\" id=\"replay-data\">" + script_text(data) + "</script>\n";
  return html + blocks;
}

std::string make_surface_markup(const Scene& scene, const std::vector<Eigen::Vector3i>& triangles,
                                const std::vector<SurfaceReplay>& replays) {
  constexpr std::size_t kMostFrames = 30, kMostPoints = 900;
  std::vector<const SurfaceReplay*> shown;
  for (const SurfaceReplay& replay : replays) {
    if (!replay.times.empty()) shown.push_back(&replay);
  }
  if (shown.empty() || shown.front()->vertices.front().size() > 65535)
    return missing("No frame that was seen and simulated.");
  const StillBodies still = still_bodies(scene);
  Eigen::AlignedBox3d box = extent_of(still.meshes, {});
  for (const SurfaceReplay* replay : shown) {
    for (const auto* lists : {&replay->vertices, &replay->clouds}) {
      for (const auto& points : *lists) {
        for (const Eigen::Vector3d& p : points) box.extend(p);
      }
    }
    for (const Eigen::Vector3d& p : replay->tips) box.extend(p);
  }
  const SurfaceSkin skin(scene.tissue);
  Quantiser quantiser(box);
  Json data = scene_json(scene, still, box, skin, quantiser);
  data["vertices"] = shown.front()->vertices.front().size();
  data["triangles"] = json_triangles(triangles);
  data["speed"] = 1;
  Json episodes = Json::array();
  std::string blocks;
  for (std::size_t k = 0; k < shown.size(); ++k) {
    const SurfaceReplay& replay = *shown[k];
    const std::vector<std::size_t> frames = evenly(replay.times.size(), kMostFrames);
    Json times = Json::array(), held = Json::array(), exposure = Json::array(),
         notes = Json::array(), counts = Json::array();
    for (const std::size_t f : frames) {
      times.push_back(rounded(replay.times[f] - replay.times.front(), 1e3));
      held.push_back(1);
      exposure.push_back(0);
      notes.push_back(replay.notes[f]);
      for (const Eigen::Vector3d& p : replay.vertices[f]) quantiser.add(p);
    }
    const std::string positions = quantiser.take();
    for (const std::size_t f : frames) {
      const auto points = evenly(replay.clouds[f].size(), kMostPoints);
      counts.push_back(points.size());
      for (const std::size_t i : points) quantiser.add(replay.clouds[f][i]);
    }
    const std::string clouds = quantiser.take();
    for (const std::size_t f : frames) quantiser.add(replay.tips[f]);
    const std::string block = fmt::format("replay-block-{}", k);
    const std::string cloud_block = fmt::format("replay-cloud-{}", k);
    episodes.push_back({{"label", replay.label},
                        {"block", block},
                        {"times", times},
                        {"held", held},
                        {"exposure", exposure},
                        {"notes", notes},
                        {"cloud_block", cloud_block},
                        {"cloud_counts", counts},
                        {"tool_data", quantiser.take()}});
    blocks += fmt::format(
        "<script type=\"text/plain\" id=\"{}\">{}</script>\n<script type=\"text/plain\" "
        "id=\"{}\">{}</script>\n",
        block, positions, cloud_block, clouds);
  }
  data["episodes"] = episodes;
  return panes_and_controls(shown.size()) +
         "<script type=\"application/json\" id=\"replay-data\">" + script_text(data) +
         "</script>\n" + blocks;
}

std::string make_live_markup(const Scene& scene) {
  const SurfaceSkin skin(scene.tissue);
  if (skin.vertices() > 65535) return {};
  const StillBodies still = still_bodies(scene);
  std::vector<float> rest;
  Eigen::AlignedBox3d box = extent_of(still.meshes, {});
  for (const Eigen::Vector3d& p_B : scene.tissue.particles) {
    const Eigen::Vector3d p_W = scene.tissue.X_WB * p_B;
    box.extend(p_W);
    for (int axis = 0; axis < 3; ++axis) rest.push_back(static_cast<float>(p_W[axis]));
  }
  box.extend(scene.tool_start);
  Quantiser quantiser(box);
  Json data = scene_json(scene, still, box, skin, quantiser);
  quantiser.add(skin.apply(rest));
  const std::string positions = quantiser.take();
  quantiser.add(scene.tool_start);
  data["live"] = true;
  const Json episode = {{"label", "live"},
                        {"block", "replay-block-0"},
                        {"times", Json::array({0})},
                        {"held", Json::array({0})},
                        {"exposure", Json::array({0})},
                        {"note", "no frame yet"},
                        {"tool_data", quantiser.take()}};
  data["episodes"] = Json::array({episode});
  // The script's own controls choose among recorded frames.
  return "<div class=\"replay\">\n" + fmt::format(kPane, " style=\"display:none\"") +
         "</div>\n<div style=\"display:none\"><button id=\"replay-play\"></button><input "
         "id=\"replay-time\" type=\"range\"><span id=\"replay-clock\"></span></div>\n" +
         kHint + "<script type=\"application/json\" id=\"replay-data\">" + script_text(data) +
         "</script>\n<script type=\"text/plain\" id=\"replay-block-0\">" + positions +
         "</script>\n";
}

}  // namespace omentum
