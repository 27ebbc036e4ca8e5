// Jaw and grasp of the simulated back end: taking hold, judging the pinch, slip and loss.

#include <algorithm>
#include <cmath>

#include "sim_worker/backend/pinch_contact.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {

using Eigen::Vector3d;

bool SimBackend::is_held(int lane) const {
  const auto& tissue = *groups_[lane / width_];
  const auto held = tissue.held(lane_in_group(lane));
  // Ascending, and a body under the sheet comes after it.
  const bool tissue_held =
      !held.empty() && held.front() < static_cast<int>(setup_->scene.tissue.particles.size());
  return tissue_held || environments_[lane].holds_rigid != 0;
}

double SimBackend::thickness_of(int lane) const {
  const auto& tissue = *groups_[lane / width_];
  return setup_->scene.tissue.thickness * tissue.thickness_scale(lane_in_group(lane));
}

bool SimBackend::jaws_hold(int lane) const {
  const auto& tissue = *groups_[lane / width_];
  return is_held(lane) || !tissue.held(lane_in_group(lane)).empty();
}

void SimBackend::attach(int lane) {
  Environment& e = environments_[lane];
  Tissue<float>& tissue = tissue_of(lane);
  const int l = lane_in_group(lane);
  const Vector3d tip = tip_of(lane);
  tissue.hold(l, tip, setup_->config.grasp().patch_radius_m(), defects_.grasp_collapse_to_point());
  e.slip = 0;
  Eigen::Map<Vector3d>(e.held_from) = tip;
  if (!tissue.held(l).empty() && e.grasped_ever == 0) {
    e.grasped_ever = 1;
    Eigen::Map<Vector3d>(e.grasp_position) = tip;
  }
}

/// A body under the sheet, where the pinch reaches its surface: the jaws then hold it with the
/// sheet, or alone (docs/decisions/0020).
void SimBackend::take_body(int lane) {
  Tissue<float>& tissue = tissue_of(lane);
  Environment& e = environments_[lane];
  const int l = lane_in_group(lane);
  const Vector3d tip = tip_of(lane);
  PinchContact contact;
  contact.distance = tissue.distance_to_body(l, tip);
  contact.jaw_deg = e.jaw_deg;
  contact.thickness = thickness_of(lane);
  if (judge_pinch(setup_->config.grasp(), contact) != PinchResult::kHeld) return;
  tissue.hold_body(l, tip, setup_->config.grasp().patch_radius_m(),
                   defects_.grasp_collapse_to_point());
  e.slip = 0;
}

void SimBackend::release(int lane) {
  tissue_of(lane).release(lane_in_group(lane));
  environments_[lane].holds_rigid = 0;
}

PinchResult SimBackend::judge(int lane, const Nearest& nearest) const {
  return judge_pinch(
      setup_->config.grasp(),
      pinch_contact(*setup_, *groups_[lane / width_], lane_in_group(lane),
                    {tip_of(lane), jaw_direction(lane), environments_[lane].jaw_deg}, nearest));
}

void SimBackend::try_grasp(int lane, const Nearest& nearest) {
  Environment& e = environments_[lane];
  const pb::Grasp& grasp = setup_->config.grasp();
  const PinchResult result = judge(lane, nearest);
  ++counters_.pinches[static_cast<std::size_t>(result)];
  if (result == PinchResult::kHeld) attach(lane);
  take_body(lane);
  if (result != PinchResult::kTooFar) return;
  if (defects_.grasp_any_body(setup_->scene, tip_of(lane), grasp.radius_m())) {
    e.holds_rigid = 1;
    e.grasped_ever = 1;
    Eigen::Map<Vector3d>(e.grasp_position) = tip_of(lane);
  }
}

void SimBackend::move_jaw_and_grasp(std::span<const ToolCommand> commands) {
  const pb::Grasp& grasp = setup_->config.grasp();
  const double dt = setup_->config.task().control_period_s();
  const bool has_angle = grasp.jaw_open_deg() > 0;
  std::vector<std::uint8_t> pinches(environments_.size(), 0);
  for (int lane = 0; lane < lanes(); ++lane) {
    Environment& e = environments_[lane];
    const bool closed = commands[lane].closed;
    if (!closed && !grasp.automatic()) {
      if (jaws_hold(lane)) release(lane);
      e.jaw_was_open = 1;
    }
    e.jaw_closed = closed ? 1 : 0;
    // A jaw with an angle pinches once per closing: at the step that brings its faces onto the
    // tissue. A jaw without one tries in every closed step (the paper's grasp).
    const double contact_deg = has_angle ? jaw_contact_deg(grasp, thickness_of(lane)) : 0;
    const double next_deg = has_angle ? move_jaw(grasp, e.jaw_deg, closed, dt) : 0;
    const bool closes_now = !has_angle || (e.jaw_was_open != 0 && next_deg < contact_deg);
    if (closed && !jaws_hold(lane) && closes_now) {
      pinches[lane] = 1;
    } else {
      e.jaw_deg = next_deg;
    }
  }
  for (int g = 0; g < static_cast<int>(groups_.size()); ++g) {
    const int first = g * width_;
    const int end = std::min(first + width_, lanes());
    if (std::count(pinches.begin() + first, pinches.begin() + end, 1) == 0) continue;
    std::vector<Vector3d> points(width_, Vector3d::Zero());
    std::vector<Nearest> nearest(width_);
    for (int lane = first; lane < end; ++lane) points[lane - first] = tip_of(lane);
    groups_[g]->find_nearest(points, nearest);
    for (int lane = first; lane < end; ++lane) {
      if (pinches[lane] == 0) continue;
      Environment& e = environments_[lane];
      try_grasp(lane, nearest[lane - first]);
      if (has_angle) e.jaw_deg = move_jaw(grasp, e.jaw_deg, true, dt);
      e.jaw_was_open = 0;
    }
  }
}

void SimBackend::slip_or_lose(int lane, StepOutcome& outcome) {
  Tissue<float>& tissue = tissue_of(lane);
  const int l = lane_in_group(lane);
  if (tissue.held(l).empty()) return;
  Environment& e = environments_[lane];
  const Vector3d force = tissue.held_force(l);
  const double load = force.norm();
  const double slip =
      slip_speed(setup_->config.grasp(), load) * setup_->config.task().control_period_s();
  if (!(slip > 0)) return;
  tissue.shift_held(l, slip / load * force);
  e.slip += slip;
  if (!slipped_out(setup_->config.grasp(), e.slip)) return;
  const bool counts = is_held(lane);
  release(lane);
  if (!counts) return;
  e.lost_ever = 1;
  e.exposure = 0;
  outcome.grasp_lost = true;
  ++counters_.grasps_lost;
}

}  // namespace omentum
