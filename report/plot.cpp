#include "report/plot.h"

#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "report/html.h"

namespace omentum {
namespace {

/// A linear axis on paper.
struct Axis {
  double low = 0, high = 1;   // values
  double start = 0, end = 1;  // paper
  double at(double value) const { return start + (value - low) / (high - low) * (end - start); }
};

constexpr double kWidth = 360;  // of a plot: what a page of 420 px leaves of itself

/// A mark and its name.
struct LegendEntry {
  std::string mark;  ///< markup
  std::string name;
};

/// Title and legend as text of the page, then the drawing. A drawing wider than a phone keeps its
/// size and scrolls.
std::string figure(const std::string& title, const std::vector<LegendEntry>& legend, double width,
                   double height, const std::string& drawing) {
  std::string html =
      fmt::format("<figure class=\"plot\"><figcaption>{}</figcaption>\n", escape_html(title));
  if (!legend.empty()) html += "<p class=\"legend\">";
  for (const LegendEntry& entry : legend)
    html += fmt::format("<span>{}{}</span> ", entry.mark, escape_html(entry.name));
  if (!legend.empty()) html += "</p>\n";
  const bool wide = width > 1.1 * kWidth;
  html += fmt::format(
      "<div class=\"{}\"><svg class=\"plot\" viewBox=\"0 0 {:.0f} {:.0f}\" "
      "style=\"max-width:{:.0f}px{}\" role=\"img\" aria-label=\"{}\">\n{}</svg></div></figure>\n",
      wide ? "scroll" : "fits", width, height, 1.25 * width,
      wide ? fmt::format(";min-width:{:.0f}px", width) : "", escape_html(title), drawing);
  return html;
}

std::string text_at(double x, double y, const std::string& style, const std::string& text,
                    const char* anchor = "start") {
  return fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" class=\"{}\" text-anchor=\"{}\">{}</text>\n",
                     x, y, style, anchor, escape_html(text));
}

std::string line_at(double x1, double y1, double x2, double y2, const std::string& style) {
  return fmt::format(
      "<line x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\" class=\"{}\"/>\n", x1, y1, x2,
      y2, style);
}

std::pair<double, double> range_of(const std::vector<const std::vector<double>*>& lists) {
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (const auto* list : lists) {
    for (const double value : *list) {
      if (!std::isfinite(value)) continue;
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
  if (!(high >= low)) return {0, 1};
  if (high == low)
    return {low - 0.5 * std::max(1.0, std::abs(low)), high + 0.5 * std::max(1.0, std::abs(high))};
  return {low, high};
}

std::string series_class(int colour) {
  return colour == 0 ? "company" : fmt::format("series s{}", colour);
}

std::string draw_series(const PlotSeries& series, const Axis& x, const Axis& y) {
  std::string svg;
  const std::size_t count = std::min(series.x.size(), series.y.size());
  if (series.low.size() >= count && series.high.size() >= count && count > 1) {
    std::string path;
    for (std::size_t k = 0; k < count; ++k) {
      path += fmt::format("{}{:.1f},{:.1f}", k == 0 ? "M" : "L", x.at(series.x[k]),
                          y.at(series.high[k]));
    }
    for (std::size_t k = count; k-- > 0;)
      path += fmt::format("L{:.1f},{:.1f}", x.at(series.x[k]), y.at(series.low[k]));
    svg += fmt::format("<path d=\"{}Z\" class=\"band b{}\"/>\n", path, series.colour);
  }
  std::string path;
  bool pen_down = false;
  for (std::size_t k = 0; k < count; ++k) {
    const bool good = std::isfinite(series.x[k]) && std::isfinite(series.y[k]);
    if (good)
      path += fmt::format("{}{:.1f},{:.1f}", pen_down ? "L" : "M", x.at(series.x[k]),
                          y.at(series.y[k]));
    pen_down = good;
  }
  const std::string name =
      series.name.empty() ? "" : "<title>" + escape_html(series.name) + "</title>";
  return svg + fmt::format("<path d=\"{}\" class=\"{}\">{}</path>\n", path,
                           series_class(series.colour), name);
}

std::vector<LegendEntry> legend_of(const std::vector<PlotSeries>& all) {
  std::vector<LegendEntry> legend;
  for (const PlotSeries& series : all) {
    if (series.name.empty() || series.colour == 0) continue;
    legend.push_back({fmt::format("<svg class=\"key\" viewBox=\"0 0 20 12\" width=\"20\" "
                                  "height=\"12\" aria-hidden=\"true\">{}</svg>",
                                  line_at(1, 6, 19, 6, series_class(series.colour))),
                      series.name});
  }
  return legend;
}

/// Label of the y axis, upright, centred at `y`.
std::string upright_label(double y, const std::string& text) {
  return fmt::format(
      "<text class=\"label\" text-anchor=\"middle\" transform=\"translate(12 {:.1f}) "
      "rotate(-90)\">{}</text>\n",
      y, escape_html(text));
}

/// The colour bar of a sequential scale, `height` long, upright.
std::string draw_scale(double x, double top, double height, double low, double high,
                       const std::string& label) {
  std::string svg;
  constexpr int kSteps = 32;
  for (int k = 0; k < kSteps; ++k) {
    svg += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.2f}\" width=\"10\" height=\"{:.2f}\" fill=\"{}\"/>\n", x,
        top + height * (1 - double(k + 1) / kSteps), height / kSteps + 0.6,
        scale_colour((k + 0.5) / kSteps));
  }
  for (const double share : {0.0, 0.5, 1.0}) {
    svg += text_at(x + 13, top + height * (1 - share) + 4, "tick",
                   short_number(low + share * (high - low)));
  }
  return svg + text_at(x + 10, top - 10, "tick", label, "end");
}

constexpr double kCell = 29;  // ten of them, the numbers beside them and a scale fill the width
constexpr double kCellGap = 1.5;
constexpr double kGridLeft = 22;
constexpr double kGridTop = 40;
constexpr double kScaleRoom = 48;

/// Width of a grid whose captions fit; [px].
constexpr double kLeastGrid = 220;

/// Where the cells begin: a small grid stands in the middle of its captions.
double grid_left(int columns) { return std::max(kGridLeft, (kLeastGrid - columns * kCell) / 2); }

/// Numbers of rows and columns and the two captions around a grid of cells.
std::string draw_grid_frame(int rows, int columns, const std::string& top,
                            const std::string& bottom) {
  const double middle = grid_left(columns) + columns * kCell / 2;
  std::string svg = text_at(middle, 14, "label", top, "middle");
  svg += text_at(middle, kGridTop + rows * kCell + 18, "label", bottom, "middle");
  for (int c = 0; c < columns; ++c) {
    svg += text_at(grid_left(columns) + (c + 0.5) * kCell, kGridTop - 6, "tick",
                   std::to_string(c + 1), "middle");
  }
  for (int r = 0; r < rows; ++r) {
    svg += text_at(grid_left(columns) - 5, kGridTop + (r + 0.5) * kCell + 4, "tick",
                   std::to_string(r + 1), "end");
  }
  return svg;
}

std::string draw_cell(double left, int row, int column, const std::string& fill,
                      const std::string& ink, const std::string& text, const std::string& hover) {
  const double x = left + column * kCell;
  const double y = kGridTop + row * kCell;
  return fmt::format(
      "<g><title>{}</title><rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" "
      "rx=\"3\" fill=\"{}\"/>"
      "<text x=\"{:.1f}\" y=\"{:.1f}\" class=\"cell\" text-anchor=\"middle\" "
      "fill=\"{}\">{}</text></g>\n",
      escape_html(hover), x, y, kCell - kCellGap, kCell - kCellGap, fill,
      x + (kCell - kCellGap) / 2, y + kCell / 2 + 3.5, ink, escape_html(text));
}

}  // namespace

std::vector<double> make_ticks(double low, double high, int wanted) {
  const double span = high - low;
  if (!(span > 0) || !std::isfinite(span)) return {low};
  const double raw = span / std::max(1, wanted);
  const double power = std::pow(10, std::floor(std::log10(raw)));
  double step = power;
  for (const double factor : {1.0, 2.0, 2.5, 5.0, 10.0}) {
    step = factor * power;
    if (step >= raw * 0.999) break;
  }
  std::vector<double> ticks;
  const double first = std::ceil(low / step - 1e-9);
  for (int k = 0; k < 1000; ++k) {
    const double tick = (first + k) * step;
    if (tick > high + 1e-9 * span) break;
    ticks.push_back(std::abs(tick) < 1e-12 * span ? 0 : tick);
  }
  return ticks;
}

std::string short_number(double value) {
  if (!std::isfinite(value)) return "-";
  const double size = std::abs(value);
  if (size >= 999'500) return fmt::format("{:.4g} M", value / 1e6);
  if (size >= 10'000) return fmt::format("{:.4g} k", value / 1e3);
  return fmt::format("{:.4g}", value);
}

std::string scale_colour(double share) {
  // Light sand through teal to deep blue-green: lightness falls steadily, so the scale survives
  // grey printing.
  constexpr std::array<std::array<double, 3>, 5> kStops = {
      {{244, 240, 228}, {193, 221, 196}, {116, 187, 171}, {45, 136, 145}, {14, 76, 99}}};
  const double place =
      std::clamp(std::isfinite(share) ? share : 0.0, 0.0, 1.0) * (kStops.size() - 1);
  const auto k = std::min(kStops.size() - 2, static_cast<std::size_t>(place));
  const double t = place - static_cast<double>(k);
  std::array<int, 3> rgb{};
  for (std::size_t c = 0; c < 3; ++c)
    rgb[c] = static_cast<int>(std::lround(kStops[k][c] + t * (kStops[k + 1][c] - kStops[k][c])));
  return fmt::format("#{:02x}{:02x}{:02x}", rgb[0], rgb[1], rgb[2]);
}

std::string scale_ink(double share) { return share > 0.58 ? "#ffffff" : "#1d2a2e"; }

std::string draw_line_chart(const LineChart& chart) {
  constexpr double kHeight = 236;
  std::vector<const std::vector<double>*> xs, ys;
  for (const PlotSeries& series : chart.series) {
    xs.push_back(&series.x);
    ys.insert(ys.end(), {&series.y, &series.low, &series.high});
  }
  const auto [x_low, x_high] = range_of(xs);
  auto [y_low, y_high] = chart.y_range ? *chart.y_range : range_of(ys);
  const std::vector<double> y_ticks = make_ticks(y_low, y_high, 5);
  if (!chart.y_range) {
    // Room above and below, so that no line runs on the frame.
    const double room = 0.06 * (y_high - y_low);
    y_low -= room;
    y_high += room;
  }
  const Axis x{x_low, x_high, 62, kWidth - 26};  // room for half of the last number
  const Axis y{y_low, y_high, kHeight - 44, 20};
  std::string svg;
  for (const double tick : y_ticks) {
    svg += line_at(x.start, y.at(tick), x.end, y.at(tick), "grid");
    svg += text_at(x.start - 8, y.at(tick) + 4, "tick",
                   chart.percent ? fmt::format("{:.3g} %", 100 * tick) : short_number(tick), "end");
  }
  for (const double tick : make_ticks(x_low, x_high, 4)) {
    svg += line_at(x.at(tick), y.start, x.at(tick), y.start + 4, "axis");
    svg += text_at(x.at(tick), y.start + 18, "tick", short_number(tick), "middle");
  }
  for (const PlotMilestone& milestone : chart.milestones) {
    if (milestone.x < x_low || milestone.x > x_high) continue;
    svg += line_at(x.at(milestone.x), y.start, x.at(milestone.x), y.end, "milestone");
    const double place = x.at(milestone.x);
    const double half =
        3.2 * static_cast<double>(milestone.label.size());  // 6.4 px: a letter, mean
    const char* anchor = place + half > kWidth ? "end" : place < half ? "start" : "middle";
    svg += text_at(place, y.end - 6, "note", milestone.label, anchor);
  }
  svg += line_at(x.start, y.start, x.end, y.start, "axis");
  for (const PlotSeries& series : chart.series) svg += draw_series(series, x, y);
  svg += text_at((x.start + x.end) / 2, kHeight - 6, "label", chart.x_label, "middle");
  svg += upright_label((y.start + y.end) / 2, chart.y_label);
  return figure(chart.title, legend_of(chart.series), kWidth, kHeight, svg);
}

std::string draw_heat_map(const HeatMap& map) {
  const double left = grid_left(map.columns);
  const double width = std::max(left + map.columns * kCell + kScaleRoom, kLeastGrid);
  const double height = kGridTop + map.rows * kCell + 26;
  std::string svg = draw_grid_frame(map.rows, map.columns, map.caption_top, map.caption_bottom);
  for (int r = 0; r < map.rows; ++r) {
    for (int c = 0; c < map.columns; ++c) {
      const auto k = static_cast<std::size_t>(r * map.columns + c);
      if (k >= map.value.size() || !std::isfinite(map.value[k])) {
        svg += draw_cell(left, r, c, "var(--empty)", "var(--muted)", "", "not evaluated");
        continue;
      }
      const double share = (map.value[k] - map.low) / std::max(1e-12, map.high - map.low);
      svg += draw_cell(left, r, c, scale_colour(share), scale_ink(share),
                       k < map.text.size() ? map.text[k] : "",
                       k < map.hover.size() ? map.hover[k] : "");
    }
  }
  for (const auto& [cell, note] : map.marks) {
    const auto column = cell % map.columns;
    const auto row = cell / map.columns;
    const double x = left + column * kCell;
    const double y = kGridTop + row * kCell;
    svg += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" rx=\"4\" "
        "class=\"mark\"><title>{}</title></rect>\n",
        x - 1, y - 1, kCell, kCell, escape_html(note));
  }
  svg += draw_scale(left + map.columns * kCell + 8, kGridTop, map.rows * kCell - kCellGap, map.low,
                    map.high, map.scale_label);
  return figure(map.title, {}, width, height, svg);
}

std::string draw_category_map(const CategoryMap& map) {
  const double left = grid_left(map.columns);
  const double width = std::max(left + map.columns * kCell + 10, kLeastGrid);
  const double height = kGridTop + map.rows * kCell + 26;
  std::string svg = draw_grid_frame(map.rows, map.columns, map.caption_top, map.caption_bottom);
  std::vector<int> counts(map.kinds.size(), 0);
  for (int r = 0; r < map.rows; ++r) {
    for (int c = 0; c < map.columns; ++c) {
      const auto k = static_cast<std::size_t>(r * map.columns + c);
      const int kind = k < map.kind.size() ? map.kind[k] : -1;
      if (kind < 0) {
        svg += draw_cell(left, r, c, "var(--empty)", "var(--muted)", "", "not evaluated");
        continue;
      }
      const CategoryMap::Kind& shown = map.kinds[static_cast<std::size_t>(kind)];
      ++counts[static_cast<std::size_t>(kind)];
      svg += draw_cell(left, r, c, shown.colour, shown.ink, shown.sign,
                       k < map.hover.size() ? map.hover[k] : shown.name);
    }
  }
  std::vector<LegendEntry> legend;
  for (std::size_t k = 0; k < map.kinds.size(); ++k) {
    legend.push_back(
        {fmt::format("<svg class=\"key\" viewBox=\"0 0 12 12\" width=\"12\" height=\"12\" "
                     "aria-hidden=\"true\"><rect width=\"12\" height=\"12\" rx=\"3\" "
                     "fill=\"{}\"/></svg>",
                     map.kinds[k].colour),
         fmt::format("{}: {}", map.kinds[k].name, counts[k])});
  }
  return figure(map.title, legend, width, height, svg);
}

std::string draw_plane_map(const PlaneMap& map) {
  constexpr double kHeight = 338, kTop = 24, kLeft = 52, kSide = 258;
  auto [x_low, x_high] = range_of({&map.x});
  auto [y_low, y_high] = range_of({&map.y});
  const double half_x = map.cell_x / 2, half_y = map.cell_y / 2;
  // One scale for both axes.
  const double span = std::max(x_high - x_low + map.cell_x, y_high - y_low + map.cell_y);
  const Axis x{x_low - half_x, x_low - half_x + span, kLeft, kLeft + kSide};
  const Axis y = map.y_down ? Axis{y_low - half_y, y_low - half_y + span, kTop, kTop + kSide}
                            : Axis{y_low - half_y, y_low - half_y + span, kTop + kSide, kTop};
  std::string svg;
  const double width = map.cell_x / span * kSide, height = map.cell_y / span * kSide;
  for (std::size_t k = 0; k < map.value.size(); ++k) {
    const double share = (map.value[k] - map.low) / std::max(1e-12, map.high - map.low);
    svg += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.2f}\" height=\"{:.2f}\" "
        "fill=\"{}\"><title>{}</title></rect>\n",
        x.at(map.x[k]) - width / 2, y.at(map.y[k]) - height / 2, width - 0.4, height - 0.4,
        std::isfinite(map.value[k]) ? scale_colour(share) : "var(--empty)",
        fmt::format("x {:.1f}, y {:.1f}: {:.1f} {}", map.x[k], map.y[k], map.value[k],
                    map.scale_label));
  }
  for (const double tick : make_ticks(x.low, x_high + half_x, 6)) {
    svg += text_at(x.at(tick), kTop + kSide + 16, "tick", short_number(tick), "middle");
  }
  for (const double tick : make_ticks(y.low, y_high + half_y, 6)) {
    svg += text_at(kLeft - 6, y.at(tick) + 4, "tick", short_number(tick), "end");
  }
  if (map.best && *map.best < map.x.size()) {
    const double bx = x.at(map.x[*map.best]);
    const double by = y.at(map.y[*map.best]);
    svg += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"9\" class=\"best\"/>\n", bx, by);
    const double length = 7.2 * static_cast<double>(map.best_label.size());  // bold at 12.5 px
    const bool left = bx + 12 + length > x.end;
    svg += text_at(left ? std::max(bx - 12, x.start + length) : bx + 12, std::max(by - 8, 12.0),
                   "bestnote", map.best_label, left ? "end" : "start");
  }
  svg += text_at(x.start + kSide / 2, kTop + kSide + 36, "label", map.x_label, "middle");
  svg += upright_label(kTop + kSide / 2, map.y_label);
  svg += draw_scale(kLeft + kSide + 8, kTop, kSide, map.low, map.high, map.scale_label);
  return figure(map.title, {}, kWidth, kHeight, svg);
}

}  // namespace omentum
