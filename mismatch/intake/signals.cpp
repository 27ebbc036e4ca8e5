#include "mismatch/intake/signals.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

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

Eigen::MatrixXd main_motions(const Series& series, double begin_s, double step_s,
                             std::size_t count) {
  Eigen::MatrixXd motion(static_cast<Eigen::Index>(count), 0);
  constexpr std::size_t kMostColumns = 60;  // of markers some tell enough
  const std::size_t stride = std::max<std::size_t>(1, series.columns.size() / kMostColumns);
  for (std::size_t k = 0; k < series.columns.size(); k += stride) {
    const Interpolated column(series, k);
    Eigen::VectorXd values(motion.rows());
    for (Eigen::Index i = 0; i < values.size(); ++i)
      values[i] = column.at(begin_s + step_s * static_cast<double>(i));
    if (!values.allFinite()) continue;
    const double mean = values.mean();
    const double sd = std::sqrt((values.array() - mean).square().mean());
    if (!(sd > 1e-12 * std::max(1.0, std::fabs(mean)))) continue;
    motion.conservativeResize(Eigen::NoChange, motion.cols() + 1);
    motion.col(motion.cols() - 1) = (values.array() - mean) / sd;
  }
  if (motion.cols() == 0) return motion;
  const Eigen::MatrixXd together = motion.transpose() * motion;
  return motion * principal_axes(together).axes.rightCols(std::min<Eigen::Index>(3, motion.cols()));
}

}  // namespace omentum
