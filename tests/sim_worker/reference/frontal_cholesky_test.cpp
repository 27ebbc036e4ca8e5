// Factor of the tangent of the converged solid.

#include "sim_worker/reference/frontal_cholesky.h"

#include <gtest/gtest.h>

#include <cmath>

#include "support/reference_scene.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

TEST(FrontalCholesky, SolvesAndCountsNegativeEigenvalues) {
  // A grid whose columns have 0 to 4 unknowns, cut several times: against the dense solution.
  constexpr int kX = 11;
  constexpr int kY = 14;
  std::vector<int> unknowns;
  for (int k = 0; k < kX * kY; ++k) unknowns.push_back(k < 8 ? 0 : (k * 7) % 5);
  const Dissection order = dissect(kX, kY, unknowns);
  std::vector<int> column_of(static_cast<std::size_t>(order.size));
  for (int k = 0; k < kX * kY; ++k) {
    for (int u = 0; u < unknowns[k]; ++u) column_of[order.first_unknown[k] + u] = k;
  }
  FrontalCholesky factor(order);
  for (const int every : {order.size + 1, 7}) {  // so many eigenvalues are negative
    Random values;
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(order.size, order.size);
    int negative = 0;
    for (int j = 0; j < order.size; ++j) {
      const double diagonal = (j + 1) % every == 0 ? -40 : 40;  // dominant
      if (diagonal < 0) ++negative;
      for (int i = j; i < order.size; ++i) {
        const int dx = std::abs(column_of[i] % kX - column_of[j] % kX);
        const int dy = std::abs(column_of[i] / kX - column_of[j] / kX);
        if (std::max(dx, dy) > 1) continue;
        A(i, j) = A(j, i) = i == j ? diagonal : values.next();
        factor.entries()[order.index(i, j)] = A(i, j);
      }
    }
    ASSERT_TRUE(factor.factor());
    EXPECT_EQ(factor.negative(), negative);
    Eigen::MatrixXd x = Eigen::MatrixXd::Zero(order.size, 3);
    for (int k = order.size / 3; k < order.size / 2; ++k) x.row(k).setConstant(values.next());
    const Eigen::MatrixXd rhs = x;
    factor.solve_lower(x);
    const Eigen::MatrixXd lower = x;
    factor.solve_upper(x);
    EXPECT_LT((A * x - rhs).norm(), 1e-12 * rhs.norm());
    Eigen::MatrixXd changed = lower;
    factor.apply_signs(changed);
    const Eigen::Matrix3d energy = rhs.transpose() * x;  // rhs^T L^-T S L^-1 rhs
    EXPECT_LT((lower.transpose() * changed - energy).norm(), 1e-12 * energy.norm());
  }
  factor.set_zero();
  for (int i = 0; i < order.size; ++i)
    factor.entries()[order.index(i, i)] = i == order.size / 2 ? 0 : 1;
  EXPECT_FALSE(factor.factor());
}

TEST(FrontalCholesky, ABorderedMatrixHasAsManyNegativeEigenvaluesAsRows) {
  // A - u u^T against a row u: positive definite along what the row leaves free. Against a row
  // beside u it is not.
  constexpr int kSize = 12;
  const Dissection order = dissect(kSize, 1, std::vector<int>(kSize, 1));
  FrontalCholesky factor(order);
  factor.set_zero();
  for (int i = 0; i < kSize; ++i)
    factor.entries()[order.index(i, i)] = i == order.first_unknown[5] ? -2 : 1;
  ASSERT_TRUE(factor.factor());
  ASSERT_EQ(factor.negative(), 1);
  constexpr double kCompliance = 1e-6;
  for (const int row : {5, 6}) {
    Eigen::MatrixXd Y = Eigen::MatrixXd::Zero(kSize, 1);
    Y(order.first_unknown[row], 0) = 1;
    Eigen::MatrixXd x = Y;
    factor.solve_lower(Y);
    Eigen::MatrixXd changed = Y;
    factor.apply_signs(changed);
    Eigen::MatrixXd B = Y.transpose() * changed;
    B(0, 0) += kCompliance;
    BorderSolver border;
    EXPECT_EQ(border.compute(B, factor.negative()), row == 5);
    // The row holds its unknown against the force on it.
    factor.solve_lower(x);
    x -= Y * border.solve(changed.transpose() * x);
    factor.solve_upper(x);
    EXPECT_NEAR(x(order.first_unknown[row], 0), 0, 3 * kCompliance);
  }
}

TEST(FrontalCholesky, FactoringChangedPartsAgainIsFactoringAllToTheBit) {
  constexpr int kX = 40;  // deeper than the parts that are kept
  constexpr int kY = 36;
  const std::vector<int> unknowns(kX * kY, 3);
  const Dissection order = dissect(kX, kY, unknowns);
  FrontalCholesky again(order);
  FrontalCholesky whole(order);
  for (FrontalCholesky* factor : {&again, &whole}) {
    Random random;
    for (int j = 0; j < order.size; ++j) {
      factor->entries()[order.index(j, j)] = 40;
      if (j % 3 != 2) factor->entries()[order.index(j + 1, j)] = random.next();
    }
    for (int k = 0; k + 1 < kX * kY; ++k) {  // neighbours along x
      const auto column = static_cast<std::size_t>(k);
      const int a = order.first_unknown[column];
      const int b = order.first_unknown[column + 1];
      if ((k + 1) % kX != 0) factor->entries()[order.index(std::max(a, b), std::min(a, b))] = 7;
    }
  }
  ASSERT_TRUE(again.factor());
  const std::vector<int> changed = {5, order.size / 2, order.size - 4};
  for (const int unknown : changed) {
    again.entries()[order.index(unknown, unknown)] = 50;
    whole.entries()[order.index(unknown, unknown)] = 50;
  }
  ASSERT_TRUE(again.factor_again(changed));
  ASSERT_TRUE(whole.factor());
  Eigen::MatrixXd x = Eigen::MatrixXd::Ones(order.size, 1);
  Eigen::MatrixXd y = x;
  again.solve_lower(x);
  again.solve_upper(x);
  whole.solve_lower(y);
  whole.solve_upper(y);
  EXPECT_EQ(x, y);
}

}  // namespace
}  // namespace omentum
