#include "report/sections.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

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
  const std::optional<double> decision = decision_s(runs);
  chart.x_label = decision ? fmt::format("steps (decisions of {:.3g} ms)", 1e3 * *decision)
                           : std::string("steps");
  chart.y_label = y_label;
  chart.percent = percent_axis;
  for (const pb::Milestone& milestone : report_texts(runs).milestone()) {
    // One without a label only keeps its checkpoint.
    if (milestone.label().empty()) continue;
    chart.milestones.push_back({static_cast<double>(milestone.steps()), milestone.label()});
  }
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

bool is_robot_set(const std::string& name) { return name.starts_with("robot"); }

bool is_greedy_grid(const std::string& name) {
  return name.starts_with("grid") && name.ends_with("_greedy");
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
  const auto greedy = std::find_if(names.begin(), names.end(), is_greedy_grid);
  const std::string set = greedy != names.end() ? *greedy : (names.empty() ? "" : names.front());
  if (!set.empty()) {
    const EvaluationFigures f = figures_of(runs, set);
    const std::string of = describe_set(runs, set);
    tiles.push_back({fmt::format("{} / {}", f.target_reached, f.starts), "target reached",
                     fmt::format("{}; 95 %: {}", of, interval(share(f.target_reached, f.starts)))});
    tiles.push_back({fmt::format("{} / {}", f.exposed, f.starts), "exposed", of});
    tiles.push_back({percent(f.mean_exposure, 1), "mean exposure", of});
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

namespace {

/// What the columns of the table of numbers mean.
std::string meaning_of_figures(const std::vector<RunFolder>& runs) {
  double best = 0;
  for (const auto& [name, set] : runs.front().evaluations) {
    if (!set.starts.empty()) best = std::max(best, set.starts.front().best_exposure);
  }
  const std::string threshold =
      best > 0 ? fmt::format("{:.0f} % of the exposure of the best grasp of the lattice, here {}",
                             100 * kExposedShare, percent(kExposedShare * best, 1))
               : std::string(
                     "a share of what the best grasp exposes; no grasp was evaluated here, "
                     "so nothing counts as exposed");
  return fmt::format(
      "Target reached: tissue held at p_T at some step. Held: at the end of the hold. Grasp held: "
      "never lost. Exposed: reached, held, and at the end at least {}. Mean return of an "
      "evaluation: rewards of the policy until p_T is reached; of the training: of whole episodes. "
      "Intervals are Wilson's of target reached.",
      threshold);
}

}  // namespace

Section make_learning_section(const std::vector<RunFolder>& runs) {
  Section section{"learning", "Learning", "", ""};
  const pb::Report& texts = report_texts(runs);
  section.lead = runs.size() > 1
                     ? fmt::format(
                           "Line: mean of {} seeds; shade: from the lowest to the highest; "
                           "grey: each seed.",
                           runs.size())
                     : std::string("One seed.");
  double last_step = 0;
  for (const RunFolder& run : runs)
    for (const double step : steps_of(run)) last_step = std::max(last_step, step);
  const auto& milestones = texts.milestone();
  const bool drawn = std::any_of(milestones.begin(), milestones.end(), [&](const auto& m) {
    return !m.label().empty() && static_cast<double>(m.steps()) <= last_step;
  });
  if (drawn) section.lead += " " + texts.milestones();
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
                  "The same figures as in summary.json, of the same columns of evaluation/*.csv. " +
                      meaning_of_figures(runs),
                  ""};
  std::vector<std::vector<std::string>> rows = {{"run", "evaluation", "target reached",
                                                 "95 % interval", "held", "grasp held", "exposed",
                                                 "mean exposure", "mean return", "failed"}};
  const auto add = [&rows](const RunFolder& run, const std::string& name,
                           const EvaluationFigures& f, bool policy) {
    rows.push_back({run.name, name, fmt::format("{} / {}", f.target_reached, f.starts),
                    interval(share(f.target_reached, f.starts)), std::to_string(f.held),
                    std::to_string(f.grasp_held), std::to_string(f.exposed),
                    percent(f.mean_exposure, 1),
                    policy ? fmt::format("{:.1f}", f.mean_return) : std::string("-"),
                    std::to_string(f.failed)});
  };
  for (const RunFolder& run : runs) {
    for (const auto& [name, set] : run.evaluations)
      add(run, describe_set({run}, name), figures_of(set.starts), true);
    if (!run.lattice.empty()) {
      add(run, fmt::format("grasp lattice, {} grasps", run.lattice.size()), figures_of(run.lattice),
          false);
    }
  }
  if (rows.size() > 1) {
    section.content += card("<h3>Evaluation, after the training</h3>" +
                            make_table(rows, {2, 3, 4, 5, 6, 7, 8, 9}));
  }
  std::vector<std::vector<std::string>> training = {{"run", "steps", "mean return", "mean length",
                                                     "success", "mean exposure",
                                                     "results compared"}};
  for (const RunFolder& run : runs) {
    if (run.metrics.rows.empty()) continue;
    const auto last = [&run](const char* name) { return last_finite(run.metrics.numbers(name)); };
    training.push_back({run.name, fmt::format("{:.0f}", last("charts/steps_total")),
                        fmt::format("{:.1f}", last("charts/episodic_return")),
                        fmt::format("{:.1f}", last("charts/episodic_length")),
                        percent(last("charts/success_rate"), 1),
                        percent(last("charts/exposure_fraction"), 1),
                        fmt::format("{}", run.results_compared)});
  }
  if (training.size() > 1) {
    section.content += "<p></p>" + card("<h3>Training, the last 100 episodes</h3>" +
                                        make_table(training, {1, 2, 3, 4, 5, 6}));
  }
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

Section make_config_section(const std::vector<RunFolder>& runs,
                            const std::vector<std::string>& damaged) {
  Section section{"configuration", "Configuration", "", ""};
  for (const RunFolder& run : runs) {
    if (run.config_text.empty()) continue;
    section.content += fmt::format(
        "<details><summary>Resolved configuration of "
        "{}</summary><pre>{}</pre></details>\n<p></p>\n",
        escape_html(run.name), escape_html(run.config_text));
  }
  std::string warnings;
  for (const std::string& warning : damaged) warnings += "<li>" + escape_html(warning) + "</li>\n";
  if (!warnings.empty())
    section.content += "<h3>Not found or damaged</h3>\n<ul>" + warnings + "</ul>\n";
  if (section.content.empty()) section.content = missing("No config.txtpb.");
  return section;
}

}  // namespace omentum
