#include "core/decompositions.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;

constexpr double kRounding = 1e-13;

Matrix3d some_matrix() {
  Matrix3d A;
  A << 2, -1, 0.5, 0.3, 1.5, -0.7, -0.2, 0.9, 3;
  return A;
}

TEST(Decompositions, SingularValuesGiveTheMatrixBack) {
  MatrixXd tall(5, 3);
  tall << some_matrix(), 1, 2, 3, -4, 0.5, 0.1;
  const SingularValues svd = singular_values(tall);
  EXPECT_LT((svd.U * svd.values.asDiagonal() * svd.V.transpose() - tall).norm(), kRounding);
  EXPECT_LT((svd.U.transpose() * svd.U - MatrixXd::Identity(3, 3)).norm(), kRounding);
  EXPECT_TRUE(svd.values[0] >= svd.values[1] && svd.values[1] >= svd.values[2]);
  const SingularValues3 small = singular_values(some_matrix());
  EXPECT_LT((small.U * small.values.asDiagonal() * small.V.transpose() - some_matrix()).norm(),
            kRounding);
}

TEST(Decompositions, PrincipalAxesGiveTheMatrixBackFromItsLowerTriangle) {
  const Matrix3d A = some_matrix() + some_matrix().transpose();
  Matrix3d lower = A;
  lower(0, 1) = lower(0, 2) = lower(1, 2) = 77;
  const PrincipalAxes3 principal = principal_axes(lower);
  EXPECT_LT(
      (principal.axes * principal.values.asDiagonal() * principal.axes.transpose() - A).norm(),
      kRounding);
  const PrincipalAxes large = principal_axes(MatrixXd(A));
  EXPECT_LT((large.values - principal.values).norm(), kRounding);
  EXPECT_TRUE(large.values[0] <= large.values[1] && large.values[1] <= large.values[2]);
}

// Neither a small turn away from it nor the better mirror image counts.
TEST(Decompositions, NearestRotationHasTheLargestTraceOfAllRotations) {
  for (const double sign : {1.0, -1.0}) {
    const Matrix3d A = sign * some_matrix();
    const Matrix3d R = nearest_rotation(A);
    EXPECT_LT((R * R.transpose() - Matrix3d::Identity()).norm(), kRounding);
    EXPECT_NEAR(R.determinant(), 1, kRounding);
    for (int axis = 0; axis < 3; ++axis) {
      for (const double angle : {-0.1, 0.1, 3.0}) {
        const Matrix3d turned = Eigen::AngleAxisd(angle, Vector3d::Unit(axis)) * R;
        EXPECT_LT((turned.transpose() * A).trace(), (R.transpose() * A).trace());
      }
    }
  }
}

}  // namespace
}  // namespace omentum
