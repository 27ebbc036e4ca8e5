#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "report/run_folder.h"
#include "report/statistics.h"

// Parts of sections: numbers as text, frames, and statistics over the seeds.

namespace omentum {

/// 0.523 -> "52 %"; "-" for NaN.
std::string percent(double share, int digits = 0);

/// A number and its interval as people read them: kPa, mm, g, degrees and, below a second, ms
/// instead of SI, and the digits that the interval justifies, two of its width; three without one.
/// "-" for what is not finite. `unit` is SI, "1" for none.
struct ShownNumber {
  std::string value, low, high;
  std::string unit;  ///< with a blank before it; empty for none
};
ShownNumber show_number(double value, double low, double high, const std::string& unit);

/// The same in a line: "52.0 kPa (49.3 - 54.8)"; without the brackets where there is no interval.
std::string number_in_line(double value, double low, double high, const std::string& unit);

/// "96.3 % to 100.0 %"
std::string interval(const Proportion& p);

/// A count as a share with its interval.
Proportion share(std::uint64_t count, std::uint64_t of);

/// A note in the place of a picture that cannot be drawn.
std::string missing(const std::string& text);

/// A frame around markup.
std::string card(const std::string& content);

/// Cards side by side where there is room.
std::string row(const std::string& cards);

/// Names of all evaluation sets of all runs.
std::vector<std::string> set_names(const std::vector<RunFolder>& runs);

/// The starts of one evaluation set over all runs.
std::vector<EvaluationRow> starts_of(const std::vector<RunFolder>& runs, const std::string& name);

/// Figures of one set over all runs, by the function that summary.json has them from.
EvaluationFigures figures_of(const std::vector<RunFolder>& runs, const std::string& name);

/// The parameter of a set in whose scenes it alone was drawn: drawn100_<parameter>_sampled; else
/// empty.
std::string drawn_parameter(const std::string& set_name);

/// "grid100_greedy" -> "100 starts, greedy actions", or "28 of 100 starts" where rows are missing;
/// counted from the rows that are there.
std::string describe_set(const std::vector<RunFolder>& runs, const std::string& name);

/// Decisions of a run last so long [s], by its configuration; nothing without one.
std::optional<double> decision_s(const std::vector<RunFolder>& runs);

}  // namespace omentum
