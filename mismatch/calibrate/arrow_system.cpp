#include "mismatch/calibrate/arrow_system.h"

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

ArrowStep solve_arrow(std::span<const Block* const> blocks, const Layout& layout,
                      const Beliefs& beliefs, const VectorXd& shared, std::span<const VectorXd> own,
                      double information, const std::vector<bool>& fixed) {
  const int s = layout.shared(), o = layout.own();
  const VectorXd shared_precision = beliefs.shared_sd.cwiseAbs2().cwiseInverse();
  const VectorXd own_precision = beliefs.own_sd.cwiseAbs2().cwiseInverse();
  MatrixXd S = shared_precision.asDiagonal();
  VectorXd r = -shared_precision.cwiseProduct(shared);
  MatrixXd S_sure = S;  // the same with the information of the rows
  struct Part {
    Eigen::LLT<MatrixXd> own, sure;
    MatrixXd cross;
    VectorXd g;
  };
  std::vector<Part> parts;
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    const Block& block = *blocks[k];
    Part& part = parts.emplace_back();
    MatrixXd own_block = block.A.bottomRightCorner(o, o);
    part.cross = block.A.bottomLeftCorner(o, s);
    MatrixXd sure = information * own_block;
    own_block.diagonal() += own_precision;
    sure.diagonal() += own_precision;
    part.own.compute(own_block);
    part.sure.compute(sure);
    part.g = block.b.tail(o) - own_precision.cwiseProduct(own[k]);
    S += block.A.topLeftCorner(s, s) - part.cross.transpose() * part.own.solve(part.cross);
    S_sure += information * block.A.topLeftCorner(s, s) -
              information * information * part.cross.transpose() * part.sure.solve(part.cross);
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
  ArrowStep step;
  step.shared = S.llt().solve(r);
  const Eigen::LLT<MatrixXd> shared_sure = S_sure.llt();
  step.shared_covariance = shared_sure.solve(MatrixXd::Identity(s, s));
  step.log_determinant = log_determinant(shared_sure);
  for (const Part& part : parts) {
    step.log_determinant += log_determinant(part.sure);
    step.own.push_back(part.own.solve(part.g - part.cross * step.shared));
    const MatrixXd gain = information * part.sure.solve(part.cross);
    const MatrixXd covariance = part.sure.solve(MatrixXd::Identity(o, o)) +
                                gain * step.shared_covariance * gain.transpose();
    step.own_sd.push_back(covariance.diagonal().cwiseMax(0).cwiseSqrt());
  }
  return step;
}

double robust_scale(std::span<const Block* const> blocks, std::vector<double> Block::*deviations,
                    double least) {
  std::vector<double> all;
  for (const Block* block : blocks) {
    for (const double e : block->*deviations) all.push_back(std::fabs(e));
  }
  if (all.empty()) return least;
  const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::nth_element(all.begin(), middle, all.end());
  return std::max(least, 1.4826 * *middle);
}

double row_information(std::span<const Block* const> blocks, const NoiseModel& noise) {
  double weights = 0, squares = 0, slopes = 0, count = 0;
  for (const Block* block : blocks) {
    for (const double e : block->deviation) {
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

}  // namespace omentum
