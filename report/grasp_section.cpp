#include <fmt/core.h>

#include <algorithm>

#include "report/plot.h"
#include "report/section_parts.h"
#include "report/sections.h"

namespace omentum {
namespace {

/// Metres are shown as millimetres.
bool in_metres(const std::string& unit) { return unit == "m" || unit == "m/s/N"; }

double shown(const GraspStudyPoint& r) { return in_metres(r.unit) ? 1e3 * r.value : r.value; }

std::string shown_unit(const std::string& unit) { return in_metres(unit) ? "m" + unit : unit; }

/// "min_pinch_m" -> "min pinch": the knob's name ends with its own unit, the axis says what is
/// shown.
std::string words_of(const std::string& parameter) {
  std::string words = parameter;
  for (const char* ending : {"_m_per_s_n", "_deg_per_s", "_deg", "_m", "_n"}) {
    if (!words.ends_with(ending)) continue;
    words.resize(words.size() - std::string_view(ending).size());
    break;
  }
  std::replace(words.begin(), words.end(), '_', ' ');
  return words;
}

}  // namespace

Section make_grasp_section(const std::vector<RunFolder>& runs) {
  Section section{
      "grasp-study", "The grasp that can fail",
      "A scripted grasp from every start of the robot grid, straight down, close, straight to the "
      "target: share still held, and share lost on the way, against each parameter varied alone. "
      "The dashed line is the value of this configuration.",
      ""};
  const auto run = std::find_if(runs.begin(), runs.end(),
                                [](const RunFolder& r) { return !r.grasp_study.empty(); });
  if (run == runs.end()) {
    section.content = missing(
        "No grasp study. `sim_worker --grasp-study RUN` makes it for a configuration whose grasp "
        "can fail, and deploy/train.sh does so after the training.");
    return section;
  }
  const std::vector<GraspStudyPoint>& rows = run->grasp_study;
  std::string charts;
  for (std::size_t i = 0; i < rows.size();) {
    LineChart chart;
    PlotSeries held{"held at the target", {}, {}, {}, {}, 1};
    PlotSeries lost{"lost on the way", {}, {}, {}, {}, 2};
    const std::string parameter = rows[i].parameter;
    for (; i < rows.size() && rows[i].parameter == parameter; ++i) {
      const GraspStudyPoint& r = rows[i];
      held.x.push_back(shown(r));
      held.y.push_back(static_cast<double>(r.held) / r.starts);
      lost.x.push_back(shown(r));
      lost.y.push_back(static_cast<double>(r.lost) / r.starts);
      if (r.shipped) chart.milestones.push_back({shown(r), fmt::format("{:.3g}", shown(r))});
      chart.x_label = fmt::format("{} [{}]", words_of(parameter), shown_unit(r.unit));
    }
    chart.title = words_of(parameter);
    chart.y_label = "share of starts";
    chart.y_range = {0.0, 1.0};
    chart.percent = true;
    chart.series = {held, lost};
    charts += card(draw_line_chart(chart));
  }
  section.content = row(charts);
  return section;
}

}  // namespace omentum
