#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace omentum {

/// Jaws on a shell that give way and turn as a whole, or hold many points (scene.tool.grip,
/// docs/tissue.md 8): rows over nodes that follow a rigid pose on springs. In double precision, for
/// one lane, whatever the width of the kernel.
///
///   row r of the sheet  =  s_r (tip + offset + u) + R(theta) a_r + c_r lambda_r
///   u = C sum s_r lambda_r,   theta = K^-1 sum (R a_r) x lambda_r
///
/// with lambda_r the force on the jaws, s_r 1 for rows that are a place and 0 for slopes, C the
/// give, K the stiffness of the turn; the rows respond to forces by P U lambda, U = A^-1 P^T.
class ShellJaws {
 public:
  struct Rows {
    std::vector<std::int32_t> node;
    Eigen::MatrixXd weight;                                    ///< [node][row]
    Eigen::VectorXd place;                                     ///< s
    Eigen::VectorXd compliance;                                ///< c [m/N]
    double give = 0;                                           ///< C [m/N]
    Eigen::Matrix3d turn_stiffness = Eigen::Matrix3d::Zero();  ///< K [N m/rad]; zero = no turn
    Eigen::Vector3d offset = Eigen::Vector3d::Zero();          ///< [m]
    Eigen::Matrix3Xd arm;                                      ///< a [m]

    Eigen::Index count() const { return weight.cols(); }
  };

  /// `response`: U^T, [row][node of the sheet] [m/N].
  ShellJaws(Rows rows, Eigen::MatrixXd response);

  const Rows& rows() const { return rows_; }
  const Eigen::MatrixXd& response() const { return response_; }
  const Eigen::Matrix3Xd& force() const { return force_; }  ///< lambda of the last hold() [N]
  void shift(const Eigen::Vector3d& by) { rows_.offset += by; }
  /// Forgets lambda: the sheet is where it would be without the jaws.
  void let_go() { force_.setZero(); }
  /// `rows`: of the sheet, from the tip on, as they are with the present lambda. Renews lambda;
  /// returns its change.
  Eigen::Matrix3Xd hold(const Eigen::Matrix3Xd& rows);

 private:
  Rows rows_;
  Eigen::MatrixXd response_;
  Eigen::MatrixXd own_;      ///< P U
  Eigen::MatrixXd inverse_;  ///< (P U + c + C s s^T)^-1 [N/m]
  Eigen::Matrix3Xd force_;
};

}  // namespace omentum
