#include "mismatch/intake/signals.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <string_view>

#include "core/decompositions.h"

namespace omentum {

double median(std::vector<double> values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>((values.size() - 1) / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double median_period(const Series& series) {
  std::vector<double> periods;
  for (std::size_t k = 1; k < series.rows(); ++k)
    periods.push_back(1e-9 * static_cast<double>(series.time_ns[k] - series.time_ns[k - 1]));
  return periods.empty() ? 0 : median(std::move(periods));
}

Interpolated::Interpolated(const Series& series, std::size_t column) {
  for (std::size_t row = 0; row < series.rows(); ++row) {
    if (std::isnan(series.at(row, column))) continue;
    time_.push_back(1e-9 * static_cast<double>(series.time_ns[row]));
    value_.push_back(series.at(row, column));
  }
}

double Interpolated::at(double t) const {
  if (time_.empty() || t < time_.front() || t > time_.back())
    return std::numeric_limits<double>::quiet_NaN();
  const auto after = std::upper_bound(time_.begin(), time_.end(), t);
  if (after == time_.end()) return value_.back();
  const auto k = static_cast<std::size_t>(after - time_.begin());
  const double share = (t - time_[k - 1]) / (time_[k] - time_[k - 1]);
  return value_[k - 1] + share * (value_[k] - value_[k - 1]);
}

Scatter scatter_about_line(const std::vector<double>& values) {
  const auto n = static_cast<double>(values.size());
  double mean = 0, slope = 0, spread = 0;
  for (const double value : values) mean += value / n;
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double x = static_cast<double>(k) - 0.5 * (n - 1);
    slope += x * (values[k] - mean);
    spread += x * x;
  }
  slope /= spread;
  double squares = 0, neighbours = 0, before = 0;
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double x = static_cast<double>(k) - 0.5 * (n - 1);
    const double left = values[k] - mean - slope * x;
    squares += left * left;
    if (k > 0) neighbours += left * before;
    before = left;
  }
  return {std::sqrt(squares / (n - 2)), squares > 0 ? neighbours / squares : 0};
}

namespace {

/// m of "tip_measured_x_m"; empty of a quaternion.
std::string_view unit_at_end(std::string_view column) {
  for (const std::string_view unit : {"_rad_per_s", "_m_per_s", "_rad", "_Nm", "_Pa", "_m", "_N"}) {
    if (column.ends_with(unit)) return unit;
  }
  return "";
}

/// Columns that tell where something is; where there are none, forces; else all. Velocities and
/// efforts of a channel with positions shake where these move.
std::vector<std::size_t> columns_of_motion(const Series& series) {
  const auto of = [&](std::initializer_list<std::string_view> units) {
    std::vector<std::size_t> found;
    for (std::size_t k = 0; k < series.columns.size(); ++k) {
      const std::string_view unit = unit_at_end(series.columns[k]);
      if (std::find(units.begin(), units.end(), unit) != units.end()) found.push_back(k);
    }
    return found;
  };
  std::vector<std::size_t> columns = of({"_m", "_rad"});
  if (columns.empty()) columns = of({"_N"});
  if (columns.empty()) {
    columns.resize(series.columns.size());
    std::iota(columns.begin(), columns.end(), std::size_t{0});
  }
  constexpr std::size_t kMostColumns = 60;  // of markers some tell enough
  const std::size_t stride = std::max<std::size_t>(1, columns.size() / kMostColumns);
  std::vector<std::size_t> some;
  for (std::size_t k = 0; k < columns.size(); k += stride) some.push_back(columns[k]);
  return some;
}

/// What of a column is no motion: from how its neighbours differ, of a normal distribution.
double noise_in(const Series& series, std::size_t column) {
  std::vector<double> bends;
  for (std::size_t row = 1; row + 1 < series.rows(); ++row) {
    const double bend =
        series.at(row - 1, column) - 2 * series.at(row, column) + series.at(row + 1, column);
    if (std::isfinite(bend)) bends.push_back(std::fabs(bend));
  }
  return bends.empty() ? 0 : 1.4826 * median(std::move(bends)) / std::sqrt(6.0);
}

}  // namespace

Eigen::MatrixXd main_motions(const Series& series, double begin_s, double step_s,
                             std::size_t count) {
  constexpr double kMoves = 4;         // its scatter is so many times its noise
  constexpr double kOfLargest = 0.05;  // of what moves most, in its unit
  struct Column {
    Eigen::VectorXd values;
    std::string_view unit;
    double sd = 0, clear = 0;
  };
  std::vector<Column> columns;
  for (const std::size_t k : columns_of_motion(series)) {
    const Interpolated column(series, k);
    Column made{Eigen::VectorXd(static_cast<Eigen::Index>(count)), unit_at_end(series.columns[k])};
    for (Eigen::Index i = 0; i < made.values.size(); ++i)
      made.values[i] = column.at(begin_s + step_s * static_cast<double>(i));
    if (!made.values.allFinite()) continue;
    const double mean = made.values.mean();
    made.values.array() -= mean;
    made.sd = std::sqrt(made.values.array().square().mean());
    if (!(made.sd > 1e-12 * std::max(1.0, std::fabs(mean)))) continue;
    made.clear = made.sd / (noise_in(series, k) + 1e-12 * made.sd);
    columns.push_back(std::move(made));
  }
  Eigen::MatrixXd motion(static_cast<Eigen::Index>(count), 0);
  if (columns.empty()) return motion;
  // An axis at rest has nothing but noise. Where samples are so rare that motion looks like noise,
  // the clearest unit counts.
  const auto clearest = std::ranges::max_element(columns, {}, &Column::clear);
  const std::string_view clearest_unit = clearest->unit;
  if (clearest->clear >= kMoves) {
    std::erase_if(columns, [](const Column& column) { return column.clear < kMoves; });
  } else {
    std::erase_if(columns, [&](const Column& column) { return column.unit != clearest_unit; });
  }
  std::map<std::string_view, double> largest;
  for (const Column& column : columns)
    largest[column.unit] = std::max(largest[column.unit], column.sd);
  for (const Column& column : columns) {
    if (column.sd < kOfLargest * largest[column.unit]) continue;
    motion.conservativeResize(Eigen::NoChange, motion.cols() + 1);
    motion.col(motion.cols() - 1) = column.values / largest[column.unit];
  }
  const Eigen::MatrixXd together = motion.transpose() * motion;
  return motion * principal_axes(together).axes.rightCols(std::min<Eigen::Index>(3, motion.cols()));
}

}  // namespace omentum
