#pragma once

// The task of a preset with the simulated back end, driven step by step.

#include <algorithm>
#include <array>
#include <memory>
#include <string>
#include <vector>

#include "core/config.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum::test {

/// Preset omentum with decisions of one control period, by which these tests count.
inline std::shared_ptr<const SimSetup> setup_of(const std::string& preset,
                                                const std::vector<std::string>& overrides = {}) {
  std::vector<std::string> all;
  if (preset == "omentum") all.emplace_back("task.action_repeat=1");
  all.insert(all.end(), overrides.begin(), overrides.end());
  return make_sim_setup(load_config(preset, all), deploy_dir() + "/scenes");
}

inline EpisodeStart grid_start(std::uint32_t index) {
  EpisodeStart start;
  start.start_set = StartSet::kGrid;
  start.start_index = index;
  return start;
}

/// Steps one environment with branch indices x, y, z, gripper.
inline StepOutcome step_one(SimBackend& backend, std::array<std::uint8_t, 4> branch) {
  std::vector<Action> actions(static_cast<std::size_t>(backend.lanes()));
  std::vector<StepOutcome> outcomes(actions.size());
  for (Action& a : actions) std::ranges::copy(branch, a.branch.begin());
  backend.step(actions, outcomes);
  return outcomes[0];
}

inline Eigen::Vector3d tip(const SimBackend& backend, int lane = 0) {
  const EpisodeFacts f = backend.clock(lane);
  return {f.tool_position[0], f.tool_position[1], f.tool_position[2]};
}

inline constexpr std::array<std::uint8_t, 4> kStay = {1, 1, 1, 0};
inline constexpr std::array<std::uint8_t, 4> kDown = {1, 1, 0, 0};

/// Brings the tool of lane 0 onto the sheet above a point and closes the jaw; true if it holds.
inline bool grasp_below(SimBackend& backend, double dx = 0, double dy = 0) {
  EpisodeStart start = grid_start(44);
  start.episode_limit = 100000;
  backend.reset(0, start);
  for (int i = 0; i < 40; ++i)
    step_one(backend, {static_cast<std::uint8_t>(dx > 0   ? 2
                                                 : dx < 0 ? 0
                                                          : 1),
                       static_cast<std::uint8_t>(dy > 0   ? 2
                                                 : dy < 0 ? 0
                                                          : 1),
                       1, 0});
  const bool paced = backend.setup().config.grasp().jaw_open_deg() > 0;
  for (int i = 0; i < 260; ++i) {
    std::vector<Nearest> nearest(static_cast<std::size_t>(backend.tissue_of(0).lanes()));
    std::vector<Eigen::Vector3d> points(nearest.size(), tip(backend));
    backend.tissue_of(0).find_nearest(points, nearest);
    if (nearest[0].distance < (paced ? 0.0014 : 0.002)) break;
    step_one(backend, kDown);
  }
  for (int i = 0; i < 8; ++i) step_one(backend, {1, 1, 1, 1});
  return backend.clock(0).held;
}

}  // namespace omentum::test
