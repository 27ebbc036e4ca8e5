#include "mismatch/calibrate/calibration_page.h"

#include <fmt/format.h>

#include <cmath>

#include "mismatch/calibrate/calibration_file.h"
#include "mismatch/calibrate/number_words.h"
#include "report/html.h"
#include "report/plot.h"
#include "report/replay3d.h"
#include "report/section_parts.h"

namespace omentum {
namespace {

using Rows = std::vector<std::vector<std::string>>;

/// A path in the scene without the SI unit at its end: numbers are shown in other ones.
std::string name_of(const CalibratedNumber& n) {
  const std::string end = n.unit == "Pa" ? "_pa" : "_" + n.unit;
  return n.name.ends_with(end) ? n.name.substr(0, n.name.size() - end.size()) : n.name;
}
/// The same with words behind it, where it does not speak for itself.
std::string name_and_words(const CalibratedNumber& n) {
  return name_of(n) + named_nuisance(n.name).substr(n.name.size());
}
std::string mm(double metres) { return metres > 0 ? fmt::format("{:.2f}", 1e3 * metres) : "-"; }

struct Mean {
  double base = 0, model = 0, mean = 0, floor = 0;
  std::size_t count = 0;
};
Mean mean_of(const Calibration& c, const std::string& role) {
  Mean m;
  for (const FitRow& row : c.fit) {
    if (row.role != role || !std::isfinite(row.rmse_model + row.rmse_base)) continue;
    m.base += row.rmse_base * row.rmse_base;
    m.model += row.rmse_model * row.rmse_model;
    m.floor += row.floor * row.floor;
    m.mean += row.mean_model;
    ++m.count;
  }
  if (m.count == 0) return m;
  const auto n = static_cast<double>(m.count);
  return {std::sqrt(m.base / n), std::sqrt(m.model / n), m.mean / n, std::sqrt(m.floor / n),
          m.count};
}

std::string tiles_of(const Calibration& c) {
  std::vector<Tile> tiles;
  for (const CalibratedNumber& n : c.parameters) {
    if (n.unseen || tiles.size() > 1) continue;
    const ShownNumber shown = show_number(n.value, n.low90, n.high90, n.unit);
    const std::string name = name_of(n);
    tiles.push_back({shown.value + shown.unit, name.substr(name.rfind('.') + 1),
                     fmt::format("90 %: {} - {}", shown.low, shown.high)});
  }
  for (const std::string role : {"left_out", "held_out", "fitted"}) {
    const Mean m = mean_of(c, role);
    if (m.count == 0) continue;
    const char* words = role == "fitted"     ? "error of what was fitted"
                        : role == "left_out" ? "error of pinch points left out"
                                             : "error of what was held out";
    tiles.push_back(
        {mm(m.model) + " mm", words,
         fmt::format("rms; before {} mm, noise of the sensor {} mm", mm(m.base), mm(m.floor))});
  }
  return make_tiles(tiles);
}

std::string numbers_table(const std::vector<CalibratedNumber>& numbers) {
  Rows rows = {{"number", "unit", "value", "90 % from", "to", "believed", "90 % from", "to", ""}};
  for (const CalibratedNumber& n : numbers) {
    const ShownNumber shown = show_number(n.value, n.low90, n.high90, n.unit);
    const ShownNumber prior = show_number(n.prior_value, n.prior_low90, n.prior_high90, n.unit);
    rows.push_back({name_and_words(n), shown.unit, shown.value, shown.low, shown.high, prior.value,
                    prior.low, prior.high,
                    n.at_bound ? "at its bound"
                    : n.unseen ? "not seen"
                               : ""});
  }
  return make_table(rows, {2, 3, 4, 5, 6, 7});
}

std::string fit_table(const Calibration& c) {
  Rows rows = {{"recording", "role", "before, mm rms", "after, mm rms", "after, mm mean",
                "noise, mm", "equation 3, mm"}};
  for (const FitRow& row : c.fit) {
    rows.push_back({row.recording, row.role == "left_out" ? "pinch point left out" : row.role,
                    mm(row.rmse_base), mm(row.rmse_model), mm(row.mean_model), mm(row.floor),
                    mm(row.paper)});
  }
  return make_table(rows, {2, 3, 4, 5, 6});
}

std::string error_charts(const Calibration& c) {
  std::string cards;
  for (const ShownRecording& r : c.shown) {
    if (r.rmse_before.size() != r.times.size() || r.times.empty()) continue;
    LineChart chart;
    chart.title = r.name;
    chart.x_label = "time, s";
    chart.y_label = "mm rms";
    PlotSeries before, after;
    before.name = "before";
    before.colour = 2;
    after.name = "after";
    after.colour = 1;
    for (std::size_t k = 0; k < r.times.size(); ++k) {
      before.x.push_back(r.times[k] - r.times.front());
      after.x.push_back(r.times[k] - r.times.front());
      before.y.push_back(1e3 * r.rmse_before[k]);
      after.y.push_back(1e3 * r.rmse_after[k]);
    }
    chart.series = {before, after};
    cards += card(draw_line_chart(chart));
  }
  return row(cards);
}

std::string viewer(const Calibration& c, const std::string& folder) {
  std::vector<SurfaceReplay> replays;
  for (const ShownRecording& r : c.shown) {
    for (const bool after : {false, true}) {
      SurfaceReplay replay;
      replay.label = fmt::format("{}: {}", r.name, after ? "after" : "before");
      replay.times = r.times;
      replay.vertices = after ? r.after : r.before;
      replay.clouds = r.seen;
      replay.tips = r.tip;
      const std::vector<double>& rmse = after ? r.rmse_after : r.rmse_before;
      for (std::size_t k = 0; k < r.times.size(); ++k)
        replay.notes.push_back(k < rmse.size() ? mm(rmse[k]) + " mm rms" : "");
      replays.push_back(std::move(replay));
    }
  }
  return make_surface_markup(make_scene(c.scene, folder), c.triangles, replays);
}

std::string list_of(const std::vector<std::string>& lines) {
  std::string html = "<ul>";
  for (const std::string& line : lines) html += "<li>" + escape_html(line) + "</li>";
  return html + "</ul>";
}

std::string groups_markup(const Calibration& c) {
  Rows rows = {{"seen together", "unit", "value", "90 % from", "to", "of", "why"}};
  for (const NumberGroup& g : c.groups) {
    std::string members;
    for (const std::string& member : g.members) members += (members.empty() ? "" : ", ") + member;
    const ShownNumber shown = show_number(g.value, g.low90, g.high90, g.unit);
    rows.push_back({g.name, shown.unit, shown.value, shown.low, shown.high, members, g.text});
  }
  return make_table(rows, {2, 3, 4});
}

}  // namespace

std::string make_calibration_page(const Calibration& c, const std::string& folder) {
  std::vector<Section> sections;
  if (!c.warnings.empty())
    sections.push_back({"warnings", "Warnings", "What to look at before this scene is used.",
                        card(list_of(c.warnings))});
  sections.push_back(
      {"surface", "Recordings and simulation",
       "Cloud (blue) over the simulated surface, before and after. Any recording can be "
       "chosen in each view.",
       viewer(c, folder)});
  sections.push_back(
      {"error", "Error",
       "Distance from the points of the cloud to the simulated surface. A pinch point "
       "that was left out was predicted by a fit that had not seen it.",
       error_charts(c) + card(fit_table(c))});
  sections.push_back({"numbers", "Calibrated numbers",
                      "With intervals of 90 % and what was believed before.",
                      card(numbers_table(c.parameters))});
  sections.push_back({"groups", "What the recordings cannot part", "", card(groups_markup(c))});
  if (!c.nuisances.empty()) {
    std::string numerics =
        fmt::format("What the numerics may be off by: {} mm rms", mm(c.numerics_m));
    for (const std::string& part : c.numerics) numerics += "; " + part;
    sections.push_back(
        {"nuisances", "Nuisances and numerics", numerics + ".", card(numbers_table(c.nuisances))});
  }
  const char* const plural = c.shown.size() == 1 ? "" : "s";
  return make_page("Calibration",
                   fmt::format("method {}, {} recording{}", c.method, c.shown.size(), plural),
                   tiles_of(c), sections, replay_script(),
                   fmt::format("mismatch calibrate, {:.0f} core-seconds", c.core_seconds));
}

}  // namespace omentum
