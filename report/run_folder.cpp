#include "report/run_folder.h"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "core/check.h"
#include "core/config.h"
#include "core/read_file.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

int integer(double value) { return value >= -1e9 && value <= 1e9 ? static_cast<int>(value) : 0; }

/// Starts of the grid that a set is named after.
std::size_t configured_starts(const std::optional<pb::Config>& config, const std::string& name) {
  if (!config) return 0;
  const pb::Scene& scene = config->scene();
  const bool robot = name.starts_with("robot");
  if (robot ? !scene.has_robot_grid() : !scene.has_start_grid()) return 0;
  const pb::StartGrid& grid = robot ? scene.robot_grid() : scene.start_grid();
  return std::size_t{grid.rows()} * grid.columns();
}

EvaluationSet make_set(std::vector<EvaluationRow> starts, std::size_t configured) {
  EvaluationSet set;
  set.starts = std::move(starts);
  set.configured = configured;
  for (const EvaluationRow& start : set.starts) {
    set.rows = std::max(set.rows, integer(start.row));
    set.columns = std::max(set.columns, integer(start.column));
  }
  return set;
}

std::vector<GraspStudyPoint> make_study(const CsvTable& table) {
  std::vector<GraspStudyPoint> rows;
  const std::optional<std::size_t> parameter = table.column("parameter");
  const std::optional<std::size_t> unit = table.column("unit");
  for (std::size_t k = 0; parameter && unit && k < table.rows.size(); ++k) {
    GraspStudyPoint row;
    row.parameter = table.rows[k][*parameter].text;
    row.unit = table.rows[k][*unit].text;
    row.value = table.number(k, "value");
    row.shipped = table.number(k, "shipped") > 0;
    row.starts = integer(table.number(k, "starts"));
    row.held = integer(table.number(k, "held"));
    row.lost = integer(table.number(k, "lost"));
    if (row.starts > 0) rows.push_back(row);
  }
  return rows;
}

/// A CSV file of a run; nothing, and a line in `warnings`, if it is missing or wrong. A last row
/// that a stopped writer left half done is left out and named. `text` names the columns that hold
/// no numbers.
std::optional<CsvTable> load_table(const std::string& path, const std::vector<std::string>& text,
                                   std::vector<std::string>& warnings) {
  Result<CsvTable> loaded = load_csv(path);
  if (!loaded) {
    warnings.push_back(loaded.error());
    return std::nullopt;
  }
  CsvTable table = std::move(loaded).value();
  if (const Result<void> checked = table.require_numbers(text); !checked) {
    warnings.push_back(checked.error());
    return std::nullopt;
  }
  if (!table.cut_off.empty()) warnings.push_back(table.cut_off + "; the row is left out");
  return table;
}

void load_evaluations(const fs::path& folder, RunFolder& run) {
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder / "evaluation", ignored)) {
    if (entry.path().extension() != ".csv") continue;
    const std::string name = entry.path().stem().string();
    const bool study = name == "grasp_study";
    const std::optional<CsvTable> table =
        load_table(entry.path().string(),
                   study ? std::vector<std::string>{"parameter", "unit", "study_id"}
                         : std::vector<std::string>{},
                   run.warnings);
    if (!table) continue;
    if (study) {
      run.grasp_study = make_study(*table);
      continue;
    }
    Result<std::vector<EvaluationRow>> rows = read_evaluation(*table);
    if (!rows) {
      run.warnings.push_back(rows.error());
    } else if (name == "grasp_lattice") {
      run.lattice = std::move(rows).value();
    } else {
      run.evaluations[name] =
          make_set(std::move(rows).value(), configured_starts(run.config, name));
    }
  }
}

}  // namespace

RunFolder load_run(const std::string& path) {
  const fs::path folder(path);
  if (!fs::is_directory(folder)) throw_error("{}: no such folder", path);
  RunFolder run;
  run.path = path;
  run.name = fs::weakly_canonical(folder).filename().string();
  if (!fs::exists(folder / "metrics.csv")) {
    run.warnings.emplace_back("no metrics.csv: no learning curves");
  } else if (std::optional<CsvTable> table =
                 load_table((folder / "metrics.csv").string(), {}, run.warnings)) {
    run.metrics = std::move(*table);
  }
  if (const Result<CsvTable> table = load_csv((folder / "figures.csv").string())) {
    const CsvTable& figures = table.value();
    for (const auto& row : figures.rows) {
      const auto cell = [&](const char* name) {
        const auto column = figures.column(name);
        return column ? row[*column].text : std::string();
      };
      run.figures.push_back(
          {cell("name"), cell("value"), cell("unit"), cell("command"), cell("machine")});
    }
  }
  if (const Result<std::string> text = read_file((folder / "summary.json").string())) {
    const auto summary = nlohmann::json::parse(text.value(), nullptr, false);
    if (summary.is_object()) {
      run.results_compared = summary.value("results_compared", std::uint64_t{0});
      run.audit_mismatch = summary.value("audit_mismatch", std::string());
    } else {
      run.warnings.emplace_back("summary.json is damaged");
    }
  }
  if (const Result<std::string> text = read_file((folder / "config.txtpb").string()))
    run.config_text = text.value();
  if (run.config_text.empty()) {
    run.warnings.emplace_back("no config.txtpb: no pictures and no replay");
  } else {
    try {
      run.config = parse_config((folder / "config.txtpb").string(), run.config_text);
    } catch (const Error& error) {
      run.warnings.push_back(error.what());
    }
  }
  load_evaluations(folder, run);
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder / "recordings", ignored)) {
    if (entry.path().extension() == ".mcap")
      run.recordings[entry.path().stem().string()] = entry.path().string();
  }
  return run;
}

std::vector<RunFolder> load_runs(const std::vector<std::string>& paths) {
  std::vector<RunFolder> runs;
  for (const std::string& path : paths) {
    const fs::path folder(path);
    if (!fs::is_directory(folder)) throw_error("{}: no such folder", path);
    std::vector<std::string> seeds;
    if (!fs::exists(folder / "metrics.csv")) {
      for (const auto& entry : fs::directory_iterator(folder)) {
        if (fs::exists(entry.path() / "metrics.csv")) seeds.push_back(entry.path().string());
      }
      std::sort(seeds.begin(), seeds.end());
    }
    if (seeds.empty()) seeds.push_back(path);
    for (const std::string& seed : seeds) runs.push_back(load_run(seed));
  }
  const bool nothing = std::all_of(runs.begin(), runs.end(), [](const RunFolder& run) {
    return run.metrics.rows.empty() && run.evaluations.empty() && run.recordings.empty();
  });
  if (nothing)
    throw_error("{}: neither metrics.csv nor evaluation nor recordings in it",
                paths.empty() ? "" : paths[0]);
  return runs;
}

const pb::Report& report_texts(const std::vector<RunFolder>& runs) {
  for (const RunFolder& run : runs) {
    if (run.config) return run.config->report();
  }
  return pb::Report::default_instance();
}

}  // namespace omentum
