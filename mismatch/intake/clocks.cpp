#include "mismatch/intake/clocks.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "mismatch/intake/signals.h"

namespace omentum {

bool find_offset(const Series& a, const Series& b, double begin, double end,
                 ClockFigures& figures) {
  constexpr double kLargestOffset = 1;  // [s]
  constexpr std::size_t kMost = 20'000;
  const double finer = std::min(median_period(a), median_period(b));
  const double step = std::max({finer, 1e-4, (end - begin) / static_cast<double>(kMost)});
  const double reach = std::min(kLargestOffset, (end - begin) / 4);
  const auto lags = static_cast<std::ptrdiff_t>(reach / step);
  const auto count = static_cast<std::ptrdiff_t>((end - begin) / step) + 1;
  if (lags < 2 || count < 4 * lags || count < 20) return false;
  const auto size = static_cast<std::size_t>(count);
  const Eigen::MatrixXd x = main_motions(a, begin, step, size);
  const Eigen::MatrixXd y = main_motions(b, begin, step, size);
  if (x.cols() == 0 || y.cols() == 0) return false;
  const std::ptrdiff_t within = count - 2 * lags;
  const auto centred = [within](const Eigen::MatrixXd& motions, std::ptrdiff_t from) {
    const Eigen::MatrixXd rows = motions.middleRows(from, within);
    return Eigen::MatrixXd(rows.rowwise() - rows.colwise().mean());
  };
  const Eigen::MatrixXd still = centred(x, lags);
  const Eigen::MatrixXd square = still.transpose() * still;
  const Eigen::LDLT<Eigen::MatrixXd> solver(
      square + 1e-9 * square.trace() * Eigen::MatrixXd::Identity(x.cols(), x.cols()));
  // Share of the motion of b that is a linear function of a: what shows the same motion in another
  // frame, or by joints, is found without knowing how.
  const auto correlation = [&](std::ptrdiff_t lag) {
    const Eigen::MatrixXd moved = centred(y, lags + lag);
    const Eigen::MatrixXd across = still.transpose() * moved;
    const double all = moved.squaredNorm();
    const double told = across.cwiseProduct(solver.solve(across)).sum();
    return all > 0 ? std::sqrt(std::clamp(told / all, 0.0, 1.0)) : 0;
  };
  // Long records: a coarse look first, the peak is as wide as the motion is slow.
  const std::ptrdiff_t coarse = std::max<std::ptrdiff_t>(1, lags / 100);
  std::vector<std::pair<std::ptrdiff_t, double>> looks;
  for (std::ptrdiff_t lag = -lags; lag <= lags; lag += coarse)
    looks.emplace_back(lag, correlation(lag));
  const auto lower = [](const auto& p, const auto& q) { return p.second < q.second; };
  const std::ptrdiff_t around = std::max_element(looks.begin(), looks.end(), lower)->first;
  for (std::ptrdiff_t lag = std::max(-lags, around - coarse);
       lag <= std::min(lags, around + coarse); ++lag)
    looks.emplace_back(lag, correlation(lag));
  const auto [best, highest] = *std::max_element(looks.begin(), looks.end(), lower);
  if (best == lags || best == -lags) return false;  // no peak within reach
  const double before = correlation(best - 1), after = correlation(best + 1);
  const double bend = before - 2 * highest + after;
  const double part = bend < 0 ? 0.5 * (before - after) / bend : 0;
  figures.offset_s = (static_cast<double>(best) + part) * step;
  figures.correlation = highest;
  // Likelihood of what is left over, of so many independent samples: offsets within two standard
  // deviations of the best one. A ramp, or steps of one size, fit nearly as well anywhere. What is
  // left over is mostly what no linear function tells, and goes on from sample to sample.
  const Eigen::MatrixXd moved = centred(y, lags + best);
  const Eigen::MatrixXd rest = moved - still * solver.solve(still.transpose() * moved);
  const double squares = rest.squaredNorm();
  const double neighbours =
      rest.topRows(within - 1).cwiseProduct(rest.bottomRows(within - 1)).sum();
  const double memory = squares > 0 ? std::clamp(neighbours / squares, 0.0, 1 - 1e-6) : 0;
  constexpr double kFewest = 4, kMostIndependent = 100;
  const double independent = std::clamp(static_cast<double>(within) * (1 - memory) / (1 + memory),
                                        kFewest, kMostIndependent);
  std::ptrdiff_t low = best - 1, high = best + 1;
  const double left = 1 - highest * highest;
  for (const auto& [lag, c] : looks) {
    if (independent * std::log((1 - c * c + 1e-12) / (left + 1e-12)) > 4) continue;
    low = std::min(low, lag);
    high = std::max(high, lag);
  }
  figures.sd_s = 0.25 * step * static_cast<double>(high - low);
  if (figures.sd_s > reach / 4) return false;  // the motion does not tell
  return true;
}

}  // namespace omentum
