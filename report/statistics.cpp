#include "report/statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace omentum {

Proportion wilson(int successes, int trials) {
  Proportion p{successes, trials, 0, 0, 1};
  if (trials <= 0) return p;
  constexpr double z = 1.959963985;  // 97.5 % point of the normal distribution
  const double n = trials;
  p.share = successes / n;
  const double centre = (p.share + z * z / (2 * n)) / (1 + z * z / n);
  const double half =
      z / (1 + z * z / n) * std::sqrt(p.share * (1 - p.share) / n + z * z / (4 * n * n));
  p.low = std::max(0.0, centre - half);
  p.high = std::min(1.0, centre + half);
  return p;
}

namespace {

double interpolate(const Curve& curve, double x) {
  const auto after = std::lower_bound(curve.x.begin(), curve.x.end(), x);
  if (after == curve.x.begin()) return curve.y.front();
  if (after == curve.x.end()) return curve.y.back();
  const auto k = static_cast<std::size_t>(after - curve.x.begin());
  const double width = curve.x[k] - curve.x[k - 1];
  const double share = width > 0 ? (x - curve.x[k - 1]) / width : 1;
  return curve.y[k - 1] + share * (curve.y[k] - curve.y[k - 1]);
}

}  // namespace

Band band_of(const std::vector<Curve>& curves, int points) {
  std::vector<Curve> clean;
  for (const Curve& curve : curves) {
    Curve kept;
    for (std::size_t k = 0; k < std::min(curve.x.size(), curve.y.size()); ++k) {
      if (!std::isfinite(curve.x[k]) || !std::isfinite(curve.y[k])) continue;
      if (!kept.x.empty() && curve.x[k] < kept.x.back())
        continue;  // a resumed run repeats its last rows
      kept.x.push_back(curve.x[k]);
      kept.y.push_back(curve.y[k]);
    }
    if (!kept.x.empty()) clean.push_back(std::move(kept));
  }
  Band band;
  if (clean.empty()) return band;
  double first = -std::numeric_limits<double>::infinity();
  double last = std::numeric_limits<double>::infinity();
  for (const Curve& curve : clean) {
    first = std::max(first, curve.x.front());
    last = std::min(last, curve.x.back());
  }
  if (!(last >= first)) return band;
  for (int k = 0; k < points; ++k) {
    const double x = first + (last - first) * k / std::max(1, points - 1);
    double sum = 0;
    double low = std::numeric_limits<double>::infinity();
    double high = -low;
    for (const Curve& curve : clean) {
      const double y = interpolate(curve, x);
      sum += y;
      low = std::min(low, y);
      high = std::max(high, y);
    }
    band.x.push_back(x);
    band.mean.push_back(sum / static_cast<double>(clean.size()));
    band.low.push_back(low);
    band.high.push_back(high);
  }
  return band;
}

std::vector<double> smoothed(const std::vector<double>& values, int width) {
  std::vector<double> result;
  const auto count = static_cast<int>(values.size());
  for (int k = 0; k < count; ++k) {
    double sum = 0;
    int used = 0;
    for (int j = std::max(0, k - width / 2); j <= std::min(count - 1, k + width / 2); ++j) {
      const double value = values[static_cast<std::size_t>(j)];
      if (std::isfinite(value)) sum += value, ++used;
    }
    result.push_back(used > 0 ? sum / used : std::numeric_limits<double>::quiet_NaN());
  }
  return result;
}

double mean_of(const std::vector<double>& values) {
  double sum = 0;
  int used = 0;
  for (const double value : values) {
    if (std::isfinite(value)) sum += value, ++used;
  }
  return used > 0 ? sum / used : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace omentum
