#pragma once

#include <Eigen/Core>
#include <array>

#include "core/psm.h"
#include "proto/effects.pb.h"

// instrument/ is what holds the tissue: the arm, which never is quite where it was sent (every
// error of scene.arm, none of them by default), and the jaw, which decides whether a pinch holds.
// Positions of the tip in W; the ideal kinematics are core/psm.h.

namespace omentum {

/// Memory of the arm's effects, one per environment; plain numbers, written to state bytes as they
/// stand.
struct ArmState {
  static constexpr int kHistory = 16;
  double command[kHistory][3];  ///< commanded tips p_WT at the ends of the last control steps,
                                ///< newest first [m]
  double target[6];             ///< delayed command in joint space at the end of the last step
  double droop[6];              ///< behind the servo's droop
  double pole[2][6];            ///< behind each pole of the bandwidth
  double motor[6];              ///< motor encoders, before the give under load
  double disc[4];               ///< behind the play of the discs
  double joint[6];              ///< behind the play of the joints
  double p_WT_true[3];          ///< where the tip is [m]
  double p_WT_measured[3];      ///< where the encoders say it is [m]
};

/// What the robot reports of a step.
struct ArmReport {
  PsmJoints commanded{};           ///< rad, insertion m
  PsmJoints measured{};            ///< motor encoders
  std::array<double, 6> effort{};  ///< of the motors [N m], insertion [N]
};

/// The arm between the commanded and the true tip. Effects are applied as differences from the
/// nominal arm, so an effect that is zero changes no bit. Immutable; any thread.
class Arm {
 public:
  /// Throws Error for a delay that does not fit the history of `control_period`.
  Arm(const pb::ArmEffects& effects, const ToolMount& mount, double control_period);

  /// False when every effect is zero: the tip is where it was commanded to be, and nothing below
  /// needs to be called.
  bool active() const { return active_; }

  /// Arm at rest at a tip position.
  void reset(ArmState& state, const Eigen::Vector3d& p_WT) const;

  /// One control step: the command moves on a straight line to `p_WT`; `load_W` is the force on the
  /// tool [N]. A command without an inverse leaves the joints' target in force.
  ArmReport step(ArmState& state, const Eigen::Vector3d& p_WT, const Eigen::Vector3d& load_W) const;

 private:
  Eigen::Vector3d tip_of(const PsmJoints& q, double extra_length) const;
  Eigen::Vector3d delayed(const ArmState& state) const;
  std::array<double, 6> load_efforts(const PsmJoints& q, const Eigen::Vector3d& load_W) const;
  PsmJoints play_of_discs(ArmState& state, const PsmJoints& q) const;

  pb::ArmEffects effects_;
  ToolMount mount_;
  double dt_;
  bool active_ = false;
  std::array<double, 6> droop_{}, coulomb_{}, viscous_{}, backlash_{}, compliance_{}, offset_{};
  std::array<double, 6> keep_droop_{};  ///< exp(-dt / T)
  double keep_pole_ = 0;
};

}  // namespace omentum
