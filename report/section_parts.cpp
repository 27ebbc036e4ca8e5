#include "report/section_parts.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "core/constants.h"
#include "report/html.h"

namespace omentum {

std::string percent(double share, int digits) {
  return std::isfinite(share) ? fmt::format("{:.{}f} %", 100 * share, digits) : "-";
}

ShownNumber show_number(double value, double low, double high, const std::string& unit) {
  struct Unit {
    const char *si, *shown;
    double factor;
  };
  static constexpr Unit kUnits[] = {
      {"Pa", " kPa", 1e-3},         {"m", " mm", 1e3},       {"kg", " g", 1e3},
      {"rad", " deg", 1 / kDegree}, {"m/s", " mm/s", 1e3},   {"m/N", " mm/N", 1e3},
      {"m2", " mm2", 1e6},          {"m2/N", " mm2/N", 1e6}, {"N/m2", " N/m per m", 1},
      {"N/m3", " kPa/mm", 1e-6},    {"s", " ms", 1e3},       {"1", "", 1}};
  const auto is_long = [](double time) { return std::isfinite(time) && std::fabs(time) >= 1; };
  const bool seconds = unit == "s" && (is_long(value) || is_long(low) || is_long(high));
  const auto* found = seconds ? std::end(kUnits) : std::ranges::find(kUnits, unit, &Unit::si);
  const double factor = found == std::end(kUnits) ? 1 : found->factor;
  const double width = factor * (high - low);
  const auto text = [&](double si) -> std::string {
    const double number = factor * si;
    if (!std::isfinite(number)) return "-";
    if (!(width > 0) || !std::isfinite(width)) return fmt::format("{:.3g}", number);
    const int last = static_cast<int>(std::floor(std::log10(width))) - 1;  // of the digits, 10^last
    const double step = std::pow(10.0, last);
    if (last < -4) return fmt::format("{:.4g}", std::round(number / step) * step);
    return fmt::format("{:.{}f}", std::round(number / step) * step, std::max(0, -last));
  };
  return {text(value), text(low), text(high),
          found == std::end(kUnits) ? " " + unit : found->shown};
}

std::string number_in_line(double value, double low, double high, const std::string& unit) {
  const ShownNumber shown = show_number(value, low, high, unit);
  if (!std::isfinite(low) || !std::isfinite(high)) return shown.value + shown.unit;
  return fmt::format("{}{} ({} - {})", shown.value, shown.unit, shown.low, shown.high);
}

std::string interval(const Proportion& p) {
  return fmt::format("{} to {}", percent(p.low, 1), percent(p.high, 1));
}

Proportion share(std::uint64_t count, std::uint64_t of) {
  return wilson(static_cast<int>(count), static_cast<int>(of));
}

std::string missing(const std::string& text) {
  return fmt::format("<p class=\"missing\">{}</p>\n", escape_html(text));
}

std::string card(const std::string& content) {
  return fmt::format("<div class=\"card\">{}</div>\n", content);
}

std::string row(const std::string& cards) {
  return fmt::format("<div class=\"row\">\n{}</div>\n", cards);
}

std::vector<std::string> set_names(const std::vector<RunFolder>& runs) {
  std::set<std::string> names;
  for (const RunFolder& run : runs) {
    for (const auto& [name, set] : run.evaluations) names.insert(name);
  }
  return {names.begin(), names.end()};
}

std::vector<EvaluationRow> starts_of(const std::vector<RunFolder>& runs, const std::string& name) {
  std::vector<EvaluationRow> starts;
  for (const RunFolder& run : runs) {
    if (const auto set = run.evaluations.find(name); set != run.evaluations.end())
      starts.insert(starts.end(), set->second.starts.begin(), set->second.starts.end());
  }
  return starts;
}

EvaluationFigures figures_of(const std::vector<RunFolder>& runs, const std::string& name) {
  return figures_of(starts_of(runs, name));
}

std::string drawn_parameter(const std::string& name) {
  const std::size_t first = name.find('_'), last = name.rfind('_');
  if (!name.starts_with("drawn") || first == last) return "";
  return name.substr(first + 1, last - first - 1);
}

std::string describe_set(const std::vector<RunFolder>& runs, const std::string& name) {
  std::size_t there = 0, configured = 0;
  for (const RunFolder& run : runs) {
    const auto set = run.evaluations.find(name);
    if (set == run.evaluations.end()) continue;
    there += set->second.starts.size();
    configured += set->second.configured;
  }
  std::string text = configured > there ? fmt::format("{} of {} starts", there, configured)
                                        : fmt::format("{} starts", there);
  if (name.starts_with("robot")) text += " of the robot";
  if (const std::string parameter = drawn_parameter(name); !parameter.empty()) {
    text += fmt::format(", {} drawn alone", parameter);
  } else if (name.starts_with("drawn")) {
    text += " in drawn scenes";
  }
  if (name.ends_with("_sampled")) return text + ", sampled actions";
  if (name.ends_with("_greedy")) return text + ", greedy actions";
  return text + ", " + name;
}

std::optional<double> decision_s(const std::vector<RunFolder>& runs) {
  for (const RunFolder& run : runs) {
    if (!run.config) continue;
    return run.config->task().control_period_s() * run.config->task().action_repeat();
  }
  return std::nullopt;
}

}  // namespace omentum
