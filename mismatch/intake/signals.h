#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "mismatch/recording/recording.h"

namespace omentum {

/// Middle value; NaN of none.
double median(std::vector<double> values);

/// Median distance of the rows [s]; 0 of one row.
double median_period(const Series& series);

/// Value of a column at a time, linear between the rows that know it; NaN outside of them.
class Interpolated {
 public:
  Interpolated(const Series& series, std::size_t column);
  double at(double t_s) const;

 private:
  std::vector<double> time_, value_;
};

/// Scatter about a line, with its correlation from one sample to the next.
struct Scatter {
  double sd = 0, neighbour_correlation = 0;
};
/// Needs 4 values or more, evenly spaced.
Scatter scatter_about_line(const std::vector<double>& values);

/// Main motions of a channel, a row a time of an even grid: of its positions that move, in units of
/// what moves most of each kind (m, rad), the three combinations that move most; of a channel
/// without positions of its forces. No columns where nothing moves or the channel does not cover
/// the grid.
Eigen::MatrixXd main_motions(const Series& series, double begin_s, double step_s,
                             std::size_t count);

}  // namespace omentum
