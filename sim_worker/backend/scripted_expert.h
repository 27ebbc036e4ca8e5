#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "core/backend.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {

/// A scripted operator who sees the whole simulation: brings the open jaw to where the sheet can be
/// taken nearest to q, closes it, and goes with what it holds straight to p_T, where it stays. A
/// pinch that takes nothing, or tissue that is lost, is tried again. Actions of a lane depend on
/// that lane alone.
class ScriptedExpert {
 public:
  /// Every lane begins an episode; `backend` must outlive this.
  explicit ScriptedExpert(SimBackend& backend);

  /// Actions of the first lanes for the state that they are in; at most backend.lanes().
  void act(std::span<Action> actions);

 private:
  enum class Phase { kApproach, kClose, kOpen };
  struct Operator {
    Phase phase = Phase::kApproach;
    std::uint32_t steps = 0;   ///< in the phase
    std::uint32_t failed = 0;  ///< pinches that took nothing
  };
  Action act_one(int lane);
  /// Turns the jaw towards the normal at q, and with tissue in it back to how the mount holds it,
  /// from where p_T is in reach. False where nothing is left to turn.
  bool turn(int lane, Action& action) const;
  /// Where the tip can come to and a pinch would take the sheet, as near to q as there is, p_WT in
  /// W [m]; empty where it takes nothing anywhere.
  std::optional<Eigen::Vector3d> place_to_pinch(int lane, std::uint32_t failed) const;

  SimBackend& backend_;
  std::vector<Operator> operators_;
  double reach_;  ///< of a decision along an axis [m]
  bool continuous_;
};

}  // namespace omentum
