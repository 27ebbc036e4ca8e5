#include "report/section_parts.h"

#include <fmt/core.h>

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

}  // namespace omentum
