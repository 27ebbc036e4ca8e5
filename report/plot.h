#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

// Plots as inline SVG, written by our own code: no script, no font, no network. Colours are CSS
// variables of the page (report/html.cpp), so plots follow its light and dark design. Every
// function returns one <figure>: title and legend, which wrap, and an <svg> about 360 px wide, the
// column of a phone, so that its letters have nearly the size they are written in (11 px or more
// from 400 px of page on). A wider grid scrolls. Values may be NaN: a gap in a line, an empty cell.

namespace omentum {

struct PlotSeries {
  std::string name;  ///< in the legend; empty = not listed
  std::vector<double> x, y;
  std::vector<double> low, high;  ///< shaded range around y; empty = none
  int colour = 1;                 ///< 1 ... 6, a series colour of the page; 0 = grey and thin
};

/// A value of x that deserves a dashed line with a note.
struct PlotMilestone {
  double x = 0;
  std::string label;
};

struct LineChart {
  std::string title, x_label, y_label;
  std::vector<PlotSeries> series;
  std::vector<PlotMilestone> milestones;             ///< those outside the range are left out
  std::optional<std::pair<double, double>> y_range;  ///< default: the values, rounded to ticks
  bool percent = false;                              ///< y is a fraction; ticks in %
};
std::string draw_line_chart(const LineChart& chart);

/// A grid of cells with numbers; row 0 on top.
struct HeatMap {
  std::string title, caption_top, caption_bottom;
  int rows = 0, columns = 0;
  std::vector<double> value;       ///< rows x columns, row by row; NaN = no such cell
  std::vector<std::string> text;   ///< in the cell; empty = none
  std::vector<std::string> hover;  ///< tool tip
  double low = 0, high = 1;        ///< ends of the colour scale
  std::string scale_label;         ///< beside the colour bar
  std::vector<std::pair<int, std::string>> marks;  ///< cells to outline, each with a tool tip
};
std::string draw_heat_map(const HeatMap& map);

/// A grid of cells of a few kinds, each with a colour and a sign.
struct CategoryMap {
  struct Kind {
    std::string name, sign;  ///< in the legend, in the cell
    std::string colour;      ///< CSS colour
    std::string ink;         ///< CSS colour of the sign
  };
  std::string title, caption_top, caption_bottom;
  int rows = 0, columns = 0;
  std::vector<int> kind;  ///< index into kinds, -1 = no such cell
  std::vector<std::string> hover;
  std::vector<Kind> kinds;
};
std::string draw_category_map(const CategoryMap& map);

/// Squares at places of a plane coloured by value, with the best one marked.
struct PlaneMap {
  std::string title, x_label, y_label, scale_label;
  std::vector<double> x, y, value;
  double cell_x = 1, cell_y = 1;  ///< edges of a cell in the unit of x and y
  double low = 0, high = 1;
  std::optional<std::size_t> best;
  std::string best_label;
  bool y_down = false;  ///< y grows downwards
};
std::string draw_plane_map(const PlaneMap& map);

/// Round tick values that cover [low, high], about `wanted` of them.
std::vector<double> make_ticks(double low, double high, int wanted);

/// 1500000 -> "1.5 M", 0.25 -> "0.25".
std::string short_number(double value);

/// Colour of a fraction in [0, 1] on the page's sequential scale, and a readable ink on it; as
/// "#rrggbb".
std::string scale_colour(double share);
std::string scale_ink(double share);

}  // namespace omentum
