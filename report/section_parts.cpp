#include "report/section_parts.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "report/html.h"

namespace omentum {

std::string percent(double share, int digits) {
  return std::isfinite(share) ? fmt::format("{:.{}f} %", 100 * share, digits) : "-";
}

std::string interval(const Proportion& p) {
  return fmt::format("{} to {}", percent(p.low, 1), percent(p.high, 1));
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

Proportion reached_share(const std::vector<RunFolder>& runs, const std::string& name) {
  const std::vector<EvaluationRow> starts = starts_of(runs, name);
  const auto reached = std::count_if(starts.begin(), starts.end(),
                                     [](const EvaluationRow& start) { return start.reached; });
  return wilson(static_cast<int>(reached), static_cast<int>(starts.size()));
}

double mean_exposure(const std::vector<RunFolder>& runs, const std::string& name) {
  std::vector<double> values;
  for (const EvaluationRow& start : starts_of(runs, name)) values.push_back(start.exposure);
  return mean_of(values);
}

}  // namespace omentum
