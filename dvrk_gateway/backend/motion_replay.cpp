#include "dvrk_gateway/backend/motion_replay.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/check.h"

namespace omentum {
namespace {

MotionSample between(const MotionSample& a, const MotionSample& b, double t_s) {
  const double share = (t_s - a.t_s) / (b.t_s - a.t_s);
  return {t_s, a.p_WT + share * (b.p_WT - a.p_WT), a.jaw_rad + share * (b.jaw_rad - a.jaw_rad)};
}

}  // namespace

Result<std::vector<MotionSample>> goals_of(const std::vector<MotionSample>& motion, double period_s,
                                           double slow, double step_m) {
  OMENTUM_CHECK(motion.size() >= 2, "{} samples", motion.size());
  const double stride_s = period_s / slow;
  const double begin_s = motion.front().t_s;
  const auto count =
      static_cast<std::size_t>(std::ceil((motion.back().t_s - begin_s) / stride_s - 1e-9)) + 1;
  std::vector<MotionSample> goals;
  double longest = 0;
  double longest_at_s = begin_s;
  for (std::size_t k = 0, next = 1; k < count; ++k) {
    const double t_s = std::min(begin_s + static_cast<double>(k) * stride_s, motion.back().t_s);
    while (next + 1 < motion.size() && motion[next].t_s < t_s) ++next;
    goals.push_back(between(motion[next - 1], motion[next], t_s));
    if (k == 0) continue;
    const double step = (goals[k].p_WT - goals[k - 1].p_WT).cwiseAbs().maxCoeff();
    if (step <= longest) continue;
    longest = step;
    longest_at_s = t_s;
  }
  if (longest > step_m) {
    return Failure{
        fmt::format("the motion at {:.3f} s goes {:.3f} mm in a control period, allowed {:.3f} mm: "
                    "--slow {:.1f} or more",
                    longest_at_s, 1e3 * longest, 1e3 * step_m,
                    std::ceil(10 * slow * longest / step_m - 1e-6) / 10)};
  }
  return goals;
}

Result<void> check_goals(const SafetySetup& setup, const std::vector<MotionSample>& goals) {
  PsmJoints before{};
  for (std::size_t k = 0; k < goals.size(); ++k) {
    PsmJoints q{};
    Finding found = check_goal_pose(setup, setup.mount.R_WC, goals[k].p_WT, before[3], q);
    for (std::size_t j = 0; j < q.size() && k > 0 && !found; ++j) {
      const double step = std::abs(q[j] - before[j]);
      if (step > setup.joint_steps[j])
        found = {StopReason::kJointStep, step, setup.joint_steps[j], static_cast<int>(j)};
    }
    if (found)
      return Failure{fmt::format("the motion at {:.3f} s: {}", goals[k].t_s, describe(found))};
    before = q;
  }
  return {};
}

Result<void> replay_goals(ArmGuide& guide, const std::vector<MotionSample>& goals) {
  if (Result<void> there = guide.go_to(goals.front().p_WT); !there) return there;
  for (const MotionSample& goal : goals) {
    Result<void> went = std::isfinite(goal.jaw_rad) ? guide.follow(goal.p_WT, goal.jaw_rad)
                                                    : guide.follow(goal.p_WT);
    if (!went) return went;
  }
  return guide.hold();
}

}  // namespace omentum
