#pragma once

#include <string>
#include <vector>

#include "core/evaluation_table.h"
#include "proto/config.pb.h"

namespace omentum {

/// What happened on a robot from the starts of its grid, and what simulation says of the same
/// policy from the same starts.
struct Experiment {
  std::string title;
  std::string subtitle;  ///< mode, policy, instrument, date
  pb::StartGrid grid;
  std::vector<EvaluationRow> robot;             ///< starts done so far, by index
  std::vector<EvaluationRow> prediction;        ///< by index
  std::vector<std::vector<std::string>> facts;  ///< a table: name, value
};

/// One page, complete in itself: both grids (figure 7 of the paper), counts with intervals, starts
/// in which they differ, facts.
std::string make_experiment_page(const Experiment& experiment);

}  // namespace omentum
