#include "mismatch/intake/intake.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

#include "mismatch/intake/clocks.h"
#include "mismatch/intake/signals.h"

namespace omentum {
namespace {

constexpr double kHold = 0.4;             // [s] shortest stretch that counts as still
constexpr std::size_t kFewest = 8;        // rows of such a stretch
constexpr std::size_t kMostColumns = 60;  // of markers some tell enough
constexpr double kRounding = 1e-12;       // of numbers of order 1; no sensor is so quiet

double seconds(std::int64_t time_ns) { return 1e-9 * static_cast<double>(time_ns); }

bool is_command(const std::string& topic) { return topic.ends_with("_commanded"); }

std::string unit_of(std::string_view column) {
  for (const char* unit : {"rad_per_s", "m_per_s", "rad", "Nm", "Pa", "m", "N"}) {
    if (column.ends_with(fmt::format("_{}", unit))) return unit;
  }
  return "";
}

/// Units of the columns of a channel, each once.
std::set<std::string> units_of(const Series& series) {
  std::set<std::string> units;
  for (const std::string& column : series.columns) units.insert(unit_of(column));
  return units;
}

SamplingFigures sampling_of(const std::string& topic, const std::vector<std::int64_t>& time_ns) {
  Series times;
  times.time_ns = time_ns;
  SamplingFigures figures{topic, time_ns.size(), seconds(time_ns.front()), seconds(time_ns.back()),
                          median_period(times)};
  for (std::size_t k = 1; k < time_ns.size(); ++k) {
    const double gap = seconds(time_ns[k] - time_ns[k - 1]);
    if (gap <= 2.5 * figures.period_s) continue;
    ++figures.gaps;
    figures.longest_gap_s = std::max(figures.longest_gap_s, gap);
  }
  return figures;
}

/// Stretches [begin, end) of rows in which no command changes.
std::vector<std::pair<double, double>> holds_of(const Series& commands) {
  std::vector<std::pair<double, double>> holds;
  const std::size_t width = commands.columns.size();
  std::vector<double> tolerance(width);
  for (std::size_t k = 0; k < width; ++k) {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (std::size_t row = 0; row < commands.rows(); ++row) {
      low = std::fmin(low, commands.at(row, k));
      high = std::fmax(high, commands.at(row, k));
    }
    tolerance[k] = 1e-4 * (high - low) + 1e-12;
  }
  std::size_t begin = 0;
  for (std::size_t row = 1; row <= commands.rows(); ++row) {
    bool still = row < commands.rows();
    for (std::size_t k = 0; still && k < width; ++k)
      still = std::fabs(commands.at(row, k) - commands.at(begin, k)) <= tolerance[k];
    if (still) continue;
    const double from = seconds(commands.time_ns[begin]), to = seconds(commands.time_ns[row - 1]);
    // What was moving comes to rest in a third of it.
    if (to - from >= 1.5 * kHold) holds.emplace_back(from + (to - from) / 3, to);
    begin = row;
  }
  return holds;
}

/// Values far from the middle of their four neighbours, and from all of them.
std::size_t outliers_in(const Series& series, std::size_t column) {
  std::vector<double> off, spread;
  for (std::size_t row = 2; row + 2 < series.rows(); ++row) {
    std::array<double, 4> near = {series.at(row - 2, column), series.at(row - 1, column),
                                  series.at(row + 1, column), series.at(row + 2, column)};
    std::sort(near.begin(), near.end());
    const double distance = std::fabs(series.at(row, column) - 0.5 * (near[1] + near[2]));
    if (!std::isfinite(distance) || !std::isfinite(near[0] + near[3])) continue;
    off.push_back(distance);
    spread.push_back(near[3] - near[0]);
  }
  const double scale = 1.4826 * median(off);  // of a normal distribution
  if (!(scale > kRounding)) return 0;         // steps of the sensor are all there is
  std::size_t count = 0;
  for (std::size_t k = 0; k < off.size(); ++k) count += off[k] > std::max(8 * scale, spread[k]);
  return count;
}

NoiseFigures noise_of(const std::string& topic, const std::string& unit, const Series& series,
                      const std::vector<std::pair<double, double>>& holds) {
  NoiseFigures figures{topic, unit};
  figures.in_holds = !holds.empty();
  const double period = median_period(series);
  std::vector<std::pair<double, double>> stretches = holds;
  if (holds.empty()) {
    const double length = std::max(kHold, period * static_cast<double>(kFewest));
    for (double t = seconds(series.time_ns.front()); t + length <= seconds(series.time_ns.back());
         t += length) {
      // Where nothing was recorded, be it for years, there is nothing to look at.
      const auto next = std::lower_bound(series.time_ns.begin(), series.time_ns.end(),
                                         static_cast<std::int64_t>(t * 1e9));
      if (seconds(*next) >= t + length) t = seconds(*next);
      if (t + length > seconds(series.time_ns.back())) break;
      stretches.emplace_back(t, t + length);
    }
  }
  std::vector<Scatter> scatters;
  const std::size_t stride = std::max<std::size_t>(1, series.columns.size() / kMostColumns);
  for (std::size_t k = 0; k < series.columns.size(); k += stride) {
    if (unit_of(series.columns[k]) != unit) continue;
    figures.outliers += outliers_in(series, k);
    std::vector<Scatter> of_column;
    for (const auto& [from, to] : stretches) {
      const auto row_at = [&](double t) {
        return static_cast<std::size_t>(std::lower_bound(series.time_ns.begin(),
                                                         series.time_ns.end(),
                                                         static_cast<std::int64_t>(t * 1e9)) -
                                        series.time_ns.begin());
      };
      std::vector<double> values;
      for (std::size_t row = row_at(from); row < row_at(to); ++row)
        values.push_back(series.at(row, k));
      const bool known = std::none_of(values.begin(), values.end(),
                                      [](double value) { return std::isnan(value); });
      if (values.size() >= kFewest && known) of_column.push_back(scatter_about_line(values));
    }
    std::sort(of_column.begin(), of_column.end(),
              [](const Scatter& a, const Scatter& b) { return a.sd < b.sd; });
    if (holds.empty()) of_column.resize((of_column.size() + 9) / 10);
    scatters.insert(scatters.end(), of_column.begin(), of_column.end());
  }
  figures.windows = scatters.size();
  double squares = 0, neighbours = 0;
  for (const Scatter& scatter : scatters) {
    squares += scatter.sd * scatter.sd;
    neighbours += scatter.neighbour_correlation * scatter.sd * scatter.sd;
  }
  const double sd =
      scatters.empty() ? 0 : std::sqrt(squares / static_cast<double>(scatters.size()));
  if (!(sd > kRounding)) return figures;
  figures.sd = sd;
  const double r = neighbours / squares;
  if (r > 0.05 && r < 1) figures.correlation_s = -period / std::log(r);
  return figures;
}

std::vector<ClippedFigures> clipped_in(const Series& commands) {
  std::vector<ClippedFigures> found;
  for (std::size_t k = 0; k < commands.columns.size(); ++k) {
    for (const int sign : {1, -1}) {
      double extreme = -std::numeric_limits<double>::infinity();
      for (std::size_t row = 0; row < commands.rows(); ++row)
        extreme = std::fmax(extreme, sign * commands.at(row, k));
      // Cut off is what comes in at half its highest speed or more and stops dead, twice or more;
      // the end of a smooth motion slows down before.
      double fastest = 0;
      for (std::size_t row = 1; row < commands.rows(); ++row)
        fastest = std::fmax(fastest, std::fabs(commands.at(row, k) - commands.at(row - 1, k)));
      ClippedFigures figures{commands.columns[k], sign * extreme};
      for (std::size_t row = 2; row + 2 < commands.rows(); ++row) {
        const auto value = [&](std::size_t at) { return sign * commands.at(at, k); };
        if (!(value(row) == extreme && value(row - 1) < extreme)) continue;
        std::size_t end = row;
        while (end < commands.rows() && value(end) == extreme) ++end;
        if (end - row < 3 || !(value(row - 1) - value(row - 2) > 0.5 * fastest)) continue;
        ++figures.stretches;
        figures.rows += end - row;
      }
      if (figures.stretches >= 2) found.push_back(figures);
    }
  }
  return found;
}

}  // namespace

Series cloud_centres(const Recording& recording) {
  Series centres;
  for (std::size_t k = 0; k < recording.clouds.size(); ++k) {
    const Cloud cloud = recording.clouds.fetch(k);
    if (cloud.empty()) continue;
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3f& p : cloud) centre += p.cast<double>();
    centre /= static_cast<double>(cloud.size());
    centres.time_ns.push_back(recording.clouds.time_ns[k]);
    centres.values.insert(centres.values.end(), centre.begin(), centre.end());
  }
  if (centres.rows() > 0) centres.columns = {"centre_x_m", "centre_y_m", "centre_z_m"};
  return centres;
}

namespace {

const Series* reference_of(const Recording& recording, std::string& topic) {
  for (const char* name : {"tool_commanded", "joints_commanded", "tool", "joints", "markers"}) {
    topic = name;
    if (const Series* series = recording.find(topic)) return series;
  }
  return nullptr;
}

void add_clock(const std::string& topic, const Series& series, const std::string& reference_topic,
               const Series& reference, IntakeFigures& figures) {
  constexpr double kSure = 0.9;  // correlation
  // A jaw is another motion: when it closes says nothing of its clock.
  if (topic == reference_topic || topic == "jaw" || series.rows() < 20) return;
  // Samples of one row have one clock, however late one of them follows.
  if (series.time_ns == reference.time_ns) return;
  const double begin = seconds(std::max(series.time_ns.front(), reference.time_ns.front()));
  const double end = seconds(std::min(series.time_ns.back(), reference.time_ns.back()));
  ClockFigures clock{topic, reference_topic};
  if (!find_offset(reference, series, begin, end, clock) || clock.correlation < kSure) return;
  ClockFigures first, second;
  const double middle = 0.5 * (begin + end);
  if (find_offset(reference, series, begin, middle, first) && first.correlation > 0.9 &&
      find_offset(reference, series, middle, end, second) && second.correlation > 0.9) {
    const double apart = middle - begin;
    constexpr double kMostDrift = 1e4;  // [ppm] of clocks that are none
    if (std::fabs(second.offset_s - first.offset_s) > 1e-6 * kMostDrift * apart) return;
    clock.sd_s = std::max(clock.sd_s, 0.5 * std::fabs(second.offset_s - first.offset_s));
    clock.drift_ppm = 1e6 * (second.offset_s - first.offset_s) / apart;
    clock.drift_sd_ppm = 1e6 * std::hypot(first.sd_s, second.sd_s) / apart;
  }
  figures.clocks.push_back(clock);
}

}  // namespace

IntakeFigures take_in(const Recording& recording) {
  IntakeFigures figures;
  std::map<std::string, Series> all = recording.series;
  if (Series centres = cloud_centres(recording); centres.rows() > 0) all["cloud"] = centres;
  for (const auto& [topic, series] : all)
    figures.sampling.push_back(sampling_of(topic, series.time_ns));
  for (const auto& [topic, images] :
       {std::pair{"depth", &recording.depth}, {"color", &recording.color}}) {
    if (images->size() > 0) figures.sampling.push_back(sampling_of(topic, images->time_ns));
  }
  std::string reference_topic;
  const Series* reference = reference_of(recording, reference_topic);
  std::vector<std::pair<double, double>> holds;
  if (reference != nullptr && is_command(reference_topic)) holds = holds_of(*reference);
  for (const auto& [topic, series] : all) {
    if (is_command(topic)) {
      const auto clipped = clipped_in(series);
      figures.clipped.insert(figures.clipped.end(), clipped.begin(), clipped.end());
    }
    if (recording.info.samples_at_rest()) continue;  // times are only counted
    if (reference != nullptr) add_clock(topic, series, reference_topic, *reference, figures);
    if (is_command(topic) || series.rows() < kFewest) continue;
    for (const std::string& unit : units_of(series)) {
      NoiseFigures noise = noise_of(topic, unit, series, holds);
      if (noise.windows > 0) figures.noise.push_back(std::move(noise));
    }
  }
  return figures;
}

bool compare_repeats(const std::vector<const Series*>& all, FloorFigures& floor) {
  floor.repeats = all.size();
  double length = std::numeric_limits<double>::infinity();
  for (const Series* series : all)
    length = std::min(length, seconds(series->time_ns.back() - series->time_ns.front()));
  const Series& first = *all.front();
  constexpr double kMostSteps = 1e6;  // of a record with a gap of years in it
  const double step = std::max(median_period(first), length / kMostSteps);
  double squares = 0, count = 0;
  for (std::size_t k = 0; step > 0 && k < first.columns.size(); ++k) {
    if (unit_of(first.columns[k]) != floor.unit) continue;
    std::vector<Interpolated> curves;
    for (const Series* series : all) curves.emplace_back(*series, k);
    for (double t = 0; t <= length; t += step) {
      std::vector<double> values;
      for (std::size_t r = 0; r < all.size(); ++r)
        values.push_back(curves[r].at(seconds(all[r]->time_ns.front()) + t));
      double mean = 0, low = values.front(), high = low;
      for (const double value : values) {
        mean += value / static_cast<double>(values.size());
        low = std::min(low, value);
        high = std::max(high, value);
      }
      if (!std::isfinite(mean)) continue;
      for (const double value : values) squares += (value - mean) * (value - mean);
      count += static_cast<double>(values.size() - 1);
      floor.largest = std::max(floor.largest, high - low);
    }
  }
  floor.rms = count > 0 ? std::sqrt(squares / count) : 0;
  return count > 0;
}

namespace {

/// Columns of a channel less the same ones of its commands; none where these lack one.
Series less_command(const Series& measured, const Series& commanded) {
  Series made;
  made.time_ns = measured.time_ns;
  std::vector<std::size_t> columns;
  std::vector<Interpolated> commands;
  for (std::size_t k = 0; k < measured.columns.size(); ++k) {
    std::string name = measured.columns[k];
    const std::size_t at = name.find("_measured_");
    // Of an orientation numbers have no difference.
    if (at == std::string::npos || name.find("_q", at) != std::string::npos) continue;
    name.replace(at, std::string("_measured_").size(), "_commanded_");
    const std::size_t command = commanded.find(name);
    if (command == commanded.columns.size()) continue;
    made.columns.push_back(measured.columns[k]);
    columns.push_back(k);
    commands.emplace_back(commanded, command);
  }
  for (std::size_t row = 0; row < measured.rows(); ++row) {
    for (std::size_t k = 0; k < columns.size(); ++k)
      made.values.push_back(measured.at(row, columns[k]) -
                            commands[k].at(seconds(measured.time_ns[row])));
  }
  return made;
}

}  // namespace

std::vector<FloorFigures> repeatability(const std::vector<const Recording*>& repeats) {
  std::vector<FloorFigures> found;
  if (repeats.size() < 2) return found;
  const auto compare = [&](const std::string& topic, const std::vector<const Series*>& all,
                           const std::string& less) {
    for (const std::string& unit : units_of(*all.front())) {
      FloorFigures floor{topic, unit};
      floor.less = less;
      if (compare_repeats(all, floor)) found.push_back(floor);
    }
  };
  for (const auto& [topic, first] : repeats.front()->series) {
    if (is_command(topic)) continue;
    std::vector<const Series*> all;
    std::vector<Series> less;
    for (const Recording* recording : repeats) {
      const Series* series = recording->find(topic);
      if (series == nullptr || series->columns != first.columns) continue;
      all.push_back(series);
      const Series* commands = recording->find(topic + "_commanded");
      if (commands != nullptr) less.push_back(less_command(*series, *commands));
    }
    if (all.size() < repeats.size()) continue;
    compare(topic, all, "");
    const bool same = std::all_of(less.begin(), less.end(), [&](const Series& one) {
      return !one.columns.empty() && one.columns == less.front().columns;
    });
    if (less.size() < repeats.size() || !same) continue;
    std::vector<const Series*> rests;
    for (const Series& one : less) rests.push_back(&one);
    compare(topic, rests, "its command");
  }
  return found;
}

}  // namespace omentum
