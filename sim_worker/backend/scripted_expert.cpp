#include "sim_worker/backend/scripted_expert.h"

#include <algorithm>
#include <utility>

#include "core/constants.h"
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
  const TaskState state = backend_.task_state(lane);
  const Vector3d& q = backend_.task().q_of(state);
  const bool turns = turns_tool(setup.config.task()) && state.place != nullptr;
  const Vector3d direction = turns ? Vector3d(-state.place->normal) : backend_.jaw_direction(lane);
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
        setup, tissue, l, {place, direction, grasp.jaw_open_deg()}, {particle, (place - p).norm()});
    if (judge_pinch(grasp, contact) == PinchResult::kHeld) return place;
  }
  return std::nullopt;
}

bool ScriptedExpert::turn(int lane, Action& action) const {
  const pb::Task& task = backend_.setup().config.task();
  if (!turns_tool(task)) return false;
  const TaskState state = backend_.task_state(lane);
  // Roll turns about x_W as pitch has turned it, pitch about y_W: yaw stays 0.
  const Vector3d error = backend_.task().orientation_error(state);
  const Vector3d of_free(error.dot(rotation_of({0, state.angles[1], 0}).col(0)), error.y(), 0);
  const Vector3d left = state.held ? Vector3d(-state.angles) : of_free;
  const double step = task.turn_increment_deg() * task.action_repeat() * kDegree;
  bool turning = false;
  for (std::size_t k = 0; k < 3; ++k) {
    const double angle = left[static_cast<Eigen::Index>(k)];
    const int way = angle > 0.5 * step ? 1 : angle < -0.5 * step ? -1 : 0;
    action.branch[4 + k] = static_cast<std::uint8_t>(1 + way);
    turning = turning || way != 0;
  }
  return turning;
}

Action ScriptedExpert::act_one(int lane) {
  Operator& o = operators_[static_cast<std::size_t>(lane)];
  const Task& task = backend_.task();
  if (backend_.clock(lane).held) {
    o = {};
    Action action = backend_.hold_action(lane);
    turn(lane, action);
    return action;
  }
  const Vector3d nowhere = Vector3d::Zero();
  if (o.phase == Phase::kApproach) {
    const std::optional<Vector3d> place = place_to_pinch(lane, o.failed);
    const Vector3d way = place ? Vector3d(*place - backend_.commanded_tip(lane)) : nowhere;
    Action action = task.action_towards(way, false);
    const bool turning = turn(lane, action);
    if (!place || turning || way.cwiseAbs().maxCoeff() > kNearer * reach_) return action;
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
