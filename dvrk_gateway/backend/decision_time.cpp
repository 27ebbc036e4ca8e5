#include "dvrk_gateway/backend/decision_time.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <vector>

#include "core/clock.h"
#include "dvrk_gateway/loop/real_time_loop.h"

namespace omentum {

double measure_decision_s(SimBackend& scene, Policy& policy) {
  std::vector<float> observation(static_cast<std::size_t>(scene.observation_size()));
  std::array<double, 21> times{};
  for (double& time : times) {
    const std::int64_t begin_ns = steady_now_ns();
    scene.observe(0, observation);
    std::array<Decision, 1> decision{};
    policy.act(observation, std::array<ActionCounter, 1>{}, true, decision);
    std::array<StepOutcome, 1> outcome{};
    scene.step(std::array{Action{decision[0].branch, decision[0].continuous}}, outcome);
    time = 1e-9 * static_cast<double>(steady_now_ns() - begin_ns);
  }
  std::nth_element(times.begin(), times.begin() + times.size() / 2, times.end());
  return times[times.size() / 2];
}

Result<void> check_decision_time(const pb::Task& task, double decision_s) {
  const double allowed_s = kRequestShare * task.control_period_s();
  const double needed_s = decision_s / task.action_repeat();
  if (needed_s <= allowed_s) return {};
  return Failure{fmt::format(
      "its scene needs {:.1f} ms of each control period on this machine, allowed {:.1f} ms: take a "
      "coarser scene or a faster machine",
      1e3 * needed_s, 1e3 * allowed_s)};
}

}  // namespace omentum
