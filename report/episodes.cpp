#include "report/episodes.h"

#include <fmt/core.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <span>

#include "core/constants.h"
#include "report/plot.h"
#include "report/replay3d.h"
#include "report/section_parts.h"
#include "report/sections.h"
#include "report/skin.h"
#include "sim_worker/camera/camera.h"

namespace omentum {
namespace {

constexpr int kPictureWidth = 560;
constexpr int kPictureHeight = 420;
constexpr double kPictureFov = 0.60;  // [rad] the endoscope's place, closer view than its 60 deg
constexpr double kOpenJaw = 0.9, kClosedJaw = 0.05;  // [rad] as drawn

struct Candidate {
  std::string set, path;
  EvaluationRow start;
};

/// Recordings that can be read and have a row in the evaluation of the same name, best exposure
/// first.
std::vector<Candidate> candidates_of(const RunFolder& run, std::vector<std::string>& warnings) {
  std::vector<Candidate> candidates;
  std::set<std::string> without_row;
  for (const auto& [name, path] : run.recordings) {
    const Result<EpisodeRecording> recording = load_episode(path);
    if (!recording) warnings.push_back(recording.error() + ": left out");
    if (!recording) continue;
    if (!recording.value().problems.empty())
      warnings.push_back(path + ": " + recording.value().problems.front());
    without_row.insert(name);
  }
  for (const auto& [name, set] : run.evaluations) {
    for (const EvaluationRow& start : set.starts) {
      const std::string recorded = fmt::format("{}_{}", name, start.index);
      if (without_row.erase(recorded) > 0)
        candidates.push_back({name, run.recordings.at(recorded), start});
    }
  }
  for (const std::string& name : without_row)
    warnings.push_back(run.recordings.at(name) + ": no row of it in a table of evaluation/");
  // A greedy grid is what the report is about; other sets only where there is none.
  const auto of_greedy_grid = [](const Candidate& c) { return is_greedy_grid(c.set); };
  if (std::any_of(candidates.begin(), candidates.end(), of_greedy_grid))
    std::erase_if(candidates, [&](const Candidate& c) { return !of_greedy_grid(c); });
  const auto rank = [](const Candidate& c) {
    return std::isfinite(c.start.exposure) ? c.start.exposure : -1.0;
  };
  std::stable_sort(candidates.begin(), candidates.end(),
                   [&](const Candidate& a, const Candidate& b) { return rank(a) > rank(b); });
  return candidates;
}

/// A camera with what it needs to draw recorded frames.
struct Studio {
  Studio(const Scene& drawn, const Eigen::Vector3d& middle)
      : scene(drawn),
        camera(drawn, kPictureWidth, kPictureHeight),
        pose(look_at(drawn.camera.position, middle, drawn.camera.R_WC.col(1), kPictureFov)),
        skin(drawn.tissue) {}

  const Scene& scene;
  Camera camera;
  CameraPose pose;
  SurfaceSkin skin;
};

std::string draw_picture(Studio& studio, const EpisodeRecording& recording, std::size_t frame) {
  const std::size_t width = std::size_t{3} * recording.context.particles;
  const std::span<const float> points =
      std::span(recording.segment.frame_positions_in_world_m).subspan(frame * width, width);
  const std::size_t of_sheet = 3 * studio.skin.particles();
  std::vector<float> vertices = studio.skin.apply(points.first(of_sheet));
  const std::span<const float> of_body = points.subspan(of_sheet);
  vertices.insert(vertices.end(), of_body.begin(), of_body.end());
  CameraFrame picture;
  picture.tissue_vertices_W = vertices;
  const FrameState state = frame_state(recording, frame);
  const Eigen::Vector3f tip = Eigen::Vector3f::Map(state.tool_position.data());
  if (tip.allFinite()) {
    ToolPose tool;
    tool.p_WT = tip.cast<double>();
    const std::vector<RollPitchYaw> turns =
        turns_of_steps(recording.segment, recording.context.config_text);
    if (!turns.empty()) {
      const std::size_t step =
          std::min<std::size_t>(recording.frame_steps[frame], turns.size() - 1);
      tool.shaft_axis_W = rotation_of(turns[step]) * tool.shaft_axis_W;
    }
    tool.roll_rad = studio.scene.config.tool().roll_deg() * kDegree;
    tool.jaw_rad = state.held ? kClosedJaw : kOpenJaw;
    picture.tool = tool;
  }
  return base64(encode_png(studio.camera.draw_shaded(picture, studio.pose)));
}

std::string picture_row(Studio& studio, const ShownEpisode& episode, const std::string& title) {
  const EpisodeRecording& recording = episode.recording;
  const std::size_t last = recording.frame_steps.size() - 1;
  const std::optional<std::size_t> grasp = grasp_frame(recording);
  const std::pair<std::size_t, const char*> shots[] = {
      {0, "start"},
      {grasp.value_or(last / 2), grasp ? "grasp" : "half-way: nothing is held"},
      {last, "end"}};
  std::string html = fmt::format("<div class=\"episode\"><h3>{}</h3>\n<div class=\"pictures\">\n",
                                 escape_html(title + episode.label()));
  for (const auto& [frame, caption] : shots) {
    const FrameState state = frame_state(recording, frame);
    const double exposure = static_cast<double>(state.exposure);
    html += fmt::format(
        "<figure><img alt=\"{0}\" width=\"{1}\" height=\"{2}\" "
        "src=\"data:image/png;base64,{3}\"><figcaption>{0}, {4:.1f} s{5}</figcaption></figure>\n",
        escape_html(caption), kPictureWidth, kPictureHeight, draw_picture(studio, recording, frame),
        state.time,
        std::isfinite(exposure) ? fmt::format(", exposure {:.0f} %", 100 * exposure) : "");
  }
  return html + "</div></div>\n";
}

bool has_pictures(const Scene& scene, const ShownEpisode& episode) {
  return !episode.recording.frame_steps.empty() && episode.recording.context.particles > 0 &&
         episode.recording.context.particles == scene.points();
}

std::string exposure_curves(const std::vector<ShownEpisode>& episodes) {
  LineChart chart;
  chart.title = "Exposure during the episode";
  chart.x_label = "time [s]";
  chart.y_label = "tumour surface visible";
  chart.percent = true;
  chart.y_range = {0, 1.02};
  const auto add = [&](const ShownEpisode& episode, const std::string& name, int colour) {
    PlotSeries series;
    series.name = name;
    series.colour = colour;
    for (std::size_t step = 0; step < episode.recording.segment.exposures.size(); ++step) {
      series.x.push_back(static_cast<double>(step + 1) * episode.recording.context.control_period);
      series.y.push_back(static_cast<double>(episode.recording.segment.exposures[step]));
    }
    if (!series.x.empty()) chart.series.push_back(std::move(series));
  };
  for (std::size_t k = 1; k + 1 < episodes.size(); ++k) add(episodes[k], episodes[k].label(), 0);
  const auto named = [&](const char* rank, const ShownEpisode& episode) {
    return fmt::format("{}start ({}, {})", are_ranked(episodes) ? rank : "", episode.start.row,
                       episode.start.column);
  };
  if (episodes.size() > 1) add(episodes.back(), named("worst, ", episodes.back()), 2);
  if (!episodes.empty()) add(episodes.front(), named("best, ", episodes.front()), 1);
  return chart.series.empty() ? ""
                              : "<div class=\"card half\">" + draw_line_chart(chart) + "</div>\n";
}

}  // namespace

std::string ShownEpisode::label() const {
  return fmt::format("start ({}, {}): exposure {:.0f} %", start.row, start.column,
                     100 * start.exposure);
}

std::optional<std::size_t> grasp_frame(const EpisodeRecording& recording) {
  for (std::size_t frame = 0; frame < recording.frame_steps.size(); ++frame) {
    if (frame_state(recording, frame).held) return frame;
  }
  return std::nullopt;
}

bool are_ranked(const std::vector<ShownEpisode>& episodes) {
  const auto told = [](const ShownEpisode& e) { return std::lround(100 * e.start.exposure); };
  return episodes.size() > 1 && told(episodes.front()) != told(episodes.back());
}

std::vector<ShownEpisode> choose_episodes(const std::vector<RunFolder>& runs, std::size_t limit,
                                          std::vector<std::string>& warnings) {
  std::vector<ShownEpisode> episodes;
  for (const RunFolder& run : runs) {
    const std::vector<Candidate> candidates = candidates_of(run, warnings);
    const std::size_t wanted = std::min(limit, candidates.size());
    for (std::size_t k = 0; k < wanted; ++k) {
      // Evenly through the ranking, best and worst included.
      const Candidate& candidate =
          candidates[wanted > 1 ? k * (candidates.size() - 1) / (wanted - 1) : 0];
      Result<EpisodeRecording> recording = load_episode(candidate.path);
      if (recording)
        episodes.push_back({candidate.set, candidate.start, std::move(recording).value()});
    }
    if (!episodes.empty()) break;
  }
  return episodes;
}

Section make_episode_section(const std::vector<ShownEpisode>& episodes, const Scene* scene,
                             const std::vector<std::string>& warnings) {
  Section section{"episodes", "Episodes",
                  "Recorded episodes of the evaluation, drawn from their frames by the simulated "
                  "endoscope, closer than its own view.",
                  ""};
  if (!warnings.empty()) {
    section.content +=
        missing(fmt::format("Of the recordings: {}{}", warnings.front(),
                            warnings.size() > 1 ? fmt::format(" (and {} more, listed below under "
                                                              "Configuration)",
                                                              warnings.size() - 1)
                                                : ""));
  }
  if (episodes.empty()) {
    section.content += missing(warnings.empty() ? "No recordings." : "No recording can be shown.");
    return section;
  }
  const bool ranked = are_ranked(episodes);
  if (episodes.size() > 1 && !ranked) {
    section.lead +=
        fmt::format(" All {} looked at end with the same exposure: none is best.", episodes.size());
  }
  if (scene != nullptr && has_pictures(*scene, episodes.front())) {
    Studio studio(*scene, scene->tissue.X_WB.translation() + Eigen::Vector3d(0.010, -0.002, 0.012));
    section.content += picture_row(studio, episodes.front(), ranked ? "Best: " : "");
    if (episodes.size() > 1 && has_pictures(*scene, episodes.back())) {
      section.content += picture_row(studio, episodes.back(), ranked ? "Worst: " : "");
    }
  }
  section.content += exposure_curves(episodes);
  return section;
}

Section make_replay_section(const std::vector<ShownEpisode>& episodes, const Scene* scene) {
  const bool ranked = are_ranked(episodes);
  Section section{"replay", "Replay",
                  std::string(ranked ? "The best and the worst recorded episode side by side; "
                                       "others can be chosen. "
                                     : "Recorded episodes; others can be chosen. ") +
                      "Simulated positions, not an animation.",
                  ""};
  if (scene == nullptr || episodes.empty()) {
    section.content = missing("No recordings, or no configuration to draw the scene from.");
    return section;
  }
  std::vector<ReplayEpisode> shown{
      {(ranked ? "best, " : "") + episodes.front().label(), &episodes.front().recording}};
  if (episodes.size() > 1) {
    shown.push_back(
        {(ranked ? "worst, " : "") + episodes.back().label(), &episodes.back().recording});
  }
  // Two more from the middle: each costs up to 0.9 MB of the page.
  for (const std::size_t k : {episodes.size() / 3, 2 * episodes.size() / 3}) {
    if (k > 0 && k + 1 < episodes.size())
      shown.push_back({episodes[k].label(), &episodes[k].recording});
  }
  section.content = make_replay_markup(*scene, shown);
  return section;
}

}  // namespace omentum
