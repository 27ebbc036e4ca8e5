#include "report/sections.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "report/plot.h"
#include "report/statistics.h"

namespace omentum {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// The paper's stages of learning, in steps (paper VI-B).
const std::vector<PlotMilestone> kMilestones = {
    {0.5e6, "0.5 M approach"}, {2.0e6, "2.0 M interaction"}, {3.0e6, "3.0 M retraction"}};

std::string percent(double share, int digits = 0) {
  return std::isfinite(share) ? fmt::format("{:.{}f} %", 100 * share, digits) : "-";
}

std::string interval(const Proportion& p) {
  return fmt::format("{} to {}", percent(p.low, 1), percent(p.high, 1));
}

double last_finite(const std::vector<double>& values) {
  for (std::size_t k = values.size(); k-- > 0;) {
    if (std::isfinite(values[k])) return values[k];
  }
  return kNaN;
}

std::string missing(const std::string& text) {
  return "<p class=\"missing\">" + escape_html(text) + "</p>\n";
}

std::string card(const std::string& content) {
  return "<div class=\"card\">" + content + "</div>\n";
}

/// Names of all sets of all runs.
std::vector<std::string> set_names(const std::vector<RunFolder>& runs) {
  std::set<std::string> names;
  for (const RunFolder& run : runs) {
    for (const auto& [name, set] : run.evaluations) names.insert(name);
  }
  return {names.begin(), names.end()};
}

/// Successes (target reached) of one set over all runs.
Proportion reached_share(const std::vector<RunFolder>& runs, const std::string& name) {
  int reached = 0;
  int starts = 0;
  for (const RunFolder& run : runs) {
    const auto found = run.evaluations.find(name);
    if (found == run.evaluations.end()) continue;
    for (const EvaluationRow& start : found->second.starts) {
      reached += start.reached ? 1 : 0;
      ++starts;
    }
  }
  return wilson(reached, starts);
}

double mean_exposure(const std::vector<RunFolder>& runs, const std::string& name) {
  std::vector<double> values;
  for (const RunFolder& run : runs) {
    const auto found = run.evaluations.find(name);
    if (found == run.evaluations.end()) continue;
    for (const EvaluationRow& start : found->second.starts) values.push_back(start.exposure);
  }
  return mean_of(values);
}

/// One cell of a start grid, over the seeds.
struct GridCell {
  int runs = 0, reached = 0, held = 0, lost = 0, exposed = 0;
  double exposure = 0;  ///< mean
};

struct Grid {
  int rows = 0, columns = 0;
  std::vector<GridCell> cells;
};

Grid make_grid(const std::vector<RunFolder>& runs, const std::string& name) {
  Grid grid;
  for (const RunFolder& run : runs) {
    const auto found = run.evaluations.find(name);
    if (found == run.evaluations.end()) continue;
    grid.rows = std::clamp(found->second.rows, grid.rows, 100);
    grid.columns = std::clamp(found->second.columns, grid.columns, 100);
  }
  grid.cells.resize(static_cast<std::size_t>(grid.rows) * static_cast<std::size_t>(grid.columns));
  for (const RunFolder& run : runs) {
    const auto found = run.evaluations.find(name);
    if (found == run.evaluations.end()) continue;
    for (const EvaluationRow& start : found->second.starts) {
      if (start.row < 1 || start.row > grid.rows || start.column < 1 || start.column > grid.columns)
        continue;
      GridCell& cell =
          grid.cells[static_cast<std::size_t>((start.row - 1) * grid.columns + start.column - 1)];
      ++cell.runs;
      cell.reached += start.reached ? 1 : 0;
      cell.held += start.held ? 1 : 0;
      cell.lost += start.lost ? 1 : 0;
      cell.exposed += start.exposed ? 1 : 0;
      cell.exposure += std::isfinite(start.exposure) ? start.exposure : 0;
    }
  }
  for (GridCell& cell : grid.cells) cell.exposure /= std::max(1, cell.runs);
  return grid;
}

HeatMap grid_frame(const Grid& grid, const std::string& title) {
  HeatMap map;
  map.title = title;
  map.rows = grid.rows;
  map.columns = grid.columns;
  map.caption_top = "anchored edge, by the kidney";
  map.caption_bottom = "free edge, towards the camera";
  map.value.assign(grid.cells.size(), kNaN);
  map.text.resize(grid.cells.size());
  map.hover.resize(grid.cells.size());
  return map;
}

std::string hover_of(const Grid& grid, std::size_t k) {
  const GridCell& cell = grid.cells[k];
  const auto columns = static_cast<std::size_t>(grid.columns);
  return fmt::format(
      "start ({}, {}): exposure {:.1f} %, target reached {} of {}, tissue held {} of {}, lost {} "
      "of {}",
      k / columns + 1, k % columns + 1, 100 * cell.exposure, cell.reached, cell.runs, cell.held,
      cell.runs, cell.lost, cell.runs);
}

std::string exposure_grid(const Grid& grid, const std::string& title) {
  HeatMap map = grid_frame(grid, title);
  map.scale_label = "%";
  map.high = 100;
  for (std::size_t k = 0; k < grid.cells.size(); ++k) {
    if (grid.cells[k].runs == 0) continue;
    map.value[k] = 100 * grid.cells[k].exposure;
    map.text[k] = fmt::format("{:.0f}", map.value[k]);
    map.hover[k] = hover_of(grid, k);
  }
  if (grid.rows == 10 && grid.columns == 10) {
    map.marks = {{75, "(8, 6): exposed in the paper"}, {19, "(2, 10): not exposed in the paper"}};
  }
  return draw_heat_map(map);
}

std::string success_grid(const Grid& grid, const std::string& title) {
  int most = 1;
  for (const GridCell& cell : grid.cells) most = std::max(most, cell.runs);
  HeatMap map = grid_frame(grid, title);
  map.scale_label = "n";
  map.high = most;
  for (std::size_t k = 0; k < grid.cells.size(); ++k) {
    const GridCell& cell = grid.cells[k];
    if (cell.runs == 0) continue;
    map.value[k] = cell.reached;
    map.text[k] = most > 1 ? fmt::format("{}/{}", cell.reached, cell.runs)
                           : (cell.reached > 0 ? "yes" : "no");
    map.hover[k] = hover_of(grid, k);
  }
  return draw_heat_map(map);
}

/// Steps of a run for the abscissa: the counter in the metrics, else the row number.
std::vector<double> steps_of(const RunFolder& run) {
  std::vector<double> steps = run.metrics.numbers("charts/steps_total");
  if (steps.empty()) {
    for (std::size_t k = 0; k < run.metrics.rows.size(); ++k)
      steps.push_back(static_cast<double>(k + 1));
  }
  return steps;
}

std::string learning_chart(const std::vector<RunFolder>& runs, const std::string& title,
                           const std::string& y_label,
                           const std::vector<std::vector<double>>& values, bool percent_axis,
                           int width) {
  LineChart chart;
  chart.title = title;
  chart.x_label = "steps (decisions of 20 ms)";
  chart.y_label = y_label;
  chart.percent = percent_axis;
  chart.milestones = kMilestones;
  std::vector<Curve> curves;
  for (std::size_t k = 0; k < runs.size(); ++k) {
    if (values[k].empty()) continue;
    curves.push_back({steps_of(runs[k]), smoothed(values[k], width)});
  }
  if (curves.empty()) return "";
  if (curves.size() == 1) {
    chart.series.push_back({"", curves[0].x, curves[0].y, {}, {}, 1});
  } else {
    for (const Curve& curve : curves) chart.series.push_back({"", curve.x, curve.y, {}, {}, 0});
    Band band = band_of(curves);
    chart.series.push_back({fmt::format("mean and range of {} seeds", curves.size()), band.x,
                            band.mean, band.low, band.high, 1});
  }
  if (percent_axis) {
    double top = 0.05;
    for (const PlotSeries& series : chart.series) {
      for (const double value : series.y) top = std::isfinite(value) ? std::max(top, value) : top;
    }
    chart.y_range = {0, top > 0.5 ? 1.02 : top * 1.1};
  }
  return card(draw_line_chart(chart));
}

/// Mean reward per step: the return divided by the length of the episodes, which for the paper's
/// reward lies in
/// [-1, 0] whatever the length.
std::vector<double> reward_per_step(const RunFolder& run) {
  std::vector<double> value = run.metrics.numbers("charts/episodic_return");
  const std::vector<double> length = run.metrics.numbers("charts/episodic_length");
  for (std::size_t k = 0; k < value.size() && k < length.size(); ++k)
    value[k] = length[k] > 0 ? value[k] / length[k] : kNaN;
  return value;
}

}  // namespace

bool is_robot_set(const std::string& name) { return name.rfind("robot", 0) == 0; }

std::string describe_set(const std::string& name) {
  const std::string policy = name.find("sampled") != std::string::npos  ? "sampled actions"
                             : name.find("greedy") != std::string::npos ? "greedy actions"
                                                                        : name;
  if (is_robot_set(name)) return "25 starts of the robot, " + policy;
  if (name.rfind("grid100", 0) == 0) return "100 starts, " + policy;
  return name;
}

std::string make_overview(const std::vector<RunFolder>& runs) {
  std::vector<Tile> tiles;
  const auto mean_last = [&](const char* column) {
    std::vector<double> values;
    for (const RunFolder& run : runs) values.push_back(last_finite(run.metrics.numbers(column)));
    return mean_of(values);
  };
  const std::string seeds =
      runs.size() > 1 ? fmt::format("mean of {} seeds", runs.size()) : "one seed";
  const std::vector<std::string> names = set_names(runs);
  const auto greedy = std::find(names.begin(), names.end(), "grid100_greedy");
  const std::string set = greedy != names.end() ? *greedy : (names.empty() ? "" : names.front());
  if (!set.empty()) {
    const Proportion reached = reached_share(runs, set);
    tiles.push_back({fmt::format("{} / {}", reached.successes, reached.trials), "target reached",
                     "95 %: " + interval(reached)});
    tiles.push_back({percent(mean_exposure(runs, set)), "tumour exposed, mean", describe_set(set)});
  }
  const double steps = mean_last("charts/steps_total");
  if (std::isfinite(steps)) tiles.push_back({short_number(steps), "training steps", seeds});
  const double physics = mean_last("charts/physics_steps_total");
  if (std::isfinite(physics))
    tiles.push_back({short_number(physics), "solver substeps", "of the same training"});
  const double speed = mean_last("charts/SPS");
  if (std::isfinite(speed))
    tiles.push_back({short_number(speed), "steps per second", "training, at the end"});
  std::vector<double> rewards;
  for (const RunFolder& run : runs) rewards.push_back(last_finite(reward_per_step(run)));
  if (std::isfinite(mean_of(rewards)))
    tiles.push_back(
        {fmt::format("{:.3f}", mean_of(rewards)), "reward per step", seeds + ", last update"});
  return tiles.empty() ? "" : make_tiles(tiles);
}

Section make_learning_section(const std::vector<RunFolder>& runs) {
  Section section{"learning", "Learning", "", ""};
  section.lead = runs.size() > 1
                     ? fmt::format(
                           "Line: mean of {} seeds; shade: from the lowest to the highest; grey: "
                           "each seed. Dashed: where "
                           "the paper saw the stages of the task being learnt.",
                           runs.size())
                     : "One seed. Dashed: where the paper saw the stages of the task being learnt.";
  const auto column = [&](const char* name) {
    std::vector<std::vector<double>> values;
    for (const RunFolder& run : runs) values.push_back(run.metrics.numbers(name));
    return values;
  };
  std::vector<std::vector<double>> rewards;
  for (const RunFolder& run : runs) rewards.push_back(reward_per_step(run));
  std::string charts = learning_chart(runs, "Reward per step (the paper's figure 4)",
                                      "episode return / length", rewards, false, 3);
  charts += learning_chart(runs, "Success in training", "target reached, tissue held",
                           column("charts/success_rate"), true, 3);
  charts += learning_chart(runs, "Exposure in training", "tumour surface visible",
                           column("charts/exposure_fraction"), true, 3);
  charts += learning_chart(runs, "Speed", "steps per second", column("charts/SPS"), false, 1);
  charts +=
      learning_chart(runs, "Entropy of the policy", "nat", column("losses/entropy"), false, 1);
  charts += learning_chart(runs, "Explained variance of the value", "share",
                           column("losses/explained_variance"), false, 1);
  section.content = charts.empty() ? missing("No metrics.csv: nothing is known of the training.")
                                   : "<div class=\"row\">\n" + charts + "</div>\n";
  return section;
}

Section make_grid_section(const std::vector<RunFolder>& runs) {
  Section section{"starts", "Where the tool starts",
                  "Each cell is one start of the tool above the sheet. Exposure: share of the "
                  "tumour's visible surface seen by "
                  "the endoscope at the end of the episode (the paper's figure 5). Outlined: the "
                  "two starts the paper shows.",
                  ""};
  for (const std::string& name : set_names(runs)) {
    if (is_robot_set(name)) continue;
    const Grid grid = make_grid(runs, name);
    if (grid.cells.empty()) continue;
    const Proportion reached = reached_share(runs, name);
    section.content +=
        fmt::format("<h3>{}: target reached {} of {}, mean exposure {}</h3>\n<div class=\"row\">\n",
                    escape_html(describe_set(name)), reached.successes, reached.trials,
                    percent(mean_exposure(runs, name), 1));
    section.content += card(exposure_grid(grid, "Tumour exposed [%]"));
    section.content += card(success_grid(grid, "Target reached with tissue held"));
    section.content += "</div>\n";
  }
  if (section.content.empty()) section.content = missing("No evaluation on the start grid.");
  return section;
}

Section make_robot_section(const std::vector<RunFolder>& runs) {
  Section section{"robot", "The robot's starts",
                  "25 starts above the lower half of the sheet, where the paper tried the policy "
                  "on the real arm: 9 held, "
                  "2 lost on lifting, 14 not held (its figure 7).",
                  ""};
  for (const std::string& name : set_names(runs)) {
    if (!is_robot_set(name)) continue;
    const Grid grid = make_grid(runs, name);
    CategoryMap map;
    map.title = describe_set(name);
    map.caption_top = "towards the anchored edge";
    map.caption_bottom = "free edge, towards the camera";
    map.rows = grid.rows;
    map.columns = grid.columns;
    map.kinds = {{"held to the end", "held", "#3f8f5b", "#ffffff"},
                 {"held, then lost", "lost", "#e39a3b", "#2b1c05"},
                 {"not held", "no", "#efe3a4", "#4b4212"}};
    for (std::size_t k = 0; k < grid.cells.size(); ++k) {
      const GridCell& cell = grid.cells[k];
      // Over several seeds the cell shows what most of them did; ties go to the worse.
      const int kept = cell.held - cell.lost;
      const int lost = cell.lost;
      const int none = cell.runs - cell.held;
      int kind = -1;
      if (cell.runs > 0) kind = none >= kept && none >= lost ? 2 : (lost >= kept ? 1 : 0);
      map.kind.push_back(kind);
      map.hover.push_back(hover_of(grid, k));
    }
    section.content += card(draw_category_map(map));
    section.content += card(exposure_grid(grid, "Tumour exposed [%]"));
  }
  section.content = section.content.empty()
                        ? missing("No evaluation on the robot's grid.")
                        : "<div class=\"row\">\n" + section.content + "</div>\n";
  return section;
}

Section make_lattice_section(const std::vector<RunFolder>& runs) {
  Section section{
      "lattice", "Where to grasp",
      "No policy: the jaw closes on one particle, lifts it to the target and holds. Colour: what "
      "that exposes. "
      "It is the best any policy that lifts to this target could do by choosing its grasp.",
      ""};
  const auto run =
      std::find_if(runs.begin(), runs.end(), [](const RunFolder& r) { return !r.lattice.empty(); });
  if (run == runs.end()) {
    section.content = missing("No grasp lattice: evaluation.grasp_lattice was off.");
    return section;
  }
  PlaneMap map;
  map.title = "Exposure by grasped particle [%]";
  map.x_label = "x_B across the sheet [mm]";
  map.y_label = "y_B, anchored edge on top [mm]";
  map.scale_label = "%";
  map.y_down = true;  // anchored edge on top, as in the start grids
  double best = -1;
  int reached = 0;
  double nearest = std::numeric_limits<double>::infinity();
  for (const LatticePoint& point : run->lattice) {
    if (std::isfinite(point.exposure) && point.exposure > best) {
      best = point.exposure;
      map.best = map.x.size();
    }
    reached += point.reached ? 1 : 0;
    const LatticePoint& first = run->lattice.front();
    const double distance = std::hypot(point.x - first.x, point.y - first.y);
    if (distance > 1e-6) nearest = std::min(nearest, distance);
    map.x.push_back(1000 * point.x);
    map.y.push_back(1000 * point.y);
    map.value.push_back(100 * point.exposure);
  }
  map.high = 100;
  map.cell = std::isfinite(nearest) ? 1000 * nearest : 3;
  if (map.best) {
    map.best_label = fmt::format("best: {:.0f} %", 100 * best);
    const LatticePoint& point = run->lattice[*map.best];
    section.content = "<div class=\"row\">" + card(draw_plane_map(map));
    section.content +=
        card("<h3>Best grasp</h3>\n" +
             make_table({{"", "value"},
                         {"particle", std::to_string(point.particle)},
                         {"place in B at rest",
                          fmt::format("({:.1f}, {:.1f}) mm", 1000 * point.x, 1000 * point.y)},
                         {"exposure", percent(point.exposure, 1)},
                         {"points tried", std::to_string(run->lattice.size())},
                         {"target reached", fmt::format("{} of {}", reached, run->lattice.size())},
                         {"run", run->name}},
                        {1}));
    section.content += "</div>\n";
  }
  return section;
}

Section make_numbers_section(const std::vector<RunFolder>& runs) {
  Section section{"numbers", "Numbers",
                  "Intervals are Wilson's at 95 %. Exposed: more of the tumour visible at the end "
                  "than the evaluation's threshold.",
                  ""};
  std::vector<std::vector<std::string>> rows = {{"run", "starts", "reached", "95 % interval",
                                                 "held", "lost", "exposed", "mean exposure",
                                                 "mean return"}};
  for (const RunFolder& run : runs) {
    for (const auto& [name, set] : run.evaluations) {
      int reached = 0, held = 0, lost = 0, exposed = 0;
      std::vector<double> exposure, returns;
      for (const EvaluationRow& start : set.starts) {
        reached += start.reached ? 1 : 0;
        held += start.held ? 1 : 0;
        lost += start.lost ? 1 : 0;
        exposed += start.exposed ? 1 : 0;
        exposure.push_back(start.exposure);
        returns.push_back(start.episode_return);
      }
      const Proportion p = wilson(reached, static_cast<int>(set.starts.size()));
      rows.push_back({run.name, describe_set(name), fmt::format("{} / {}", p.successes, p.trials),
                      interval(p), std::to_string(held), std::to_string(lost),
                      std::to_string(exposed), percent(mean_of(exposure), 1),
                      fmt::format("{:.1f}", mean_of(returns))});
    }
  }
  if (rows.size() > 1) section.content += card(make_table(rows, {2, 3, 4, 5, 6, 7, 8}));
  std::vector<std::vector<std::string>> figures = {
      {"figure", "value", "unit", "command", "machine"}};
  for (const RunFolder& run : runs) {
    for (const FigureRow& figure : run.figures) {
      figures.push_back({runs.size() > 1 ? run.name + ": " + figure.name : figure.name,
                         figure.value, figure.unit, figure.command, figure.machine});
    }
  }
  if (figures.size() > 1)
    section.content += "<p></p>" + card("<h3>Figures of the run</h3>" + make_table(figures, {1}));
  if (section.content.empty()) section.content = missing("No evaluation and no figures.csv.");
  return section;
}

Section make_config_section(const std::vector<RunFolder>& runs) {
  Section section{"configuration", "Configuration", "", ""};
  for (const RunFolder& run : runs) {
    // Seeds of one experiment differ in a line or two; each is shown in full all the same.
    if (run.config_text.empty()) continue;
    section.content += fmt::format(
        "<details><summary>Resolved configuration of "
        "{}</summary><pre>{}</pre></details>\n<p></p>\n",
        escape_html(run.name), escape_html(run.config_text));
  }
  std::string warnings;
  for (const RunFolder& run : runs) {
    for (const std::string& warning : run.warnings)
      warnings += "<li>" + escape_html(run.name + ": " + warning) + "</li>\n";
  }
  if (!warnings.empty())
    section.content += "<h3>Not found or damaged</h3>\n<ul>" + warnings + "</ul>\n";
  if (section.content.empty()) section.content = missing("No config.txtpb.");
  return section;
}

}  // namespace omentum
