#include "report/sections.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "report/plot.h"
#include "report/section_parts.h"
#include "report/statistics.h"

namespace omentum {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

double last_finite(const std::vector<double>& values) {
  for (std::size_t k = values.size(); k-- > 0;) {
    if (std::isfinite(values[k])) return values[k];
  }
  return kNaN;
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
  for (const pb::Milestone& milestone : report_texts(runs).milestone())
    chart.milestones.push_back({static_cast<double>(milestone.steps()), milestone.label()});
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

/// Mean reward per step: the return divided by the length of the episodes; for the paper's reward
/// in
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
  const auto add_last = [&](const char* column, const char* label, const std::string& note) {
    const double value = mean_last(column);
    if (std::isfinite(value)) tiles.push_back({short_number(value), label, note});
  };
  add_last("charts/steps_total", "training steps", seeds);
  add_last("charts/physics_steps_total", "solver substeps", "of the same training");
  add_last("charts/SPS", "steps per second", "training, at the end");
  std::vector<double> rewards;
  for (const RunFolder& run : runs) rewards.push_back(last_finite(reward_per_step(run)));
  if (std::isfinite(mean_of(rewards)))
    tiles.push_back(
        {fmt::format("{:.3f}", mean_of(rewards)), "reward per step", seeds + ", last update"});
  return tiles.empty() ? "" : make_tiles(tiles);
}

Section make_learning_section(const std::vector<RunFolder>& runs) {
  Section section{"learning", "Learning", "", ""};
  const pb::Report& texts = report_texts(runs);
  section.lead = runs.size() > 1
                     ? fmt::format(
                           "Line: mean of {} seeds; shade: from the lowest to the highest; grey: "
                           "each seed. {}",
                           runs.size(), texts.milestones())
                     : "One seed. " + texts.milestones();
  const auto column = [&](const char* name) {
    std::vector<std::vector<double>> values;
    for (const RunFolder& run : runs) values.push_back(run.metrics.numbers(name));
    return values;
  };
  std::vector<std::vector<double>> rewards;
  for (const RunFolder& run : runs) rewards.push_back(reward_per_step(run));
  const std::string of_reward = texts.reward().empty() ? "" : " (" + texts.reward() + ")";
  std::string charts = learning_chart(runs, "Reward per step" + of_reward,
                                      "episode return / length", rewards, false, 3);
  struct Chart {
    const char *title, *y_label, *column;
    bool percent;
    int width;
  };
  for (const Chart& c : std::initializer_list<Chart>{
           {"Success in training", "target reached, tissue held", "charts/success_rate", true, 3},
           {"Exposure in training", "tumour surface visible", "charts/exposure_fraction", true, 3},
           {"Speed", "steps per second", "charts/SPS", false, 1},
           {"Entropy of the policy", "nat", "losses/entropy", false, 1},
           {"Explained variance of the value", "fraction", "losses/explained_variance", false, 1}})
    charts += learning_chart(runs, c.title, c.y_label, column(c.column), c.percent, c.width);
  section.content =
      charts.empty() ? missing("No metrics.csv: nothing is known of the training.") : row(charts);
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
