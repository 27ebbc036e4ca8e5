#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "report/plot.h"
#include "report/section_parts.h"
#include "report/sections.h"

namespace omentum {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// One cell of a start grid, over the seeds.
struct GridCell {
  int runs = 0, reached = 0;
  int held = 0;         ///< at the end
  int lost = 0;         ///< had it and lost it for good
  double exposure = 0;  ///< mean
};

struct Grid {
  int rows = 0, columns = 0;
  std::vector<GridCell> cells;
};

Grid make_grid(const std::vector<RunFolder>& runs, const std::string& name) {
  Grid grid;
  for (const RunFolder& run : runs) {
    const auto found = run.evaluations.find(name);
    if (found == run.evaluations.end()) continue;
    grid.rows = std::clamp(found->second.rows, grid.rows, 100);
    grid.columns = std::clamp(found->second.columns, grid.columns, 100);
  }
  grid.cells.resize(static_cast<std::size_t>(grid.rows) * static_cast<std::size_t>(grid.columns));
  for (const EvaluationRow& start : starts_of(runs, name)) {
    const auto row = static_cast<int>(start.row), column = static_cast<int>(start.column);
    if (row < 1 || row > grid.rows || column < 1 || column > grid.columns) continue;
    GridCell& cell = grid.cells[static_cast<std::size_t>((row - 1) * grid.columns + column - 1)];
    ++cell.runs;
    cell.reached += start.reached ? 1 : 0;
    cell.held += start.held ? 1 : 0;
    cell.lost += start.lost && !start.held ? 1 : 0;
    cell.exposure += std::isfinite(start.exposure) ? start.exposure : 0;
  }
  for (GridCell& cell : grid.cells) cell.exposure /= std::max(1, cell.runs);
  return grid;
}

HeatMap grid_frame(const Grid& grid, const std::string& title) {
  HeatMap map;
  map.title = title;
  map.rows = grid.rows;
  map.columns = grid.columns;
  map.caption_top = "anchored edge";
  map.caption_bottom = "free edge, towards the camera";
  map.value.assign(grid.cells.size(), kNaN);
  map.text.resize(grid.cells.size());
  map.hover.resize(grid.cells.size());
  return map;
}

std::string hover_of(const Grid& grid, std::size_t k) {
  const GridCell& cell = grid.cells[k];
  const auto columns = static_cast<std::size_t>(grid.columns);
  return fmt::format(
      "start ({}, {}): exposure {:.1f} %, target reached {} of {}, tissue held {} of {}, lost {} "
      "of {}",
      k / columns + 1, k % columns + 1, 100 * cell.exposure, cell.reached, cell.runs, cell.held,
      cell.runs, cell.lost, cell.runs);
}

/// Starts that `texts` marks are outlined.
std::string exposure_grid(const Grid& grid, const std::string& title, const pb::Report& texts) {
  HeatMap map = grid_frame(grid, title);
  map.scale_label = std::string("%");  // g++ 12 warns wrongly about assigning the literal
  map.high = 100;
  for (std::size_t k = 0; k < grid.cells.size(); ++k) {
    if (grid.cells[k].runs == 0) continue;
    map.value[k] = 100 * grid.cells[k].exposure;
    map.text[k] = fmt::format("{:.0f}", map.value[k]);
    map.hover[k] = hover_of(grid, k);
  }
  for (const pb::MarkedStart& mark : texts.marked_start()) {
    const auto row = static_cast<int>(mark.row());
    const auto column = static_cast<int>(mark.column());
    if (row <= grid.rows && column <= grid.columns)
      map.marks.emplace_back((row - 1) * grid.columns + column - 1, mark.text());
  }
  return draw_heat_map(map);
}

std::string success_grid(const Grid& grid, const std::string& title) {
  int most = 1;
  for (const GridCell& cell : grid.cells) most = std::max(most, cell.runs);
  HeatMap map = grid_frame(grid, title);
  map.scale_label = std::string("n");  // g++ 12 warns wrongly about assigning the literal
  map.high = most;
  for (std::size_t k = 0; k < grid.cells.size(); ++k) {
    const GridCell& cell = grid.cells[k];
    if (cell.runs == 0) continue;
    map.value[k] = cell.reached;
    map.text[k] = cell.reached > 0 ? "yes" : "no";
    if (most > 1) map.text[k] = fmt::format("{}/{}", cell.reached, cell.runs);
    map.hover[k] = hover_of(grid, k);
  }
  return draw_heat_map(map);
}

}  // namespace

Section make_grid_section(const std::vector<RunFolder>& runs) {
  Section section{"starts", "Where the tool starts",
                  "Each cell is one start of the tool above the sheet. Exposure: share of the "
                  "tumour's visible surface seen by the endoscope at the end of the episode. " +
                      report_texts(runs).starts(),
                  ""};
  for (const std::string& name : set_names(runs)) {
    if (is_robot_set(name) || !drawn_parameter(name).empty()) continue;
    const Grid grid = make_grid(runs, name);
    if (grid.cells.empty()) continue;
    const EvaluationFigures f = figures_of(runs, name);
    section.content += fmt::format(
        "<h3>{}: target reached {} of {}, exposed {}, mean exposure {}</h3>\n<div class=\"row\">\n",
        escape_html(describe_set(runs, name)), f.target_reached, f.starts, f.exposed,
        percent(f.mean_exposure, 1));
    section.content += card(exposure_grid(grid, "Exposure at the end [%]", report_texts(runs)));
    section.content += card(success_grid(grid, "Target reached with tissue held"));
    section.content += "</div>\n";
  }
  if (section.content.empty()) section.content = missing("No evaluation on the start grid.");
  return section;
}

Section make_drawn_section(const std::vector<RunFolder>& runs) {
  constexpr std::size_t kRanges = 5;
  Section section{
      "drawn", "What the scene is drawn with",
      "One parameter at a time, the others as the scene has them; each point is a fifth "
      "of its range. The values are none that training met.",
      ""};
  for (const std::string& name : set_names(runs)) {
    const std::string parameter = drawn_parameter(name);
    std::vector<EvaluationRow> rows = starts_of(runs, name);
    std::erase_if(rows, [](const EvaluationRow& r) { return !std::isfinite(r.drawn); });
    if (parameter.empty() || rows.size() < kRanges) continue;
    std::ranges::sort(rows, {}, &EvaluationRow::drawn);
    PlotSeries reached, exposed;
    reached.name = "target reached";
    exposed.name = std::string("exposed");
    exposed.colour = 2;
    for (std::size_t k = 0; k < kRanges; ++k) {
      const std::size_t begin = k * rows.size() / kRanges, end = (k + 1) * rows.size() / kRanges;
      const auto part = std::span(rows).subspan(begin, end - begin);
      const EvaluationFigures f = figures_of(part);
      double sum = 0;
      for (const EvaluationRow& r : part) sum += r.drawn;
      const auto count = static_cast<double>(part.size());
      for (PlotSeries* series : {&reached, &exposed}) series->x.push_back(sum / count);
      reached.y.push_back(static_cast<double>(f.target_reached) / count);
      exposed.y.push_back(static_cast<double>(f.exposed) / count);
    }
    LineChart chart;
    chart.title = parameter;
    chart.x_label = parameter;
    chart.y_label = std::string("share of starts");
    chart.series = {reached, exposed};
    chart.y_range = {0, 1};
    chart.percent = true;
    section.content += card(draw_line_chart(chart));
  }
  if (!section.content.empty()) section.content = row(section.content);
  return section;
}

Section make_robot_section(const std::vector<RunFolder>& runs) {
  Section section{"robot", "The robot's starts", report_texts(runs).robot_starts(), ""};
  for (const std::string& name : set_names(runs)) {
    if (!is_robot_set(name)) continue;
    const Grid grid = make_grid(runs, name);
    CategoryMap map;
    map.title = describe_set(runs, name);
    map.caption_top = "towards the anchored edge";
    map.caption_bottom = "free edge, towards the camera";
    map.rows = grid.rows;
    map.columns = grid.columns;
    map.kinds = {{"held to the end", "yes", "#3f8f5b", "#ffffff"},
                 {"held, then lost", "lost", "#e39a3b", "#2b1c05"},
                 {"not held", "no", "#efe3a4", "#4b4212"}};
    for (std::size_t k = 0; k < grid.cells.size(); ++k) {
      const GridCell& cell = grid.cells[k];
      // Over several seeds the cell shows what most of them did; ties go to the worse.
      const int none = cell.runs - cell.held - cell.lost;
      int kind = -1;
      if (cell.runs > 0)
        kind = none >= cell.held && none >= cell.lost ? 2 : (cell.lost >= cell.held ? 1 : 0);
      map.kind.push_back(kind);
      map.hover.push_back(hover_of(grid, k));
    }
    section.content += card(draw_category_map(map));
    section.content += card(exposure_grid(grid, map.title + ": exposure at the end [%]",
                                          pb::Report::default_instance()));
  }
  section.content = section.content.empty() ? missing("No evaluation on the robot's grid.")
                                            : row(section.content);
  return section;
}

Section make_lattice_section(const std::vector<RunFolder>& runs) {
  Section section{
      "lattice", "Where to grasp",
      "No policy: the jaw closes on one particle, lifts it to the target and holds. Colour: what "
      "that exposes. "
      "It is the best any policy that lifts to this target could do by choosing its grasp; best is "
      "a "
      "grasp that reached the target and held.",
      ""};
  const auto run =
      std::find_if(runs.begin(), runs.end(), [](const RunFolder& r) { return !r.lattice.empty(); });
  if (run == runs.end()) {
    section.content = missing("No grasp lattice: evaluation.grasp_lattice was off.");
    return section;
  }
  PlaneMap map;
  map.title = "Exposure by grasped particle [%]";
  map.x_label = "x_B across the sheet [mm]";
  map.y_label = "y_B, anchored edge on top [mm]";
  map.scale_label = std::string("%");  // g++ 12 warns wrongly about assigning the literal
  map.y_down = true;                   // anchored edge on top, as in the start grids
  const std::optional<std::size_t> best = best_grasp(run->lattice);
  std::size_t as_good = 0;
  double nearest = std::numeric_limits<double>::infinity();
  for (const EvaluationRow& grasp : run->lattice) {
    const EvaluationRow& first = run->lattice.front();
    const double distance =
        std::hypot(grasp.start[0] - first.start[0], grasp.start[1] - first.start[1]);
    if (distance > 1e-6) nearest = std::min(nearest, distance);
    map.x.push_back(1000 * grasp.start[0]);
    map.y.push_back(1000 * grasp.start[1]);
    map.value.push_back(100 * grasp.exposure);
    as_good += best && grasp.reached && grasp.held && grasp.exposure == run->lattice[*best].exposure
                   ? 1
                   : 0;
  }
  map.high = 100;
  map.cell_x = map.cell_y = std::isfinite(nearest) ? 1000 * nearest : 3;
  const EvaluationFigures f = figures_of(run->lattice);
  std::vector<std::vector<std::string>> rows = {
      {"", "value"},
      {"grasps tried", std::to_string(f.starts)},
      {"target reached", fmt::format("{} of {}", f.target_reached, f.starts)},
      {"grasp held", fmt::format("{} of {}", f.grasp_held, f.starts)},
      {"exposed", fmt::format("{} of {}", f.exposed, f.starts)},
      {"run", run->name}};
  if (best) {
    const EvaluationRow& grasp = run->lattice[*best];
    map.best = best;
    map.best_label = as_good > 1
                         ? fmt::format("{:.0f} %, as {} others", 100 * grasp.exposure, as_good - 1)
                         : fmt::format("best: {:.0f} %", 100 * grasp.exposure);
    rows.insert(
        rows.begin() + 1,
        {{"best exposure", percent(grasp.exposure, 1)},
         {"grasps as good", std::to_string(as_good)},
         {"the first of them, particle", std::to_string(grasp.index)},
         {"its place in B at rest",
          fmt::format("({:.1f}, {:.1f}) mm", 1000 * grasp.start[0], 1000 * grasp.start[1])}});
  }
  section.content = row(card(draw_plane_map(map)) +
                        card(std::string("<h3>Best grasp</h3>\n") + make_table(rows, {1})));
  return section;
}

}  // namespace omentum
