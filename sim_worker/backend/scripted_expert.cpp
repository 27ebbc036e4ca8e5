#include "sim_worker/backend/scripted_expert.h"

#include <algorithm>
#include <utility>

#include "sim_worker/backend/pinch_contact.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Longer than the jaw needs: 24 deg at 8 deg per period are three of them.
constexpr std::uint32_t kCloseSteps = 6, kOpenSteps = 6;
constexpr double kSaferDeg = 3;  // less than the largest approach: the sheet still swings [deg]
constexpr double kNearer = 0.1;  // of a decision's reach: the tip stands at its goal

}  // namespace

ScriptedExpert::ScriptedExpert(SimBackend& backend)
    : backend_(backend), operators_(static_cast<std::size_t>(backend.lanes())) {
  const pb::Task& task = backend.setup().config.task();
  reach_ = task.increment_m() * task.action_repeat();
  continuous_ = task.action() == pb::ACTION_CONTINUOUS;
}

std::optional<Vector3d> ScriptedExpert::place_to_pinch(int lane, std::uint32_t failed) const {
  const SimSetup& setup = backend_.setup();
  const Tissue<float>& tissue = backend_.tissue_of(lane);
  const int l = backend_.lane_in_group(lane);
  const Vector3d q = backend_.task().places().tumour_point;
  const Vector3d tip = backend_.commanded_tip(lane);
  std::vector<std::pair<double, int>> by_distance;
  for (int i = 0; i < static_cast<int>(setup.scene.tissue.particles.size()); ++i) {
    if (setup.scene.tissue.fixed[static_cast<std::size_t>(i)] == 0)
      by_distance.emplace_back((tissue.position(l, i) - q).norm(), i);
  }
  std::sort(by_distance.begin(), by_distance.end());
  pb::Grasp grasp = setup.config.grasp();
  if (grasp.max_approach_deg() > 0)
    grasp.set_max_approach_deg(std::max(1.0, grasp.max_approach_deg() - kSaferDeg * (1 + failed)));
  for (const auto& [distance, particle] : by_distance) {
    const Vector3d p = tissue.position(l, particle);
    Vector3d place = p;
    if (!continuous_) place = tip + reach_ * ((p - tip) / reach_).array().round().matrix();
    const PinchContact contact = pinch_contact(
        setup, tissue, l, place, {particle, (place - p).norm()}, grasp.jaw_open_deg());
    if (judge_pinch(grasp, contact) == PinchResult::kHeld) return place;
  }
  return std::nullopt;
}

Action ScriptedExpert::act_one(int lane) {
  Operator& o = operators_[static_cast<std::size_t>(lane)];
  const Task& task = backend_.task();
  if (backend_.clock(lane).held) {
    o = {};
    return backend_.hold_action(lane);
  }
  const Vector3d nowhere = Vector3d::Zero();
  if (o.phase == Phase::kApproach) {
    const std::optional<Vector3d> place = place_to_pinch(lane, o.failed);
    if (!place) return task.action_towards(nowhere, false);
    const Vector3d way = *place - backend_.commanded_tip(lane);
    if (way.cwiseAbs().maxCoeff() > kNearer * reach_) return task.action_towards(way, false);
    o = {Phase::kClose, 0, o.failed};
  }
  if (o.phase == Phase::kClose) {
    if (++o.steps <= kCloseSteps) return task.action_towards(nowhere, true);
    o = {Phase::kOpen, 0, o.failed + 1};
  }
  if (++o.steps >= kOpenSteps) o = {Phase::kApproach, 0, o.failed};
  return task.action_towards(nowhere, false);
}

void ScriptedExpert::act(std::span<Action> actions) {
  for (std::size_t lane = 0; lane < actions.size(); ++lane)
    actions[lane] = act_one(static_cast<int>(lane));
}

}  // namespace omentum
