#include "mismatch/simulate.h"

#include <cmath>

#include "core/check.h"

namespace omentum {

using Eigen::Vector3d;

SimulatedRecording simulate_recording(const TissueModel& model, const ToolTrack& track,
                                      const GraspSettings& grasp) {
  const std::unique_ptr<Tissue<double>> tissue = model.make_tissue(kKernelF64x1);
  tissue->reset(0, Vector3d::Zero());
  const double period = model.control_period;
  const auto steps = static_cast<int>(std::ceil((track.end() - track.begin()) / period - 1e-9));
  SimulatedRecording result;
  bool was_closed = false;
  for (int step = 0; step <= steps; ++step) {
    const double t = track.begin() + step * period;
    const Vector3d tip = track.tip_at(t);
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
    result.force.push_back(tissue->held_force(0));
    std::vector<Vector3d>& points = result.points.emplace_back();
    for (int i = 0; i < tissue->particles(); ++i) points.push_back(tissue->position(0, i));
    const double* surface = tissue->surface_positions();
    result.surface.emplace_back(surface, surface + 3 * tissue->surface_vertices());
    if (step == steps) break;
    const std::vector<ToolMotion> motion = {{tip, track.tip_at(t + period)}};
    tissue->step(motion);
    if (!tissue->healthy(0))
      throw_error("simulation: state not finite at {:.3f} s of the recording", t + period);
  }
  return result;
}

}  // namespace omentum
