#include "core/evaluation_table.h"

#include <fmt/format.h>

#include <cmath>

namespace omentum {
namespace {

std::uint32_t whole(double value) {
  return value >= 0 && value <= 1e9 ? static_cast<std::uint32_t>(value) : 0;
}

}  // namespace

EvaluationRow row_of_episode(const RolloutSegment& s) {
  EvaluationRow r;
  r.failed = s.failed != 0 || s.episode_outcome.empty();
  if (r.failed) return r;
  r.reached = static_cast<Outcome>(s.episode_outcome.front()) == Outcome::kTargetReached;
  r.lost = std::any_of(s.flags.begin(), s.flags.end(),
                       [](std::uint8_t f) { return (f & step_flag::kGraspLost) != 0; });
  r.held = s.episode_held.front() != 0;
  r.grasp_held = s.episode_grasped.front() != 0 && !r.lost;
  r.exposure = static_cast<double>(s.episode_exposure.front());
  for (std::uint32_t k = 0; k < s.steps; ++k) {
    if ((s.flags[k] & step_flag::kScripted) != 0) continue;
    ++r.length;
    r.episode_return += static_cast<double>(s.rewards[k]);
  }
  for (std::size_t k = 0; k < 3; ++k) {
    r.start[k] = static_cast<double>(s.episode_start_position_in_world_m[k]);
    r.grasp[k] = static_cast<double>(s.episode_grasp_position_in_world_m[k]);
  }
  return r;
}

bool is_exposed(const EvaluationRow& row, double best_exposure) {
  return row.reached && row.held && best_exposure > 0 &&
         row.exposure >= kExposedShare * best_exposure;
}

EvaluationFigures figures_of(std::span<const EvaluationRow> rows) {
  EvaluationFigures figures;
  figures.starts = rows.size();
  std::uint64_t exposures = 0, returns = 0;
  for (const EvaluationRow& row : rows) {
    figures.target_reached += row.reached ? 1 : 0;
    figures.held += row.held ? 1 : 0;
    figures.grasp_held += row.grasp_held ? 1 : 0;
    figures.exposed += row.exposed ? 1 : 0;
    figures.lost += row.lost ? 1 : 0;
    figures.failed += row.failed ? 1 : 0;
    // A number that is none, as a table of somebody else may hold, has no part in a mean.
    if (std::isfinite(row.exposure)) figures.mean_exposure += row.exposure, ++exposures;
    if (std::isfinite(row.episode_return)) figures.mean_return += row.episode_return, ++returns;
  }
  if (exposures > 0) figures.mean_exposure /= static_cast<double>(exposures);
  if (returns > 0) figures.mean_return /= static_cast<double>(returns);
  return figures;
}

std::optional<std::size_t> best_grasp(std::span<const EvaluationRow> lattice) {
  std::optional<std::size_t> best;
  for (std::size_t k = 0; k < lattice.size(); ++k) {
    const EvaluationRow& row = lattice[k];
    if (!row.reached || !row.held || !std::isfinite(row.exposure)) continue;
    if (!best || row.exposure > lattice[*best].exposure) best = k;
  }
  return best;
}

std::string grid_table(std::span<const EvaluationRow> rows) {
  std::string text =
      "index,row,column,start_x_m,start_y_m,start_z_m,greedy,reached,held,exposed,exposure,"
      "best_exposure,lost,return,length,grasp_x_m,grasp_y_m,grasp_z_m,failed,grasp_held,drawn\n";
  // Places come from f32, whose shortest digits they keep.
  const auto f32 = [](double value) { return static_cast<float>(value); };
  for (const EvaluationRow& r : rows) {
    text += fmt::format(
        "{},{},{},{},{},{},{:d},{:d},{:d},{:d},{},{},{:d},{},{},{},{},{},{:d},{:d},{}\n", r.index,
        r.row, r.column, f32(r.start[0]), f32(r.start[1]), f32(r.start[2]), r.greedy, r.reached,
        r.held, r.exposed, r.exposure, r.best_exposure, r.lost, r.episode_return, r.length,
        f32(r.grasp[0]), f32(r.grasp[1]), f32(r.grasp[2]), r.failed, r.grasp_held, r.drawn);
  }
  return text;
}

std::string lattice_table(std::span<const EvaluationRow> rows) {
  std::string text = "particle,x_m,y_m,z_m,exposure,reached,held,exposed,lost,failed,grasp_held\n";
  for (const EvaluationRow& r : rows) {
    text += fmt::format("{},{},{},{},{},{:d},{:d},{:d},{:d},{:d},{:d}\n", r.index, r.start[0],
                        r.start[1], r.start[2], r.exposure, r.reached, r.held, r.exposed, r.lost,
                        r.failed, r.grasp_held);
  }
  return text;
}

Result<std::vector<EvaluationRow>> read_evaluation(const CsvTable& table) {
  if (const Result<void> checked = table.require_numbers(); !checked)
    return Failure{checked.error()};
  const bool lattice = table.column("particle").has_value();
  for (const char* column : {lattice ? "particle" : "index", "exposure", "reached"}) {
    if (!table.column(column))
      return Failure{fmt::format("{}:{}: no column {}", table.path, table.header_line, column)};
  }
  std::vector<EvaluationRow> rows(table.rows.size());
  for (std::size_t k = 0; k < rows.size(); ++k) {
    EvaluationRow& r = rows[k];
    const auto number = [&](const char* column) { return table.number(k, column); };
    const auto flag = [&](const char* column) { return number(column) > 0; };
    r.index = whole(number(lattice ? "particle" : "index"));
    r.row = whole(number("row"));
    r.column = whole(number("column"));
    r.start = {number(lattice ? "x_m" : "start_x_m"), number(lattice ? "y_m" : "start_y_m"),
               number(lattice ? "z_m" : "start_z_m")};
    r.greedy = flag("greedy");
    r.reached = flag("reached");
    // Of the lattice older tables hold `reached` alone, which meant reached and held.
    r.held = table.column("held") ? flag("held") : r.reached;
    r.exposed = flag("exposed");
    r.lost = flag("lost");
    r.failed = flag("failed");
    r.exposure = number("exposure");
    r.best_exposure = table.column("best_exposure") ? number("best_exposure") : 0;
    r.episode_return = lattice ? 0 : number("return");
    r.length = whole(number("length"));
    r.grasp = {number("grasp_x_m"), number("grasp_y_m"), number("grasp_z_m")};
    const bool grasped = lattice ? r.held : std::isfinite(r.grasp[0]);
    if (table.column("drawn")) r.drawn = number("drawn");
    r.grasp_held = table.column("grasp_held") ? flag("grasp_held") : grasped && !r.lost;
  }
  if (lattice && !table.column("exposed")) {
    const std::optional<std::size_t> best = best_grasp(rows);
    for (EvaluationRow& r : rows) r.exposed = best && is_exposed(r, rows[*best].exposure);
  }
  return rows;
}

}  // namespace omentum
