#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/csv.h"
#include "core/evaluation_table.h"
#include "proto/config.pb.h"

// What a run leaves on disk (docs/formats.md 1), as far as the report needs it, and figures.csv:
// name, value, unit, command, machine. Every file is optional: a missing or damaged one becomes a
// line in `warnings`, and the report says so where its picture would be.

namespace omentum {

struct EvaluationSet {
  std::vector<EvaluationRow> starts;
  std::size_t configured = 0;  ///< starts of the grid that the configuration gives; 0 = unknown
  int rows = 0, columns = 0;   ///< extent of the starts that are there
};

/// What the grasp does with one value of one of its parameters, starts of the robot grid.
struct GraspStudyPoint {
  std::string parameter, unit;
  double value = 0;
  bool shipped = false;  ///< the value of the configuration itself
  int starts = 0, held = 0, lost = 0;
};

struct FigureRow {
  std::string name, value, unit, command, machine;
};

struct RunFolder {
  std::string path, name;
  CsvTable metrics;
  std::map<std::string, EvaluationSet> evaluations;  ///< by name, without the lattice
  std::vector<EvaluationRow> lattice;                ///< one per particle
  std::vector<GraspStudyPoint> grasp_study;
  std::vector<FigureRow> figures;
  std::map<std::string, std::string> recordings;  ///< path by file name without ending
  std::uint64_t results_compared = 0;             ///< second results of a task, of summary.json
  std::string audit_mismatch;                     ///< whose results differed; empty: they agree
  std::string config_text;
  std::optional<pb::Config> config;  ///< of config_text
  std::vector<std::string> warnings;
};

/// Reads one run. Throws Error if the folder does not exist.
RunFolder load_run(const std::string& path);

/// Reads every folder given; a folder without metrics.csv whose subfolders have one stands for
/// those, in order of name. Throws Error if nothing is found.
std::vector<RunFolder> load_runs(const std::vector<std::string>& paths);

/// What the configuration of the first run that has one says of its task; empty texts otherwise.
const pb::Report& report_texts(const std::vector<RunFolder>& runs);

}  // namespace omentum
