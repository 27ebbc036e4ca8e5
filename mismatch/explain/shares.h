#pragma once

#include <Eigen/Core>
#include <vector>

namespace omentum {

/// Weights of stacking [Yao18]: the mixture of models that foretells left-out folds best, the
/// maximum over the simplex of the sum over folds of log sum_k w_k exp(log_density). They decide
/// nothing (docs/mismatch.md 5.4). `log_density` [folds x models], up to a constant of each fold,
/// as FoldGain::against_zero with a column of zeros for the base. The weights sum to one.
Eigen::VectorXd stacking_weights(const Eigen::MatrixXd& log_density);

}  // namespace omentum
