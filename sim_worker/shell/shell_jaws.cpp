#include "sim_worker/shell/shell_jaws.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <utility>

#include "sim_worker/tissue/rotation.h"

namespace omentum {

using Eigen::Matrix3d;
using Eigen::Matrix3Xd;
using Eigen::MatrixXd;
using Eigen::Vector3d;

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
// -N^-1 (w x R a).
Matrix3Xd ShellJaws::hold(const Matrix3Xd& rows) {
  constexpr double kSettled = 1e-13;  // [rad]
  constexpr int kMost = 20;
  const Matrix3Xd y = rows + force_ * own_.transpose() - rows_.offset * rows_.place.transpose();
  Turn turn;
  Matrix3Xd arm = rows_.arm;
  Matrix3Xd force = (y - arm) * inverse_;
  const bool turns = !rows_.turn_stiffness.isZero(0);
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
    const Vector3d step = -second.ldlt().solve(gradient);
    turn.add(step);
    arm = turn.matrix * rows_.arm;
    force = (y - arm) * inverse_;
    if (!(step.cwiseAbs().maxCoeff() > kSettled)) break;
  }
  const Matrix3Xd change = force - force_;
  force_ = force;
  return change;
}

}  // namespace omentum
