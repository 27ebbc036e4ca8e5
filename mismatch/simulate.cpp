#include "mismatch/simulate.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"

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

SimulatedRecording simulate_recording(const TissueModel& model, const Arm& arm,
                                      const ToolTrack& track, const GraspSettings& grasp) {
  const std::unique_ptr<Tissue<double>> tissue = model.make_tissue(f64x1());
  tissue->reset(0, Vector3d::Zero());
  const double period = model.control_period;
  const auto steps = static_cast<int>(std::ceil((track.end() - track.begin()) / period - 1e-9));
  SimulatedRecording result;
  ArmState state{};
  ArmReport report;
  if (arm.active()) {
    arm.reset(state, track.tip_at(track.begin()));
    report = arm.step(state, track.tip_at(track.begin()), Vector3d::Zero());
  }
  bool was_closed = false;
  Vector3d tip = arm.active() ? Vector3d(Eigen::Map<const Vector3d>(state.p_WT_true))
                              : track.tip_at(track.begin());
  for (int step = 0; step <= steps; ++step) {
    const double t = track.begin() + step * period;
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
        arm.active() ? Vector3d(Eigen::Map<const Vector3d>(state.p_WT_measured)) : tip);
    if (arm.active()) result.arm.push_back(report);
    result.force.push_back(tissue->held_force(0));
    std::vector<Vector3d>& points = result.points.emplace_back();
    for (int i = 0; i < tissue->particles(); ++i) points.push_back(tissue->position(0, i));
    const double* surface = tissue->surface_positions();
    result.surface.emplace_back(surface, surface + 3L * tissue->surface_vertices());
    if (step == steps) break;
    Vector3d next = track.tip_at(t + period);
    if (arm.active()) {
      report = arm.step(state, next, tissue->held_force(0));
      next = Eigen::Map<const Vector3d>(state.p_WT_true);
    }
    const std::vector<ToolMotion> motion = {{tip, next}};
    tissue->step(motion);
    tip = next;
    if (!tissue->healthy(0))
      throw_error("simulation: state not finite at {:.3f} s of the recording", t + period);
  }
  return result;
}

}  // namespace omentum
