#pragma once

#include <string>
#include <vector>

#include "report/run_folder.h"
#include "report/statistics.h"

// Parts of sections: numbers as text, frames, and statistics over the seeds.

namespace omentum {

/// 0.523 -> "52 %"; "-" for NaN.
std::string percent(double share, int digits = 0);

/// "96.3 % to 100.0 %"
std::string interval(const Proportion& p);

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

/// Successes (target reached) of one set over all runs.
Proportion reached_share(const std::vector<RunFolder>& runs, const std::string& name);

/// Mean exposure of one set over all runs.
double mean_exposure(const std::vector<RunFolder>& runs, const std::string& name);

}  // namespace omentum
