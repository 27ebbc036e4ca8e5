#pragma once

#include <Eigen/Core>
#include <functional>

#include "core/result.h"
#include "dvrk_gateway/loop/control_port.h"

namespace omentum {

struct ArmGuideOptions {
  double jaw_open_rad = 0.7;
  double jaw_closed_rad = -0.2;  ///< below 0 the jaws press
  double turn_step_rad = 0.02;   ///< of the orientation on the way to a start, per period
  /// Height above the highest start at which the arm crosses [m]; the workspace box ends it.
  double clearance_m = 0.01;
};

/// Leads the tip along goals in W at the orientation of the mount, one per period, and tells when
/// the safety function has stopped the arm. One thread; exchange() of the port paces it.
class ArmGuide {
 public:
  /// `port` must outlive it. `waits` is called in every period that passes without the arm being
  /// armed, with the reason why not.
  ArmGuide(ControlPort& port, const SafetySetup& setup, const ArmGuideOptions& options,
           std::function<void(const Period&)> waits = {});

  /// Waits for the operator to arm, then leads from setpoint_cp up, turns to the mount's
  /// orientation, across, and down to p_WT [m], in steps that the safety function allows. Fails
  /// with the reason of a stop.
  Result<void> go_to(const Eigen::Vector3d& p_WT);
  /// The goal of the next period. Fails with the reason when the arm was stopped.
  Result<void> follow(const Eigen::Vector3d& p_WT, bool jaw_closed);
  /// The arm stays where it is, armed.
  Result<void> hold();

  const Period& period() const { return port_.period(); }
  /// Where the robot measures its tip, p_WT [m].
  Eigen::Vector3d measured_tip() const;

 private:
  /// A pose of the control point in W.
  struct Goal {
    Eigen::Matrix3d R_WC = Eigen::Matrix3d::Identity();
    Eigen::Vector3d p_WT = Eigen::Vector3d::Zero();
  };
  Goal in_world(const CartesianPose& pose) const;
  RobotCommand command_of(const Goal& goal) const;
  Result<void> wait_until_armed();
  Result<void> request(const PolicyRequest& request);
  Result<void> line_to(const Eigen::Vector3d& p_WT);
  Result<void> turn();

  ControlPort& port_;
  SafetySetup setup_;
  ArmGuideOptions options_;
  std::function<void(const Period&)> waits_;
  Eigen::Isometry3d X_WA_;
  Goal goal_;  ///< in force
  bool jaw_closed_ = false;
};

}  // namespace omentum
