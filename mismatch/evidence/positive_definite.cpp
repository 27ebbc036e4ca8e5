#include "mismatch/evidence/positive_definite.h"

#include <Eigen/Eigenvalues>

namespace omentum {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

/// A pivot is the part of a number's information that the numbers before it do not explain. Below
/// this share it is rounding of sums of some 1e5 rows.
constexpr double kLeastPivot = 1e-13;

/// Number that lies most along the direction of least information, every number in its own scale.
std::string least_determined(const MatrixXd& matrix, const std::vector<std::string>& names) {
  if (!matrix.allFinite()) return "one that is not finite";
  VectorXd scale = matrix.diagonal().cwiseAbs().cwiseSqrt();
  for (double& s : scale) s = s > 0 ? 1 / s : 1;
  const MatrixXd scaled = scale.asDiagonal() * matrix * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(scaled);
  Eigen::Index most = 0;
  eigen.eigenvectors().col(0).cwiseAbs().maxCoeff(&most);
  return names[static_cast<std::size_t>(most)];
}

}  // namespace

Result<CholeskyFactor> factorise(const MatrixXd& matrix, const std::vector<std::string>& names) {
  CholeskyFactor factor(matrix);
  bool definite = factor.info() == Eigen::Success && matrix.allFinite();
  for (Eigen::Index i = 0; definite && i < matrix.rows(); ++i) {
    const double pivot = factor.matrixLLT()(i, i);
    definite = pivot * pivot > kLeastPivot * matrix(i, i);
  }
  if (definite) return factor;
  return Failure{"data and prior leave numbers open: " + least_determined(matrix, names)};
}

double log_determinant(const CholeskyFactor& factor) {
  return 2 * factor.matrixLLT().diagonal().array().log().sum();
}

}  // namespace omentum
