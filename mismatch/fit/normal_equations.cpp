#include "mismatch/fit/normal_equations.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace omentum {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

double log_determinant(const Eigen::LLT<MatrixXd>& factor) {
  return 2 * MatrixXd(factor.matrixL()).diagonal().array().log().sum();
}

}  // namespace

FitPosterior solve_normal_equations(std::span<const NormalEquations> recordings,
                                    const Layout& layout, const Beliefs& beliefs,
                                    const VectorXd& shared, std::span<const VectorXd> own,
                                    double information, const std::vector<bool>& fixed) {
  const int s = layout.shared(), o = layout.own();
  const VectorXd shared_precision = beliefs.shared_sd.cwiseAbs2().cwiseInverse();
  const VectorXd own_precision = beliefs.own_sd.cwiseAbs2().cwiseInverse();
  MatrixXd S = shared_precision.asDiagonal();
  VectorXd r = -shared_precision.cwiseProduct(shared);
  MatrixXd S_informed = S;  // the same with the information of the rows
  struct Part {
    Eigen::LLT<MatrixXd> own, informed;
    MatrixXd cross;
    VectorXd g;
  };
  std::vector<Part> parts;
  for (std::size_t k = 0; k < recordings.size(); ++k) {
    const NormalEquations& block = recordings[k];
    Part& part = parts.emplace_back();
    MatrixXd own_block = block.A.bottomRightCorner(o, o);
    part.cross = block.A.bottomLeftCorner(o, s);
    MatrixXd informed = information * own_block;
    own_block.diagonal() += own_precision;
    informed.diagonal() += own_precision;
    part.own.compute(own_block);
    part.informed.compute(informed);
    part.g = block.b.tail(o) - own_precision.cwiseProduct(own[k]);
    S += block.A.topLeftCorner(s, s) - part.cross.transpose() * part.own.solve(part.cross);
    S_informed += information * block.A.topLeftCorner(s, s) - information * information *
                                                                  part.cross.transpose() *
                                                                  part.informed.solve(part.cross);
    r += block.b.head(s) - part.cross.transpose() * part.own.solve(part.g);
  }
  for (std::size_t k = 0; k < fixed.size(); ++k) {
    if (!fixed[k]) continue;
    const auto at = static_cast<Eigen::Index>(k);
    S.row(at).setZero();
    S.col(at).setZero();
    S(at, at) = 1;
    r[at] = 0;
  }
  FitPosterior found;
  found.shared_step = S.llt().solve(r);
  const Eigen::LLT<MatrixXd> shared_informed = S_informed.llt();
  found.shared_covariance = shared_informed.solve(MatrixXd::Identity(s, s));
  found.log_determinant = log_determinant(shared_informed);
  for (const Part& part : parts) {
    found.log_determinant += log_determinant(part.informed);
    found.own_step.push_back(part.own.solve(part.g - part.cross * found.shared_step));
    const MatrixXd gain = information * part.informed.solve(part.cross);
    const MatrixXd covariance = part.informed.solve(MatrixXd::Identity(o, o)) +
                                gain * found.shared_covariance * gain.transpose();
    found.own_sd.push_back(covariance.diagonal().cwiseMax(0).cwiseSqrt());
  }
  return found;
}

double robust_scale(std::span<const NormalEquations> recordings,
                    std::vector<double> NormalEquations::*deviations, double least) {
  std::vector<double> all;
  for (const NormalEquations& recording : recordings) {
    for (const double e : recording.*deviations) all.push_back(std::fabs(e));
  }
  if (all.empty()) return least;
  const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::nth_element(all.begin(), middle, all.end());
  return std::max(least, 1.4826 * *middle);
}

double row_information(std::span<const NormalEquations> recordings, const NoiseModel& noise) {
  double weights = 0, squares = 0, slopes = 0, count = 0;
  for (const NormalEquations& recording : recordings) {
    for (const double e : recording.deviation) {
      const double r2 = e * e / (noise.sigma * noise.sigma);
      const double w = (noise.freedom + 1) / (noise.freedom + r2);
      weights += w;
      squares += w * w * r2;
      slopes += (noise.freedom + 1) * (noise.freedom - r2) /
                ((noise.freedom + r2) * (noise.freedom + r2));
      ++count;
    }
  }
  if (!(count > 0 && squares > 0 && slopes > 0)) return 1;
  return (slopes / count) * (slopes / count) / ((squares / count) * (weights / count));
}

double independent_share(std::span<const NormalEquations> recordings) {
  constexpr double kLeast = 0.01;
  double squares = 0, products = 0;
  for (const NormalEquations& recording : recordings) {
    squares += recording.marker_squares;
    products += recording.marker_products;
  }
  if (!(squares > 0)) return 1;
  const double correlation = std::clamp(products / squares, 0.0, 1.0);
  // Of a first-order process.
  return std::max(kLeast, (1 - correlation) / (1 + correlation));
}

}  // namespace omentum
