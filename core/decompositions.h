#pragma once

#include <Eigen/Core>

// Eigen's decompositions that several folders need, each compiled once: one of them takes a
// compiler five to ten seconds in every source that names it. Pure functions. Numbers must be
// finite.

namespace omentum {

/// A = U diag(values) V^T, values from the largest to the smallest (Eigen's one-sided Jacobi).
struct SingularValues {
  Eigen::MatrixXd U;  ///< as many columns as the smaller side of A
  Eigen::VectorXd values;
  Eigen::MatrixXd V;
};
SingularValues singular_values(const Eigen::MatrixXd& A);

struct SingularValues3 {
  Eigen::Matrix3d U;
  Eigen::Vector3d values;
  Eigen::Matrix3d V;
};
SingularValues3 singular_values(const Eigen::Matrix3d& A);

/// A = axes diag(values) axes^T of a symmetric A (its lower triangle is read), values ascending.
struct PrincipalAxes3 {
  Eigen::Matrix3d axes;
  Eigen::Vector3d values;
};
PrincipalAxes3 principal_axes(const Eigen::Matrix3d& A);

struct PrincipalAxes {
  Eigen::MatrixXd axes;
  Eigen::VectorXd values;
};
PrincipalAxes principal_axes(const Eigen::MatrixXd& A);

/// The rotation R that makes trace(R^T A) largest [Umeyama91]: of A = sum of to from^T about their
/// centres it turns `from` onto `to`.
Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& A);

}  // namespace omentum
