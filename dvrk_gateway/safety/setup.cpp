#include <cmath>

#include "core/check.h"
#include "core/config.h"
#include "dvrk_gateway/safety/safety.h"

namespace omentum {
namespace {

std::int64_t ns(double seconds) { return std::llround(1e9 * seconds); }

}  // namespace

SafetySetup make_safety_setup(const pb::SafetyLimits& limits, const ToolMount& mount,
                              const Eigen::Isometry3d& X_AR, bool registered) {
  check_ranges(limits, "safety");
  if (!(limits.jaw_min_rad() < limits.jaw_max_rad())) {
    throw_error("safety.jaw_min_rad: {} rad, allowed below safety.jaw_max_rad, {} rad",
                limits.jaw_min_rad(), limits.jaw_max_rad());
  }
  if (!(limits.jump_m() >= limits.step_m())) {
    throw_error("safety.jump_m: {} m, allowed from safety.step_m, {} m", limits.jump_m(),
                limits.step_m());
  }
  if (!(limits.tick_gap_s() > limits.period_s())) {
    throw_error("safety.tick_gap_s: {} s, allowed above safety.period_s, {} s", limits.tick_gap_s(),
                limits.period_s());
  }
  if (!((mount.workspace_min.array() < mount.workspace_max.array()).all()))
    throw_error("workspace box is empty: is a scene given?");
  SafetySetup setup;
  setup.limits = limits;
  setup.mount = mount;
  setup.X_AR = X_AR;
  setup.registered = registered;
  setup.period_ns = ns(limits.period_s());
  setup.state_age_ns = ns(limits.state_age_s());
  setup.silence_ns = ns(limits.silence_s());
  setup.tick_gap_ns = ns(limits.tick_gap_s());
  setup.arm_age_ns = ns(limits.arm_age_s());
  setup.dead_man_ns = ns(limits.dead_man_s());
  setup.tracking_error_ns = ns(limits.tracking_error_s());
  setup.effort_ns = ns(limits.effort_s());
  const double shoulder = limits.shoulder_step_rad();
  const double wrist = limits.wrist_step_rad();
  setup.joint_steps = {shoulder, shoulder, limits.insertion_step_m(), wrist, wrist, wrist};
  for (std::size_t k = 0; k < 6; ++k) {
    const JointRange& range = mount.instrument->limits[k];
    const double margin = limits.joint_margin() * 0.5 * (range.max - range.min);
    setup.joint_min[k] = range.min + margin;
    setup.joint_max[k] = range.max - margin;
  }
  setup.jaw_min = std::max(limits.jaw_min_rad(), mount.instrument->jaw.min);
  setup.jaw_max = std::min(limits.jaw_max_rad(), mount.instrument->jaw.max);
  return setup;
}

}  // namespace omentum
