#include "mismatch/simulate.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/machine_memory.h"
#include "sim_worker/backend/control_step.h"

namespace omentum {

using Eigen::Vector3d;

SeenState seen_at(const SimulatedRecording& recording, double t) {
  const std::vector<double>& time = recording.time;
  const auto after = std::upper_bound(time.begin(), time.end(), t);
  if (after == time.begin()) return {recording.surface.front(), recording.tip.front()};
  const auto k = static_cast<std::size_t>(after - time.begin()) - 1;
  if (k + 1 >= time.size()) return {recording.surface.back(), recording.tip.back()};
  const double share = (t - time[k]) / (time[k + 1] - time[k]);
  if (share == 0) return {recording.surface[k], recording.tip[k]};
  SeenState seen;
  seen.tip = recording.tip[k] + share * (recording.tip[k + 1] - recording.tip[k]);
  for (std::size_t i = 0; i < recording.surface[k].size(); ++i) {
    const float low = recording.surface[k][i];
    seen.surface.push_back(low + static_cast<float>(share) * (recording.surface[k + 1][i] - low));
  }
  return seen;
}

namespace {

/// Control steps of the commands. Throws Error where what they leave does not fit into memory.
std::size_t count_steps(const ToolTrack& track, double period, const Tissue<double>& tissue) {
  const double steps = std::ceil((track.end() - track.begin()) / period - 1e-9);
  const double step_bytes = static_cast<double>(sizeof(Vector3d)) * tissue.particles() +
                            3.0 * sizeof(float) * tissue.surface_vertices() +
                            500;  // tip, arm, time
  const double bytes = (steps + 1) * step_bytes;
  if (const double memory = machine_memory(); !(bytes <= memory)) {
    throw_error(
        "{}: {:.6g} s of commands are {:.4g} steps of {} s with {} nodes and need {:.3g} GB "
        "of memory, allowed {:.3g} GB (what there is)",
        track.path, track.end() - track.begin(), steps, period, tissue.particles(), bytes / 1e9,
        memory / 1e9);
  }
  return static_cast<std::size_t>(steps);
}

}  // namespace

SimulatedRecording simulate_recording(const TissueModel& model, const Arm& arm,
                                      const ToolTrack& track, const GraspSettings& grasp) {
  const std::unique_ptr<Tissue<double>> tissue = model.make_tissue(f64x1());
  tissue->reset(0, Vector3d::Zero());
  const double period = model.control_period;
  const std::size_t steps = count_steps(track, period, *tissue);
  SimulatedRecording result;
  std::vector<ArmState> arms(arm.active() ? 1 : 0);  // none: the tip is where it was told to be
  std::vector<ArmReport> reports(arms.size());
  Vector3d tip = track.tip_at(track.begin());
  if (arm.active()) {
    arm.reset(arms[0], tip);
    reports[0] = arm.step(arms[0], tip, Vector3d::Zero());
    tip = Eigen::Map<const Vector3d>(arms[0].p_WT_true);
  }
  bool was_closed = false;
  for (std::size_t step = 0; step <= steps; ++step) {
    const double t = track.begin() + static_cast<double>(step) * period;
    // A recording without a jaw is one of tissue that is held all the time.
    const bool closed = track.jaw_rad.empty() || track.jaw_at(t) <= grasp.closed_rad;
    if (closed && !was_closed) {
      tissue->hold(0, tip, grasp.patch_radius_m, false);
      if (tissue->held(0).empty()) ++result.missed_grasps;
    }
    if (!closed && was_closed) tissue->release(0);
    was_closed = closed;

    result.time.push_back(t);
    result.tip.push_back(tip);
    result.measured_tip.push_back(
        arm.active() ? Vector3d(Eigen::Map<const Vector3d>(arms[0].p_WT_measured)) : tip);
    result.arm.insert(result.arm.end(), reports.begin(), reports.end());
    result.force.push_back(tissue->held_force(0));
    std::vector<Vector3d>& points = result.points.emplace_back();
    for (int i = 0; i < tissue->particles(); ++i) points.push_back(tissue->position(0, i));
    const double* surface = tissue->surface_positions();
    result.surface.emplace_back(surface, surface + 3L * tissue->surface_vertices());
    if (step == steps) break;
    std::vector<ToolMotion> motion = {{tip, track.tip_at(t + period)}};
    control_step<double>(arm, arms, *tissue, motion, reports);
    tip = motion[0].to;
    if (!tissue->healthy(0))
      throw_error("{}: the state of the tissue is not finite under the commands at {:.6g} s",
                  track.path, t + period);
  }
  return result;
}

}  // namespace omentum
