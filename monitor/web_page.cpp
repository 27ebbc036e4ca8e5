#include "monitor/web_page.h"

#include <fmt/core.h>

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/config.h"
#include "monitor/robot_figures.h"
#include "monitor/top.h"
#include "monitor/web_script.h"
#include "report/html.h"
#include "report/plot.h"
#include "report/replay3d.h"

namespace omentum {
namespace {

constexpr std::size_t kMaxDrawnPoints = 300;  // of a curve 372 px wide

constexpr const char* kStyle = R"(<style>
#alarms ul { list-style: none; padding: 0; margin: 0 0 24px; }
#alarms li { border-left: 4px solid var(--mark); background: var(--card); padding: 8px 14px; margin: 0 0 8px;
  border-radius: 6px; box-shadow: var(--shadow); overflow-wrap: anywhere; }
#alarms p { color: var(--muted); margin: 0 0 24px; }
#link { color: var(--mark); font-weight: 640; }
.controls input[type=number] { font: inherit; width: 6em; background: var(--card); color: var(--ink);
  border: 1px solid var(--rule); border-radius: 8px; padding: 5px 8px; }
.view { max-width: 820px; }
.view .controls { margin: 0 0 14px; }
</style>)";

std::string text_of(double value, int digits) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, digits) : "-";
}

/// The first unit alone: a tile has no room for two.
std::string tile_duration(double seconds) {
  const std::string text = short_duration(seconds);
  const std::size_t second = text.find(' ', text.find(' ') + 1);
  return text.substr(0, second);
}

std::string tiles_of(const RunState& state, std::int64_t now_ns) {
  if (!state.learner()) {
    return make_tiles({{"waiting", "learner", "none of this run has spoken yet"},
                       {std::to_string(state.workers().size()), "workers", ""}});
  }
  const LearnerStatus& l = *state.learner();
  const std::optional<double> left = seconds_left(l);
  const Presence presence = state.learner_presence(now_ns);
  double worker_steps = 0;
  std::size_t alive = 0;
  for (const auto& [id, row] : state.workers()) {
    if (RunState::presence_of(row, now_ns) != Presence::kAlive) continue;
    worker_steps += row.status.steps_per_s;
    ++alive;
  }
  return make_tiles(
      {{presence == Presence::kAlive ? name_of(l.phase) : name_of(presence), "learner",
        fmt::format("epoch {}, policy {}", l.learner_epoch, l.policy_version)},
       {l.steps_wanted > 0 ? text_of(100 * share_done(l), 1) + " %"
                           : short_number(static_cast<double>(l.steps_total)),
        l.steps_wanted > 0 ? "done" : "steps",
        l.steps_wanted > 0
            ? fmt::format("{} of {} steps", short_number(static_cast<double>(l.steps_total)),
                          short_number(static_cast<double>(l.steps_wanted)))
            : ""},
       {left ? tile_duration(*left) : "-", "left", "at the mean rate of the learner"},
       {short_number(std::round(l.steps_per_s)), "steps/s",
        "taken in, mean since the learner began"},
       {std::to_string(alive), "workers",
        fmt::format("{} steps/s together in the last half second",
                    short_number(std::round(worker_steps)))},
       {std::isfinite(l.mean_return) ? fmt::format("{:.3g}", l.mean_return) : "-", "mean return",
        fmt::format("length {} steps", text_of(l.mean_length, 0))},
       {balance_of(l).balanced() ? "ok" : "WRONG", "ledger",
        fmt::format("{} grants, {} outstanding", l.granted, l.outstanding)}});
}

std::string alarms_markup(const std::vector<std::string>& alarms) {
  if (alarms.empty()) return "<p>No alarm holds.</p>";
  std::string html = "<ul>";
  for (const std::string& alarm : alarms) html += "<li>" + escape_html(alarm) + "</li>";
  return html + "</ul>";
}

std::string workers_markup(const RunState& state, std::int64_t now_ns) {
  std::vector<std::vector<std::string>> rows = {{"worker", "host", "pid", "phase", "steps/s",
                                                 "versions behind", "lanes", "tasks", "segments",
                                                 "warnings"}};
  for (const auto& [id, row] : state.workers()) {
    const WorkerStatus& w = row.status;
    const Presence presence = RunState::presence_of(row, now_ns);
    std::string warnings;
    for (const std::string& warning : w.warnings)
      warnings += (warnings.empty() ? "" : "; ") + warning;
    rows.push_back({std::to_string(id), w.host, std::to_string(w.pid),
                    presence == Presence::kAlive ? name_of(w.phase) : name_of(presence),
                    text_of(w.steps_per_s, 0), std::to_string(version_lag(state, w)),
                    std::to_string(w.lanes), std::to_string(w.tasks_in_progress),
                    std::to_string(w.segments_published), warnings});
  }
  return make_table(rows, {2, 4, 5, 6, 7, 8});
}

std::string robots_markup(const RunState& state, std::int64_t now_ns) {
  std::string html;
  for (const auto& [id, row] : state.robots()) {
    std::vector<std::vector<std::string>> rows = {{"robot", describe_robot(row, now_ns)}};
    for (const RobotFigure& figure : robot_figures(row.status))
      rows.push_back({figure.name, figure.text});
    html += make_table(rows, {});
  }
  return html.empty() ? "<p>None speaks.</p>" : html;
}

std::string ledger_markup(const RunState& state) {
  if (!state.learner()) return "";
  std::vector<std::vector<std::string>> rows(2);
  std::vector<std::size_t> numeric;
  for (const LedgerCounter& counter : kLedgerCounters) {
    if (counter.value == &Ledger::evaluated || counter.value == &Ledger::failed) continue;
    numeric.push_back(rows[0].size());
    rows[0].emplace_back(counter.name);
    rows[1].push_back(std::to_string((*state.learner()).*counter.value));
  }
  return make_table(rows, numeric);
}

std::string curve(const RunState& state, const char* title, double CurvePoint::*value) {
  LineChart chart;
  chart.title = title;
  chart.x_label = "steps";
  PlotSeries series;
  const std::vector<CurvePoint>& points = state.curve();
  const std::size_t stride = points.size() / kMaxDrawnPoints + 1;
  // Counted from the newest on, so that the end is always there.
  for (std::size_t k = points.size(); k > 0; k = k > stride ? k - stride : 0) {
    series.x.insert(series.x.begin(), static_cast<double>(points[k - 1].steps));
    series.y.insert(series.y.begin(), points[k - 1].*value);
  }
  chart.series.push_back(std::move(series));
  return "<div class=\"card\">" + draw_line_chart(chart) + "</div>";
}

std::string dump(const nlohmann::ordered_json& json) {
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

std::string view_markup(const LiveScene& scene) {
  if (!scene.skin) return "<div class=\"missing\">" + escape_html(scene.problem) + "</div>";
  return "<div class=\"view\"><div class=\"controls\"><label>slot <input id=\"slot\" "
         "type=\"number\" "
         "min=\"0\" value=\"0\"></label><label>frames/s <input id=\"hz\" type=\"number\" min=\"1\" "
         "max=\"" +
         fmt::format("{:.0f}", kMaxFramesHz) +
         "\" value=\"10\"></label><button id=\"watch\" type=\"button\">Watch</button>"
         "<span id=\"watching\"></span></div>" +
         scene.markup + "</div>";
}

}  // namespace

LiveScene make_live_scene(const RunManifest& manifest) {
  LiveScene live;
  live.config_hash = manifest.config_hash;
  try {
    const pb::Config config = parse_config("manifest", manifest.config_text);
    const Scene scene = make_scene(config.scene(), scene_directory(config));
    live.markup = make_live_markup(scene);
    if (live.markup.empty()) throw_error("the surface has more than 65,535 vertices");
    live.points = scene.points();
    live.skin = std::make_unique<SurfaceSkin>(scene.tissue);
  } catch (const Error& error) {
    live.problem = fmt::format("No 3-D view: {}", error.what());
  }
  return live;
}

std::string make_monitor_page(const std::string& run, const LiveScene& scene) {
  const std::vector<Section> sections = {
      {"curves-section", "Learning", "", "<div class=\"row\" id=\"curves\"></div>"},
      {"view-section", "One environment, live",
       "Positions as the worker that computes the slot publishes them, from its next task on.",
       view_markup(scene)},
      {"workers-section", "Workers", "", "<div id=\"workers\"></div>"},
      {"robots-section", "Robots", "Positions in the world frame.", "<div id=\"robots\"></div>"},
      {"ledger-section", "Ledger", "Every grant and every segment has exactly one fate.",
       "<div id=\"ledger\"></div>"}};
  return make_page(
      "Run " + run, "Live, from the bus",
      std::string(kStyle) +
          "<p id=\"link\" role=\"status\"></p><div id=\"tiles\"></div><div id=\"alarms\" "
          "role=\"status\"></div>",
      sections, (scene.skin ? replay_script() : std::string()) + monitor_script(),
      "Made by <code>omentum monitor</code>; it only looks. Figures for Prometheus: <a "
      "href=\"metrics\">/metrics</a>.");
}

std::string make_state_json(const RunState& state, const LiveScene& scene, std::int64_t now_ns) {
  return dump({{"scene", fmt::format("{:016x}", scene.config_hash)},
               {"slots", state.manifest() ? state.manifest()->slots : 0},
               {"markup",
                {{"tiles", tiles_of(state, now_ns)},
                 {"alarms", alarms_markup(alarms_of(state, now_ns))},
                 {"workers", workers_markup(state, now_ns)},
                 {"robots", robots_markup(state, now_ns)},
                 {"ledger", ledger_markup(state)}}}});
}

std::string make_curves_json(const RunState& state) {
  std::string charts;
  if (state.curve().size() < 2) {
    charts = "<div class=\"missing\">The first two updates are yet to come.</div>";
  } else {
    charts = curve(state, "Mean return", &CurvePoint::mean_return) +
             curve(state, "Episode length [steps]", &CurvePoint::mean_length) +
             curve(state, "Entropy", &CurvePoint::entropy) +
             curve(state, "KL to the policy before", &CurvePoint::approx_kl) +
             curve(state, "Explained variance", &CurvePoint::explained_variance) +
             curve(state, "Steps/s", &CurvePoint::steps_per_s);
  }
  return dump({{"steps", state.curve().empty() ? 0 : state.curve().back().steps},
               {"markup", {{"curves", charts}}}});
}

std::string make_frame_json(const NumberedFrame& numbered, const LiveScene& scene) {
  const SimFrame& frame = numbered.frame;
  const std::vector<float>& particles = frame.particle_positions_in_world_m;
  if (!scene.skin || particles.size() != 3 * scene.points) return {};
  const std::vector<float> vertices =
      scene.skin->apply(std::span(particles).first(3 * scene.skin->particles()));
  std::string bytes(vertices.size() * sizeof(float), '\0');
  std::memcpy(bytes.data(), vertices.data(), bytes.size());
  return dump({{"number", numbered.number},
               {"positions", base64(bytes)},
               {"tool", frame.tool_position_in_world_m},
               {"held", frame.grasped ? 1 : 0},
               {"note", fmt::format("slot {} · policy {} · episode {} · {:.2f} s{}", frame.slot,
                                    frame.policy_version, frame.episode, frame.sim_time_s,
                                    frame.grasped ? " · held" : "")}});
}

}  // namespace omentum
