#include "core/decompositions.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/SVD>

namespace omentum {

SingularValues singular_values(const Eigen::MatrixXd& A) {
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(A, Eigen::ComputeThinU | Eigen::ComputeThinV);
  return {svd.matrixU(), svd.singularValues(), svd.matrixV()};
}

SingularValues3 singular_values(const Eigen::Matrix3d& A) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(A, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return {svd.matrixU(), svd.singularValues(), svd.matrixV()};
}

PrincipalAxes3 principal_axes(const Eigen::Matrix3d& A) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(A);
  return {solver.eigenvectors(), solver.eigenvalues()};
}

PrincipalAxes principal_axes(const Eigen::MatrixXd& A) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(A);
  return {solver.eigenvectors(), solver.eigenvalues()};
}

Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& A) {
  const SingularValues3 svd = singular_values(A);
  // The best orthogonal matrix may be a reflection; the best rotation then turns the weakest
  // direction round.
  Eigen::Vector3d signs = Eigen::Vector3d::Ones();
  if (svd.U.determinant() * svd.V.determinant() < 0) signs.z() = -1;
  return svd.U * signs.asDiagonal() * svd.V.transpose();
}

}  // namespace omentum
