#pragma once

#include <vector>

namespace omentum {

/// Share of successes with its 95 % interval.
struct Proportion {
  int successes = 0, trials = 0;
  double share = 0, low = 0, high = 1;
};

/// Wilson score interval [Wilson27]: stays inside [0, 1] and is honest at 0 and n of n.
Proportion wilson(int successes, int trials);

/// A curve over seeds on common abscissae.
struct Band {
  std::vector<double> x, mean, low, high;
};

/// One seed's curve; x ascending. Points with a non-finite value are left out.
struct Curve {
  std::vector<double> x, y;
};

/// Mean, minimum and maximum over the curves at `points` equally spaced abscissae of the range that
/// all curves cover, by linear interpolation. Empty if there is no such range.
Band band_of(const std::vector<Curve>& curves, int points = 200);

/// Centred moving average over `width` points (an odd number; 1 = unchanged).
std::vector<double> smoothed(const std::vector<double>& values, int width);

/// Mean of the finite values, NaN if there is none.
double mean_of(const std::vector<double>& values);

}  // namespace omentum
