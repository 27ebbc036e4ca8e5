#include "report/recording_page.h"

#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "report/html.h"
#include "report/plot.h"
#include "report/section_parts.h"

namespace omentum {
namespace {

constexpr std::size_t kMostPoints = 1500;  // of a line: more cannot be told apart on a page
constexpr std::size_t kMostEvents = 200;

using Path = RobotRecording::Path;

/// Every n-th value and the last one.
std::vector<std::size_t> thinned(std::size_t count) {
  const std::size_t stride = std::max<std::size_t>(1, (count + kMostPoints - 1) / kMostPoints);
  std::vector<std::size_t> kept;
  for (std::size_t k = 0; k < count; k += stride) kept.push_back(k);
  if (count > 0 && kept.back() != count - 1) kept.push_back(count - 1);
  return kept;
}

std::string path_plot(const RobotRecording& r, const std::string& title, const char* x_label,
                      const char* y_label, std::vector<double> Path::*x,
                      std::vector<double> Path::*y) {
  LineChart chart;
  chart.title = title;
  chart.x_label = x_label;
  chart.y_label = y_label;
  const auto add = [&](const Path& path, const char* name, int colour) {
    PlotSeries series;
    series.name = name;
    series.colour = colour;
    for (const std::size_t k : thinned(path.t_s.size())) {
      series.x.push_back((path.*x)[k]);
      series.y.push_back((path.*y)[k]);
    }
    if (!series.x.empty()) chart.series.push_back(series);
  };
  add(r.measured, "measured", 1);
  add(r.setpoint, "set-point", 2);
  add(r.commanded, "commanded", 3);
  return chart.series.empty() ? "" : card(draw_line_chart(chart));
}

double distance_mm(const Path& a, std::size_t i, const Path& b, std::size_t j) {
  return std::hypot(a.x_mm[i] - b.x_mm[j], a.y_mm[i] - b.y_mm[j], a.z_mm[i] - b.z_mm[j]);
}

/// Index of the last of these times at or before t.
std::optional<std::size_t> newest(const std::vector<double>& times, double t_s) {
  const auto after = std::upper_bound(times.begin(), times.end(), t_s);
  if (after == times.begin()) return std::nullopt;
  return static_cast<std::size_t>(std::prev(after) - times.begin());
}

/// Distance of the measured tip from the pose find(index) of what it should be; NaN without one.
template <typename Find>
PlotSeries error_of(const RobotRecording& r, const Path& wanted, const char* name, int colour,
                    Find&& find) {
  PlotSeries series;
  series.name = name;
  series.colour = colour;
  for (std::size_t k = 0; k < r.measured.t_s.size(); ++k) {
    const std::optional<std::size_t> at = find(k);
    series.x.push_back(r.measured.t_s[k]);
    series.y.push_back(at ? distance_mm(r.measured, k, wanted, *at) : std::nan(""));
  }
  return series;
}

/// From the set-point of the same moment of the robot's clock.
PlotSeries tracking_of(const RobotRecording& r) {
  constexpr double kTogether_s = 0.005;  // the robot's payloads of one period are 0.7 ms apart
  return error_of(r, r.setpoint, "from the set-point", 2,
                  [&](std::size_t k) -> std::optional<std::size_t> {
                    const double stamp_s = r.measured.stamp_s[k];
                    const auto at = newest(r.setpoint.stamp_s, stamp_s + kTogether_s);
                    if (at && stamp_s - r.setpoint.stamp_s[*at] > kTogether_s) return std::nullopt;
                    return at;
                  });
}

/// From the goal that was sent last, if one is in force.
PlotSeries lag_of(const RobotRecording& r) {
  constexpr double kInForce_s = 0.1;
  return error_of(r, r.commanded, "from the goal of that moment", 3,
                  [&](std::size_t k) -> std::optional<std::size_t> {
                    const double t_s = r.measured.t_s[k];
                    const auto at = newest(r.commanded.t_s, t_s);
                    if (at && t_s - r.commanded.t_s[*at] > kInForce_s) return std::nullopt;
                    return at;
                  });
}

/// The largest of every stretch, so that no peak is lost.
PlotSeries peaks(const PlotSeries& full) {
  PlotSeries series;
  series.name = full.name;
  series.colour = full.colour;
  const std::size_t stride =
      std::max<std::size_t>(1, (full.x.size() + kMostPoints - 1) / kMostPoints);
  for (std::size_t begin = 0; begin < full.x.size(); begin += stride) {
    double largest = std::nan("");
    for (std::size_t k = begin; k < std::min(begin + stride, full.x.size()); ++k)
      largest = std::fmax(largest, full.y[k]);
    series.x.push_back(full.x[begin]);
    series.y.push_back(largest);
  }
  return series;
}

std::vector<double> finite(const std::vector<double>& values) {
  std::vector<double> kept;
  std::copy_if(values.begin(), values.end(), std::back_inserter(kept),
               [](double v) { return std::isfinite(v); });
  return kept;
}

/// 0 without values.
double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  const auto at = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

/// Share of the values in bins of equal width up to the 99.5 % quantile; time_table() has the rest.
std::string histogram(const RobotRecording& r) {
  constexpr int kBins = 40;
  const double end = std::max({0.1, quantile(r.latency_ms, 0.995), quantile(r.jitter_ms, 0.995),
                               quantile(r.state_age_ms, 0.995)});
  LineChart chart;
  chart.title = "Distribution of times";
  chart.x_label = "time [ms]";
  chart.y_label = "share of periods";
  chart.percent = true;
  const auto add = [&](const std::vector<double>& values, const char* name, int colour) {
    if (values.empty()) return;
    std::array<double, kBins> counts{};
    for (const double value : values) {
      const double bin = std::abs(value) / end * kBins;
      if (bin < kBins) counts[static_cast<std::size_t>(bin)] += 1;
    }
    PlotSeries series;
    series.name = name;
    series.colour = colour;
    for (int k = 0; k < kBins; ++k) {
      const double share = counts[static_cast<std::size_t>(k)] / static_cast<double>(values.size());
      // Steps.
      for (const int edge : {k, k + 1}) {
        series.x.push_back(edge * end / kBins);
        series.y.push_back(share);
      }
    }
    chart.series.push_back(series);
  };
  add(r.jitter_ms, "jitter", 1);
  add(r.latency_ms, "latency", 2);
  add(r.state_age_ms, "state age", 3);
  return chart.series.empty() ? "" : card(draw_line_chart(chart));
}

std::string time_table(const RobotRecording& r) {
  std::vector<std::vector<std::string>> rows = {{"[ms]", "periods", "p50", "p99", "p99.9", "max"}};
  const auto line = [&rows](const char* name, std::vector<double> values) {
    if (values.empty()) return;
    for (double& value : values) value = std::abs(value);
    rows.push_back({name, std::to_string(values.size())});
    for (const double share : {0.5, 0.99, 0.999, 1.0})
      rows.back().push_back(fmt::format("{:.2f}", quantile(values, share)));
  };
  line("jitter: begin of the period after its time", r.jitter_ms);
  line("latency: begin of the period to the socket", r.latency_ms);
  line("state age: arrival of measured_cp to the socket", r.state_age_ms);
  return rows.size() > 1 ? card("<h3>Times</h3>" + make_table(rows, {1, 2, 3, 4, 5})) : "";
}

std::string event_table(const RobotRecording& r) {
  std::vector<std::vector<std::string>> rows = {{"time [s]", "phase", "reason", ""}};
  for (const RobotRecording::Event& event : r.events) {
    if (rows.size() > kMostEvents) break;
    rows.push_back({fmt::format("{:.2f}", event.t_s), event.phase + (event.stopped ? ", stop" : ""),
                    event.reason == "NONE" ? "" : event.reason, event.text});
  }
  std::string text = make_table(rows, {0});
  if (r.events.size() >= rows.size()) {
    text += fmt::format("<p>{} more are in the file.</p>", r.events.size() - (rows.size() - 1));
  }
  return card("<h3>Safety function</h3>" + text);
}

std::string episode_table(const RobotRecording& r) {
  if (r.episodes.empty()) return "";
  std::vector<std::vector<std::string>> rows = {{"begins [s]", "steps", "outcome", "exposure"}};
  for (const RobotRecording::Episode& episode : r.episodes) {
    rows.push_back({fmt::format("{:.2f}", episode.t_s), std::to_string(episode.steps),
                    episode.outcome, percent(episode.exposure)});
  }
  return card("<h3>Episodes</h3>" + make_table(rows, {0, 1, 3}));
}

std::string counter_table(const RobotRecording& r) {
  std::vector<std::vector<std::string>> rows = {{"counter", "at the end"}};
  for (const auto& [name, count] : r.counters) rows.push_back({name, std::to_string(count)});
  return rows.size() > 1 ? card("<h3>Counters</h3>" + make_table(rows, {1})) : "";
}

std::string tiles_of(const RobotRecording& r, const std::vector<double>& errors) {
  const double begin = r.measured.t_s.empty() ? 0 : r.measured.t_s.front();
  const double end = r.measured.t_s.empty() ? 0 : r.measured.t_s.back();
  const auto stops = std::count_if(r.events.begin(), r.events.end(),
                                   [](const RobotRecording::Event& e) { return e.stopped; });
  std::vector<Tile> tiles = {{fmt::format("{:.1f} s", end - begin), "recorded", ""}};
  if (!errors.empty()) {
    tiles.push_back({fmt::format("{:.3f} mm", quantile(errors, 0.5)), "tip from set-point",
                     fmt::format("median; largest {:.3f} mm", quantile(errors, 1))});
  }
  if (!r.latency_ms.empty()) {
    tiles.push_back(
        {fmt::format("{:.2f} ms", quantile(r.latency_ms, 0.99)), "latency", "99 % of commands"});
  }
  if (r.periods > 0) tiles.push_back({std::to_string(stops), "stops", ""});
  if (!r.episodes.empty()) tiles.push_back({std::to_string(r.episodes.size()), "episodes", ""});
  return make_tiles(tiles);
}

Section section_of(const RobotRecording& r, std::size_t number) {
  const PlotSeries tracking = tracking_of(r), lag = lag_of(r);
  Section section{fmt::format("recording{}", number), r.name, r.about, ""};
  section.content = tiles_of(r, finite(tracking.y));
  for (const std::string& problem : r.problems) section.content += missing(problem);
  std::string plots =
      path_plot(r, "Path of the tip, from above", "x_W [mm]", "y_W [mm]", &Path::x_mm,
                &Path::y_mm) +
      path_plot(r, "Path of the tip, from the side", "x_W [mm]", "z_W [mm]", &Path::x_mm,
                &Path::z_mm) +
      path_plot(r, "Height of the tip", "time [s]", "z_W [mm]", &Path::t_s, &Path::z_mm);
  LineChart errors;
  errors.title = "Measured tip";
  errors.x_label = "time [s]";
  errors.y_label = "distance [mm]";
  for (const PlotSeries& series : {tracking, lag}) {
    if (!finite(series.y).empty()) errors.series.push_back(peaks(series));
  }
  constexpr double kNothing_mm = 0.01;  // the arm itself knows no more
  const bool nothing = std::all_of(errors.series.begin(), errors.series.end(), [](const auto& s) {
    return std::all_of(s.y.begin(), s.y.end(), [](double y) { return !(y > kNothing_mm); });
  });
  if (nothing) errors.y_range = {0, kNothing_mm};
  if (!errors.series.empty()) plots += card(draw_line_chart(errors));
  section.content += row(plots + histogram(r)) + time_table(r);
  if (!r.events.empty()) section.content += event_table(r);
  section.content += episode_table(r) + counter_table(r);
  return section;
}

}  // namespace

std::string make_recording_page(const std::vector<RobotRecording>& recordings) {
  std::vector<Section> sections;
  for (const RobotRecording& recording : recordings)
    sections.push_back(section_of(recording, sections.size() + 1));
  const std::string title = recordings.size() == 1
                                ? "Recording " + recordings.front().name
                                : fmt::format("{} recordings", recordings.size());
  return make_page(title,
                   "A robot as it was led: goals sent, set-points of its servo, and what its "
                   "encoders measured, in the world frame.",
                   "", sections, "",
                   "Made by the program <code>report</code> of Omentum. This file is complete in "
                   "itself: it loads nothing from anywhere.");
}

}  // namespace omentum
