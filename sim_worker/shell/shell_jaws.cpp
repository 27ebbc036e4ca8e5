#include "sim_worker/shell/shell_jaws.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <utility>

#include "sim_worker/tissue/rotation.h"

namespace omentum {

using Eigen::Matrix3d;
using Eigen::Matrix3Xd;
using Eigen::MatrixXd;
using Eigen::Vector3d;

namespace {

/// Newton's step; where the energy does not curve upwards along all three axes, one that leads
/// down.
Vector3d newton_step(const Matrix3d& second, const Vector3d& gradient) {
  const Eigen::LDLT<Matrix3d> factor(second);
  if (factor.isPositive()) return -factor.solve(gradient);
  const Eigen::SelfAdjointEigenSolver<Matrix3d> modes(second);
  const Vector3d curvature = modes.eigenvalues().cwiseAbs();
  const double least = 1e-3 * curvature.maxCoeff();
  return -modes.eigenvectors() *
         (modes.eigenvectors().transpose() * gradient).cwiseQuotient(curvature.cwiseMax(least));
}

}  // namespace

ShellJaws::ShellJaws(Rows rows, MatrixXd response)
    : rows_(std::move(rows)), response_(std::move(response)) {
  own_ = MatrixXd::Zero(rows_.count(), rows_.count());
  for (std::size_t k = 0; k < rows_.node.size(); ++k)
    own_ += rows_.weight.row(static_cast<Eigen::Index>(k)).transpose() *
            response_.col(rows_.node[k]).transpose();
  MatrixXd system = own_ + rows_.give * rows_.place * rows_.place.transpose();
  system.diagonal() += rows_.compliance;
  inverse_ = system.llt().solve(MatrixXd::Identity(rows_.count(), rows_.count()));
  force_ = Matrix3Xd::Zero(3, rows_.count());
}

// With N = P U + c + C s s^T and y the rows without jaws: N lambda = y - s offset - R a. The turn
// by Newton's method on g = K theta' - sum (R a_r) x lambda_r, where a turn w changes lambda by
// -N^-1 (w x R a). The energy is theta K theta / 2 + sum (y - s offset - R a)_r lambda_r / 2.
Matrix3Xd ShellJaws::hold(const Matrix3Xd& rows) {
  constexpr double kSettled = 1e-13;  // [rad]
  constexpr double kFarthest = 1;     // [rad] of one step
  constexpr double kRounding = 1e-9;  // of an energy
  constexpr int kMost = 20, kHalvings = 10;
  const Matrix3Xd y = rows + force_ * own_.transpose() - rows_.offset * rows_.place.transpose();
  Turn turn;
  Matrix3Xd arm = rows_.arm;
  Matrix3Xd force = (y - arm) * inverse_;
  const auto energy_of = [&] {
    return 0.5 * (turn.angle.dot(rows_.turn_stiffness * turn.angle) +
                  (y - arm).cwiseProduct(force).sum());
  };
  const bool turns = !rows_.turn_stiffness.isZero(0);
  double energy = energy_of();
  for (int iteration = 0; turns && iteration < kMost; ++iteration) {
    const Matrix3d change = turn_change(turn.angle);
    Vector3d gradient = change.transpose() * rows_.turn_stiffness * turn.angle;
    Matrix3d second = rows_.turn_stiffness;
    for (Eigen::Index r = 0; r < rows_.count(); ++r) {
      const Vector3d a = arm.col(r);
      const Vector3d f = force.col(r);
      gradient -= a.cross(f);
      second += a.dot(f) * Matrix3d::Identity() - 0.5 * (a * f.transpose() + f * a.transpose());
    }
    // sum_rs [a_r]x^T N^-1_rs [a_s]x, with [a]x^T [b]x = (a.b) I - b a^T.
    const Matrix3Xd spread = arm * inverse_;
    second += (arm.cwiseProduct(spread).sum()) * Matrix3d::Identity() - spread * arm.transpose();
    Vector3d step = newton_step(second, gradient);
    if (step.norm() > kFarthest) step *= kFarthest / step.norm();
    const Turn before = turn;
    for (int k = 0; k < kHalvings; ++k, step *= 0.5) {
      turn = before;
      turn.add(step);
      arm = turn.matrix * rows_.arm;
      force = (y - arm) * inverse_;
      if (energy_of() <= energy * (1 + kRounding)) break;
    }
    energy = energy_of();
    if (!(step.cwiseAbs().maxCoeff() > kSettled)) break;
  }
  const Matrix3Xd change = force - force_;
  force_ = force;
  return change;
}

}  // namespace omentum
