// States of the simulated back end as bytes and positions.

#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "core/constants.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {

using Eigen::Vector3d;

void SimBackend::positions(int lane, std::vector<float>& out) const {
  const auto& tissue = *groups_[lane / width_];
  out.clear();
  for (int i = 0; i < tissue.particles(); ++i) {
    const Vector3d p = tissue.position(lane_in_group(lane), i);
    for (int k = 0; k < 3; ++k) out.push_back(static_cast<float>(p[k]));
  }
}

void SimBackend::surface(int lane, std::vector<float>& out) const {
  auto& tissue = *groups_[lane / width_];
  const float* vertices = tissue.surface_positions();
  out.clear();
  for (int v = 0; v < tissue.surface_vertices(); ++v) {
    for (int k = 0; k < 3; ++k) {
      out.push_back(vertices[(3 * v + k) * width_ + lane_in_group(lane)]);
    }
  }
}

/// Bytes of a state before those of the tissue.
std::size_t SimBackend::head_bytes() const {
  return sizeof(Environment) + (arm_states_.empty() ? 0 : sizeof(ArmState)) +
         (angles_.empty() ? 0 : sizeof(RollPitchYaw));
}

Bytes SimBackend::save(int lane) const {
  Bytes bytes(head_bytes());
  std::memcpy(bytes.data(), &environments_[lane], sizeof(Environment));
  if (!arm_states_.empty()) {
    std::memcpy(bytes.data() + sizeof(Environment), &arm_states_[lane], sizeof(ArmState));
  }
  if (!angles_.empty()) {
    std::memcpy(bytes.data() + bytes.size() - sizeof(RollPitchYaw), angles_[lane].data(),
                sizeof(RollPitchYaw));
  }
  groups_[lane / width_]->save(lane_in_group(lane), bytes);
  return bytes;
}

Result<void> SimBackend::load(int lane, std::span<const std::byte> state) {
  const std::size_t head = head_bytes();
  if (state.size() < head) {
    return Failure{
        fmt::format("environment state of {} bytes, needed more than {}", state.size(), head)};
  }
  Environment e{};
  std::memcpy(&e, state.data(), sizeof e);
  for (int k = 0; k < 3; ++k) {
    // The tip never leaves the workspace; anything else is not a state of ours.
    if (!(e.tip[k] >= setup_->scene.workspace_min[k] &&
          e.tip[k] <= setup_->scene.workspace_max[k])) {
      return Failure{fmt::format("environment state has the tip at {} m on axis {}", e.tip[k], k)};
    }
  }
  if (!std::isfinite(e.jaw_deg) || !std::isfinite(e.slip) || !std::isfinite(e.episode_return) ||
      !std::isfinite(e.pending_bonus) ||
      !std::isfinite(e.held_from[0] + e.held_from[1] + e.held_from[2]) ||
      !std::isfinite(e.exposure) || e.episode_limit == 0) {
    return Failure{"environment state holds a non-finite number or a zero episode limit"};
  }
  ArmState arm{};
  if (!arm_states_.empty()) {
    std::memcpy(&arm, state.data() + sizeof(Environment), sizeof arm);
    std::array<double, sizeof(ArmState) / sizeof(double)> numbers{};
    std::memcpy(numbers.data(), &arm, sizeof arm);
    if (!std::all_of(numbers.begin(), numbers.end(), [](double v) { return std::isfinite(v); }))
      return Failure{"arm state holds a non-finite number"};
  }
  RollPitchYaw angles = RollPitchYaw::Zero();
  if (!angles_.empty()) {
    std::memcpy(angles.data(), state.data() + head - sizeof angles, sizeof angles);
    const double limit = setup_->config.task().turn_limit_deg();
    if (!(angles.cwiseAbs().maxCoeff() <= limit * kDegree) || !angles.allFinite()) {
      return Failure{fmt::format(
          "environment state has the tool turned by {:.4g}, {:.4g}, {:.4g} deg, allowed "
          "+- {}",
          angles[0] / kDegree, angles[1] / kDegree, angles[2] / kDegree, limit)};
    }
  }
  const Result<std::size_t> used = tissue_of(lane).load(lane_in_group(lane), state.subspan(head));
  if (!used) return Failure{used.error()};
  environments_[lane] = e;
  if (!arm_states_.empty()) arm_states_[lane] = arm;
  if (!angles_.empty()) angles_[lane] = angles;
  if (!arms_.empty())
    arms_[lane] =
        Arm(parameters_of(lane).arm, setup_->mount, setup_->config.task().control_period_s());
  return {};
}

}  // namespace omentum
