#pragma once

#include <Eigen/Core>
#include <array>
#include <string>

#include "core/psm.h"
#include "proto/effects.pb.h"

// instrument/ is what holds the tissue: the arm with the errors of scene.arm between the commanded
// and the true tip (none by default), and the jaw, which decides whether a pinch holds. Positions
// of the tip in W; the ideal kinematics are core/psm.h.

namespace omentum {

/// Memory of the arm's effects, one per environment. Reaches state bytes: do not change.
struct ArmState {
  static constexpr int kHistory = 16;
  double command[kHistory][3];  ///< commanded tips p_WT of the last control steps, newest first [m]
  double target[6];             ///< delayed command in joint space, of the last step
  double droop[6];              ///< after the servo's droop
  double pole[2][6];            ///< after each pole of the bandwidth
  double motor[6];              ///< motor encoders, without the servo's compliance
  double disc[4];               ///< after the play of the discs
  double joint[6];              ///< after the play of the joints
  double p_WT_true[3];          ///< true tip [m]
  double p_WT_measured[3];      ///< tip by the encoders [m]
};

/// What a robot would report of a step.
struct ArmReport {
  PsmJoints commanded{};           ///< rad, insertion m
  PsmJoints measured{};            ///< motor encoders
  std::array<double, 6> effort{};  ///< of the motors [N m], insertion [N]
};

/// Sets the effect of a path below scene.arm, in units of its field; a path that ends at a message,
/// as droop_s, sets all of its values. Throws Error for an unknown path or a value outside the
/// knob's range.
void set_effect(pb::ArmEffects& effects, const std::string& path, double value);

/// Errors of the arm as differences from the nominal arm: with zero effects the true tip is the
/// commanded one to the bit. Immutable; any thread.
class Arm {
 public:
  /// Control period in s. Throws Error for a delay longer than the history and for negative values.
  Arm(const pb::ArmEffects& effects, const ToolMount& mount, double control_period);

  /// False where every effect is zero: then nothing below needs to be called.
  bool active() const { return active_; }

  /// Arm at rest at a tip position.
  void reset(ArmState& state, const Eigen::Vector3d& p_WT) const;

  /// One control step: the command moves in a straight line to `p_WT`; `load_W` is the force on the
  /// tool [N]. Where inverse kinematics has no solution the joints keep their target.
  ArmReport step(ArmState& state, const Eigen::Vector3d& p_WT, const Eigen::Vector3d& load_W) const;

  /// For a robot that takes joints, of any orientation of the tool: the chain from `target` to the
  /// joints behind the cables, `tip_joints`, without the transport delay and the play at the tip.
  /// `reset_joints` puts it at rest. Of the state the tips and the history of commands are not
  /// used.
  void reset_joints(ArmState& state, const PsmJoints& q) const;
  ArmReport follow(ArmState& state, const PsmJoints& target, const Eigen::Vector3d& load_W,
                   PsmJoints& tip_joints) const;
  /// True p_WT [m] of joints behind the cables when `target` is commanded under this load.
  Eigen::Vector3d true_tip(const PsmJoints& tip_joints, const PsmJoints& target,
                           const Eigen::Vector3d& load_W) const;

 private:
  Eigen::Vector3d tip_of(const PsmJoints& q, double extra_length) const;
  Eigen::Vector3d force(const Eigen::Vector3d& load_W) const;
  Eigen::Vector3d bending(const PsmJoints& target, const Eigen::Vector3d& load_W) const;
  Eigen::Vector3d delayed(const ArmState& state) const;
  std::array<double, 6> load_efforts(const PsmJoints& q, const Eigen::Vector3d& load_W) const;
  PsmJoints play_of_discs(ArmState& state, const PsmJoints& q) const;

  pb::ArmEffects effects_;
  ToolMount mount_;
  double dt_;
  bool active_ = false;
  std::array<double, 6> droop_{}, coulomb_{}, viscous_{}, backlash_{}, compliance_{}, offset_{};
  std::array<double, 6> decay_droop_{};  ///< exp(-dt / T)
  double decay_pole_ = 0;
};

}  // namespace omentum
