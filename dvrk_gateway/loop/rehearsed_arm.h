#pragma once

#include "dvrk_gateway/safety/safety.h"

namespace omentum {

/// The arm of `--dry-run`: from arming on it stands where the goals say, which no robot is told. A
/// plain value; nothing allocates or throws.
class RehearsedArm {
 public:
  explicit RehearsedArm(const SafetySetup& setup) : setup_(setup) {}

  /// Stands at the robot's set-point.
  void begin(const RobotState& robot) noexcept;
  void obey(const RobotCommand& command) noexcept;
  /// What the robot would say of itself; when it was said stays as it is.
  void show(RobotState& robot) const noexcept;

 private:
  SafetySetup setup_;
  PsmJoints q_{};
  double jaw_ = 0;
};

}  // namespace omentum
