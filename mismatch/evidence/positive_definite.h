#pragma once

#include <Eigen/Cholesky>
#include <string>
#include <vector>

#include "core/result.h"

namespace omentum {

using CholeskyFactor = Eigen::LLT<Eigen::MatrixXd>;

/// Factorises an information matrix, prior included. It fails where data and prior leave a number
/// open, and names the one that lies most along what is open. `names` has one entry per row.
Result<CholeskyFactor> factorise(const Eigen::MatrixXd& matrix,
                                 const std::vector<std::string>& names);

double log_determinant(const CholeskyFactor& factor);

}  // namespace omentum
