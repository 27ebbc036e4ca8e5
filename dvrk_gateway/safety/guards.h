#pragma once

#include "dvrk_gateway/safety/safety.h"

/// The guards behind judge(): each tells what is wrong, or nothing. For dvrk_gateway/safety alone.
namespace omentum::safety {

/// What must hold to become ready and to stay armed: robot_guards.cpp.
Finding check_robot(const SafetySetup& setup, const SafetyMemory& memory, const RobotState& robot,
                    std::int64_t now_ns) noexcept;
/// What instrument and base frame are, as far as the payloads are of one Timestamp; updates what
/// was found. False where they are not.
bool note_kinematics(const SafetySetup& setup, SafetyMemory& memory,
                     const RobotState& robot) noexcept;
/// Before arming: the set-point stands still.
Finding check_rest(const RobotState& robot) noexcept;
/// Errors that count only when they last; updates since when they do.
Finding check_load(const SafetySetup& setup, SafetyMemory& memory, const RobotState& robot,
                   std::int64_t now_ns) noexcept;
/// setpoint_cp follows the goals; counts those that it has not met.
Finding check_setpoint(const SafetySetup& setup, SafetyMemory& memory,
                       const RobotState& robot) noexcept;

/// A pose in R with its joints.
struct Goal {
  PsmPose pose_RC;
  PsmJoints joints{};
};

PsmPose pose_in_R(const SafetySetup& setup, const Eigen::Matrix3d& rotation,
                  const Eigen::Vector3d& translation) noexcept;

/// A pose within reach, limits and box: goal_guards.cpp.
Finding check_place(const SafetySetup& setup, const Goal& goal) noexcept;
/// Finite, orthonormal, of one kind; fills `goal`.
Finding read_goal(const SafetySetup& setup, const SafetyMemory& memory, const RobotCommand& command,
                  Goal& goal) noexcept;
/// Steps from the goal in force.
Finding check_steps(const SafetySetup& setup, const SafetyMemory& memory,
                    const Goal& goal) noexcept;
/// Distance from setpoint_cp, before every send.
Finding check_jump(const SafetySetup& setup, const SafetyMemory& memory,
                   const RobotState& robot) noexcept;

}  // namespace omentum::safety
