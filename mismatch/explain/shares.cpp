#include "mismatch/explain/shares.h"

#include <cmath>

namespace omentum {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

VectorXd stacking_weights(const MatrixXd& log_density) {
  constexpr int kSteps = 2000;  // of expectation and maximisation; each can only raise the sum
  const Index folds = log_density.rows(), models = log_density.cols();
  VectorXd weight = VectorXd::Constant(models, 1.0 / static_cast<double>(models));
  if (folds == 0) return weight;
  MatrixXd density = log_density.colwise() - log_density.rowwise().maxCoeff();
  density = density.array().exp().matrix();
  for (int step = 0; step < kSteps; ++step) {
    const VectorXd mixture = density * weight;
    weight.array() *=
        (density.transpose() * mixture.cwiseInverse()).array() / static_cast<double>(folds);
    weight /= weight.sum();
  }
  return weight;
}

}  // namespace omentum
