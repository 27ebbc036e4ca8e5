#include "core/limits.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/policy.h"
#include "core/segment_fields.h"
#include "core/task.h"

namespace omentum {

namespace {

void check_network(const pb::Config& config) {
  const PictureShape picture = picture_shape(config.task());
  if (!policy_shape(config).convolution) return;
  if (picture.size == 0) {
    throw_error("ppo.network: NETWORK_CONVOLUTION, allowed with task.observation {}: {}",
                pb::ObservationKind_Name(config.task().observation()),
                "NETWORK_AUTOMATIC, NETWORK_DENSE");
  }
  if (!can_convolve(picture)) {
    throw_error("task.image_size: {} px, allowed with convolutions: multiples of {} from {} on",
                picture.size, kConvolutionStep, kConvolutionMinSize);
  }
}

void check_parameters(const pb::Config& config) {
  PolicyShape shape = policy_shape(config);
  const std::size_t count = shape.parameter_count();
  if (count <= kMaxParameters) return;
  const int wanted = shape.hidden;
  while (shape.hidden > 0 && shape.parameter_count() > kMaxParameters) --shape.hidden;
  throw_error("ppo.hidden: {} makes {} parameters of {} inputs, allowed up to {} ({} parameters)",
              wanted, count, shape.inputs(), shape.hidden, kMaxParameters);
}

/// Decisions of one task whose observations fit into a segment.
std::size_t most_steps(const pb::Config& config) {
  const auto width = static_cast<std::size_t>(observation_size(config.task()));
  return std::min(segment_limit::kSteps, segment_limit::kObservations / width);
}

void check_steps(const pb::Config& config) {
  const std::size_t most = most_steps(config);
  if (config.rollout().steps_per_segment() > most) {
    throw_error("rollout.steps_per_segment: {} of {} observed values each, allowed up to {}",
                config.rollout().steps_per_segment(), observation_size(config.task()), most);
  }
  const pb::Scene& scene = config.scene();
  if (!config.evaluation().enabled() || !(scene.has_start_grid() || scene.has_robot_grid())) return;
  const pb::Task& task = config.task();
  if (const std::uint32_t steps = evaluation_steps(config, false); steps > most) {
    throw_error(
        "task.episode_steps: {} and task.hold_s: {} s make evaluations of {} decisions, allowed up "
        "to {} (or evaluation.enabled: false)",
        task.episode_steps(), task.hold_s(), steps, most);
  }
  const std::uint32_t lattice = evaluation_steps(config, true);
  if (config.evaluation().grasp_lattice() && scene.has_start_grid() && lattice > most) {
    throw_error(
        "task.increment_m: {} m and task.hold_s: {} s make {} decisions of a lattice grasp, "
        "allowed "
        "up to {} (or evaluation.grasp_lattice: false)",
        task.increment_m(), task.hold_s(), lattice, most);
  }
}

}  // namespace

void check_limits(const pb::Config& config) {
  check_network(config);
  check_parameters(config);
  check_steps(config);
}

void check_scene_limits(const pb::Config& config, std::size_t state_bytes,
                        std::size_t frame_numbers) {
  if (state_bytes > kMaxStateBytes) {
    throw_error(
        "scene.tissue: its state takes {} bytes, allowed up to {}: fewer particles or elements, or "
        "fewer effects with memory",
        state_bytes, kMaxStateBytes);
  }
  if (!config.evaluation().enabled()) return;
  // Before every stride-th step and after the last one.
  const std::size_t steps = evaluation_steps(config, false);
  const std::size_t frames = steps / config.evaluation().frame_stride() + 1;
  const std::size_t most = segment_limit::kObservations / frame_numbers;
  if (frames > most) {
    throw_error(
        "evaluation.frame_stride: {} makes {} frames of {} numbers, allowed from {} on ({} frames)",
        config.evaluation().frame_stride(), frames, frame_numbers, steps / most + 1, most);
  }
}

std::uint32_t hold_steps(const pb::Task& task) {
  return static_cast<std::uint32_t>(
      std::ceil(task.hold_s() / (task.control_period_s() * task.action_repeat())));
}

std::uint32_t evaluation_steps(const pb::Config& config, bool lattice) {
  const pb::Task& task = config.task();
  const pb::Scene& scene = config.scene();
  // The longest path of the hold script: across the workspace for a lattice grasp, the success
  // radius otherwise.
  const double longest = std::max({scene.workspace_max_m().x() - scene.workspace_min_m().x(),
                                   scene.workspace_max_m().y() - scene.workspace_min_m().y(),
                                   scene.workspace_max_m().z() - scene.workspace_min_m().z()});
  const double path = lattice ? longest : std::max(task.success_radius_m(), task.end_distance_m());
  const double stride = task.increment_m() * task.action_repeat();
  const std::uint32_t policy =
      lattice ? 0 : std::max(1U, task.episode_steps() / task.action_repeat());
  return policy + hold_steps(task) + static_cast<std::uint32_t>(std::ceil(path / stride)) + 2;
}

}  // namespace omentum
