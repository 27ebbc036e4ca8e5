#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "core/result.h"
#include "dvrk_gateway/loop/control_port.h"

namespace omentum {

struct ArmGuideOptions {
  double jaw_open_rad = 0.7;
  double jaw_closed_rad = -0.2;  ///< below 0 the jaws press
  int jaw_settle_periods = 3;    ///< between the last goal of the jaw and its arrival
  double turn_step_rad = 0.02;   ///< of the orientation on the way to a start, per period
  /// Height above the highest start at which the arm crosses [m], less where the workspace box or
  /// the joints end it.
  double clearance_m = 0.01;
};

/// Leads the tip along goals in W at the orientation of the mount, one per period, and tells when
/// the safety function has stopped the arm. One thread; exchange() of the port paces it.
class ArmGuide {
 public:
  /// `port` must outlive it. go_to() comes first: before it there is no goal that follow(),
  /// turn_jaw() could start from. `waits` is called in every period that passes without the arm
  /// being armed, with the reason why not.
  ArmGuide(ControlPort& port, const SafetySetup& setup, const ArmGuideOptions& options,
           std::function<void(const Period&)> waits = {});

  /// Waits for the operator to arm, then opens the jaw and leads from setpoint_cp up, turns to the
  /// mount's orientation, across, and down to p_WT [m], in steps that the safety function allows;
  /// it turns before or behind another piece where only that way is inside the limits. Where no way
  /// is, the safety function is told before it arms. Fails with the reason of a stop.
  Result<void> go_to(const Eigen::Vector3d& p_WT);
  /// The next goal; the jaw stays as it is. The goal in force is repeated until the robot's
  /// set-point has come so near that the next one is no jump, also where commands got lost. Fails
  /// with the reason when the arm was stopped, as all of these do.
  Result<void> follow(const Eigen::Vector3d& p_WT);
  /// The same with the jaw [rad], which turns at the rate of the safety limits.
  Result<void> follow(const Eigen::Vector3d& p_WT, double jaw_rad);
  /// Closes or opens the jaw while the tip stays: a jaw takes many periods, and tissue that is to
  /// be taken must not be left meanwhile. At once where it is so already.
  Result<void> turn_jaw(bool closed);
  /// The arm stays where it is, armed.
  Result<void> hold();
  /// A period in which nothing is asked. Fails only when the program ends.
  Result<void> watch();

  const Period& period() const { return port_.period(); }
  /// Where the robot measures its tip, p_WT [m].
  Eigen::Vector3d measured_tip() const;
  double measured_jaw_rad() const;
  /// The robot tells a valid pose and jaw.
  bool measures() const;

 private:
  /// A pose of the control point in W.
  struct Goal {
    Eigen::Matrix3d R_WC = Eigen::Matrix3d::Identity();
    Eigen::Vector3d p_WT = Eigen::Vector3d::Zero();
  };
  Goal in_world(const CartesianPose& pose) const;
  RobotCommand command_of(const Goal& goal) const;
  /// Goals, between two of which the tip either moves along a line or stays and turns.
  using Way = std::vector<Goal>;
  /// Sets `way` to one from `from` to the mount's orientation at p_WT; returns the obstacle where
  /// no way exists.
  Finding find_way(const Goal& from, const Eigen::Vector3d& p_WT, Way& way) const;
  /// Every place between two goals may be one; moves the joints along.
  bool is_open(const Goal& from, const Goal& to, PsmJoints& joints) const;
  Finding obstacle_at(const Goal& from, const PsmJoints& joints) const;
  Goal setpoint() const;
  Result<void> wait_until_armed(const Eigen::Vector3d& p_WT);
  Result<void> request(const PolicyRequest& request);
  Result<void> lead_to(const Goal& goal);
  bool is_near_setpoint(const Goal& goal) const;
  Result<void> line_to(const Eigen::Vector3d& p_WT);
  Result<void> turn_to(const Eigen::Matrix3d& R_WC);

  ControlPort& port_;
  SafetySetup setup_;
  ArmGuideOptions options_;
  std::function<void(const Period&)> waits_;
  Eigen::Isometry3d X_WA_;
  Goal goal_;  ///< in force
  double jaw_rad_ = 0;
};

}  // namespace omentum
