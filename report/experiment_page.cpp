#include "report/experiment_page.h"

#include <fmt/format.h>

#include <algorithm>

#include "report/html.h"
#include "report/plot.h"
#include "report/section_parts.h"

namespace omentum {
namespace {

/// Index into the kinds of the picture.
int kind_of(const EvaluationRow& row) {
  if (row.failed) return 3;
  if (row.grasp_held && row.held) return 0;
  return row.held || row.lost || row.grasp_held ? 1 : 2;
}

CategoryMap grid_of(const std::string& title, const pb::StartGrid& grid,
                    const std::vector<EvaluationRow>& rows) {
  CategoryMap map;
  map.title = title;
  map.caption_top = "towards the anchored edge";
  map.caption_bottom = "free edge, towards the camera";
  map.rows = static_cast<int>(grid.rows());
  map.columns = static_cast<int>(grid.columns());
  map.kinds = {{"held to the end", "yes", "#3f8f5b", "#ffffff"},
               {"held, then lost", "lost", "#e39a3b", "#2b1c05"},
               {"not held", "no", "#efe3a4", "#4b4212"},
               {"stopped", "stop", "#b8b8b8", "#222222"}};
  map.kind.assign(static_cast<std::size_t>(map.rows) * static_cast<std::size_t>(map.columns), -1);
  map.hover.resize(map.kind.size());
  for (const EvaluationRow& row : rows) {
    if (row.index >= map.kind.size()) continue;
    map.kind[row.index] = kind_of(row);
    map.hover[row.index] =
        fmt::format("start ({}, {}) at {:.1f}, {:.1f}, {:.1f} mm: {} decisions, target {}", row.row,
                    row.column, 1000 * row.start[0], 1000 * row.start[1], 1000 * row.start[2],
                    row.length, row.reached ? "reached" : "not reached");
  }
  return map;
}

std::string counts_of(const Experiment& e) {
  const auto line = [](const std::string& name, const std::vector<EvaluationRow>& rows) {
    std::array<std::uint64_t, 4> count{};
    std::uint64_t reached = 0;
    for (const EvaluationRow& row : rows) {
      ++count[static_cast<std::size_t>(kind_of(row))];
      reached += row.reached ? 1 : 0;
    }
    const auto cell = [&](std::uint64_t n) {
      return rows.empty()
                 ? std::string("-")
                 : fmt::format("{} of {} ({})", n, rows.size(), interval(share(n, rows.size())));
    };
    return std::vector<std::string>{name, cell(count[0]), cell(count[1]), cell(count[2]),
                                    cell(reached)};
  };
  return make_table({{"", "held to the end", "held, then lost", "not held", "target reached"},
                     line("robot", e.robot),
                     line("simulation", e.prediction)},
                    {1, 2, 3, 4});
}

/// Starts whose end differs, by name.
std::string differences_of(const Experiment& e) {
  const std::array<const char*, 4> names = {"held to the end", "held, then lost", "not held",
                                            "stopped"};
  std::vector<std::vector<std::string>> rows = {{"start", "robot", "simulation"}};
  for (const EvaluationRow& robot : e.robot) {
    const auto told = std::find_if(e.prediction.begin(), e.prediction.end(),
                                   [&](const EvaluationRow& r) { return r.index == robot.index; });
    if (told == e.prediction.end() || kind_of(*told) == kind_of(robot)) continue;
    rows.push_back({fmt::format("({}, {})", robot.row, robot.column),
                    names[static_cast<std::size_t>(kind_of(robot))],
                    names[static_cast<std::size_t>(kind_of(*told))]});
  }
  if (rows.size() == 1) return "<p>Every start ended as simulation says.</p>";
  return make_table(rows, {});
}

}  // namespace

std::string make_experiment_page(const Experiment& e) {
  std::uint64_t as_told = 0;
  for (const EvaluationRow& robot : e.robot) {
    as_told += std::count_if(e.prediction.begin(), e.prediction.end(), [&](const EvaluationRow& r) {
      return r.index == robot.index && kind_of(r) == kind_of(robot);
    });
  }
  const auto held = static_cast<std::uint64_t>(std::count_if(
      e.robot.begin(), e.robot.end(), [](const EvaluationRow& r) { return kind_of(r) == 0; }));
  const std::string of = fmt::format("of {}", e.robot.size());
  const std::vector<Section> sections = {
      {"starts", "Where the tool starts",
       "Each cell is one start of the tool above the sheet; its colour says what became of the "
       "tissue in the jaw.",
       row(card(draw_category_map(grid_of("On the robot", e.grid, e.robot))) +
           card(draw_category_map(grid_of("What simulation says", e.grid, e.prediction))))},
      {"counts", "Counts", "In brackets the 95 % interval of the share (Wilson).", counts_of(e)},
      {"differences", "Where they differ", "", differences_of(e)},
      {"facts", "How it was done", "", make_table(e.facts, {})}};
  return make_page(e.title, e.subtitle,
                   make_tiles({{std::to_string(held), "held to the end", of},
                               {std::to_string(as_told), "as simulation says", of}}),
                   sections, "",
                   "Made by <code>dvrk_gateway experiment</code> of Omentum. This file is complete "
                   "in itself: it loads nothing from anywhere.");
}

}  // namespace omentum
