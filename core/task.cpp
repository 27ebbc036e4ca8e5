#include "core/task.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "core/rng.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// What the three axis branches of an action mean.
struct ActionTable {
  std::array<const char*, 3> name;
  std::array<int, 3> axis;   ///< W axis of branch 0, 1, 2
  std::array<int, 3> value;  ///< steps of index 0, 1, 2
  const char* jaw;           ///< name of the fourth branch; null: the jaw is always closed
};

/// Unity is left-handed with y up: Unity (x, y, z) is W (x, z, y).
const ActionTable& action_table(pb::ActionKind kind) {
  static constexpr ActionTable kPaper = {{"x", "y", "z"}, {0, 1, 2}, {-1, 0, 1}, "gripper"};
  static constexpr ActionTable kDerived = {
      {"unity_x", "unity_y", "unity_z"}, {0, 2, 1}, {0, 1, -1}, nullptr};
  static constexpr ActionTable kDerivedHead = {
      {"unity_y", "unity_z", "unity_x"}, {2, 1, 0}, {-1, 0, 1}, nullptr};
  static constexpr ActionTable kContinuous = {{"x", "y", "z"}, {0, 1, 2}, {-1, 0, 1}, "jaw"};
  switch (kind) {
    case pb::ACTION_DERIVED:
      return kDerived;
    case pb::ACTION_DERIVED_HEAD:
      return kDerivedHead;
    case pb::ACTION_CONTINUOUS:
      return kContinuous;
    case pb::ACTION_XYZ_GRIPPER:
    case pb::ACTION_ORIENTED:
      break;
  }
  return kPaper;
}

// The branches behind the jaw's, index 0, 1, 2 = -1, 0, +1.
constexpr std::array<const char*, 3> kTurns = {"roll", "pitch", "yaw"};
constexpr std::size_t kFirstTurn = 4;
constexpr std::uint8_t kNoTurn = 1;

/// Draw of q's place; those below it are of the start position.
constexpr std::uint32_t kPlaceDraw = 64;

/// The least turn that takes unit vector a to b, which do not oppose each other.
Eigen::Matrix3d turn_between(const Vector3d& a, const Vector3d& b) {
  const Vector3d v = a.cross(b);
  Eigen::Matrix3d cross;
  cross << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return Eigen::Matrix3d::Identity() + cross + cross * cross / (1 + a.dot(b));
}

/// Angle of a rotation [deg].
double angle_of(const Eigen::Matrix3d& R) {
  const Vector3d twice_sine(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
  return trig::atan2(twice_sine.norm(), R.trace() - 1) / kDegree;
}

/// How far the tool has to turn [deg]: while free to lie along the normal at q by the least turn,
/// while held back to how the mount holds it, from where p_T is in reach, less what that is at q. A
/// spin about the jaw counts with the rest: nothing else would keep it from its limit.
double turn_left(const TaskState& state, const ToolMount& mount) {
  if (state.place == nullptr) return 0;
  const Eigen::Matrix3d goal = turn_between(mount.jaw_direction(), -state.place->normal);
  const Eigen::Matrix3d R = rotation_of(state.angles);
  return state.held ? angle_of(R) - angle_of(goal) : angle_of(goal.transpose() * R);
}

}  // namespace

bool turns_tool(const pb::Task& task) { return task.action() == pb::ACTION_ORIENTED; }

std::vector<std::string> action_names(const pb::Task& task) {
  const ActionTable& table = action_table(task.action());
  std::vector<std::string> names(table.name.begin(), table.name.end());
  if (table.jaw != nullptr) names.emplace_back(table.jaw);
  if (turns_tool(task)) names.insert(names.end(), kTurns.begin(), kTurns.end());
  return names;
}

std::vector<std::string> action_meanings(const pb::Task& task) {
  const ActionTable& table = action_table(task.action());
  const double step = task.increment_m() * task.action_repeat();
  const bool continuous = task.action() == pb::ACTION_CONTINUOUS;
  std::vector<std::string> meanings;
  for (std::size_t b = 0; b < 3; ++b) {
    std::string text = fmt::format("{}_W", "xyz"[table.axis[b]]);
    if (continuous) {
      text += fmt::format(" -1={:.6g} m 1={:.6g} m between linear beyond clamped", -step, step);
    } else {
      for (std::size_t index = 0; index < 3; ++index)
        text += fmt::format(" {}={:.6g} m", index, step * table.value[index]);
    }
    meanings.push_back(std::move(text));
  }
  if (table.jaw != nullptr)
    meanings.emplace_back(continuous ? "jaw above 0=closed else open" : "jaw 0=open 1=closed");
  const double turn = task.turn_increment_deg() * task.action_repeat();
  for (const char* angle : kTurns) {
    if (turns_tool(task))
      meanings.push_back(fmt::format("{} 0={:.6g} deg 1=0 deg 2={:.6g} deg", angle, -turn, turn));
  }
  return meanings;
}

std::vector<int> action_branches(const pb::Task& task) {
  if (task.action() == pb::ACTION_CONTINUOUS) return {};
  if (turns_tool(task)) return {3, 3, 3, 2, 3, 3, 3};
  if (action_table(task.action()).jaw == nullptr) return {3, 3, 3};
  return {3, 3, 3, 2};
}

Task::Task(const pb::Config& config, TaskPlaces places)
    : task_(config.task()),
      jaw_open_deg_(config.grasp().jaw_open_deg()),
      jaw_length_(config.grasp().jaw_length_m()),
      places_(std::move(places)),
      workspace_diagonal_((places_.mount.workspace_max - places_.mount.workspace_min).norm()) {}

ToolCommand Task::decode(const Action& action) const {
  ToolCommand command;
  if (task_.action() == pb::ACTION_CONTINUOUS) {
    for (int k = 0; k < 3; ++k) {
      const double v = static_cast<double>(action.continuous[static_cast<std::size_t>(k)]);
      command.increment[k] = task_.increment_m() * std::clamp(v, -1.0, 1.0);
    }
    command.closed = action.continuous[3] > 0;
    return command;
  }
  const ActionTable& table = action_table(task_.action());
  for (std::size_t b = 0; b < 3; ++b) {
    OMENTUM_DCHECK(action.branch[b] < 3);
    command.increment[table.axis[b]] = task_.increment_m() * table.value[action.branch[b]];
  }
  command.closed = table.jaw == nullptr || action.branch[3] == 1;
  if (!turns_tool(task_)) return command;
  for (std::size_t b = 0; b < 3; ++b) {
    OMENTUM_DCHECK(action.branch[kFirstTurn + b] < 3);
    command.turn[static_cast<Eigen::Index>(b)] =
        task_.turn_increment_deg() * kDegree * (action.branch[kFirstTurn + b] - kNoTurn);
  }
  return command;
}

Action Task::hold_action(const Vector3d& commanded_tip) const {
  return action_towards(places_.target - commanded_tip, true);
}

Action Task::action_towards(const Vector3d& way, bool closed) const {
  const double reach = task_.increment_m() * task_.action_repeat();
  Action action;
  if (task_.action() == pb::ACTION_CONTINUOUS) {
    for (int k = 0; k < 3; ++k) {
      action.continuous[static_cast<std::size_t>(k)] =
          static_cast<float>(std::clamp(way[k] / reach, -1.0, 1.0));
    }
    action.continuous[3] = closed ? 1.0F : -1.0F;
    return action;
  }
  const ActionTable& table = action_table(task_.action());
  for (std::size_t b = 0; b < 3; ++b) {
    const double distance = way[table.axis[b]];
    // Half a step: nearer than that, another step would only overshoot.
    const int wanted = distance > 0.5 * reach ? 1 : distance < -0.5 * reach ? -1 : 0;
    const auto index =
        std::find(table.value.begin(), table.value.end(), wanted) - table.value.begin();
    action.branch[b] = static_cast<std::uint8_t>(index);
  }
  action.branch[3] = table.jaw != nullptr && closed ? 1 : 0;
  if (turns_tool(task_))
    std::fill(action.branch.begin() + kFirstTurn, action.branch.end(), kNoTurn);
  return action;
}

bool Task::at_target(const Vector3d& commanded_tip) const {
  const Vector3d offset = places_.target - commanded_tip;
  // Half a step and a rounding: what hold_action() leaves.
  return offset.cwiseAbs().maxCoeff() <= 0.5 * task_.increment_m() * task_.action_repeat() + 1e-9;
}

Vector3d Task::start_position(const EpisodeStart& start) const {
  if (start.start_set == StartSet::kGrid || start.start_set == StartSet::kRobotGrid ||
      start.start_set == StartSet::kGridDrawn) {
    const auto& starts =
        start.start_set == StartSet::kRobotGrid ? places_.robot_starts : places_.grid_starts;
    OMENTUM_CHECK(!starts.empty() && (start.start_set == StartSet::kGridDrawn ||
                                      start.start_index < starts.size()),
                  "start {} of {}", start.start_index, starts.size());
    return starts[start.start_index % starts.size()];
  }
  if (start.start_set == StartSet::kGraspLattice || !task_.random_start() ||
      places_.grid_starts.empty()) {
    return places_.tool_start;
  }
  // Training: uniform in the rectangle of the start grid, height +- range. A point out of the arm's
  // reach is drawn again with the next draw number; the rectangle is reachable, so this ends at
  // once in our scenes.
  Vector3d min = places_.grid_starts.front();
  Vector3d max = min;
  for (const Vector3d& p : places_.grid_starts) {
    min = min.cwiseMin(p);
    max = max.cwiseMax(p);
  }
  const double height = task_.start_height_range_m();
  for (std::uint32_t draw = 0; draw < 64; ++draw) {
    const PhiloxWords words =
        random_words(start.run_seed, start.slot, Purpose::kReset, draw, start.episode, 0);
    Vector3d p(uniform_between(words[0], min.x(), max.x()),
               uniform_between(words[1], min.y(), max.y()),
               uniform_between(words[2], min.z() - height, max.z() + height));
    p = p.cwiseMax(places_.mount.workspace_min).cwiseMin(places_.mount.workspace_max);
    if (joints_for_tip(places_.mount, p)) return p;
  }
  return places_.tool_start;
}

const TumourPlace* Task::place_of(const EpisodeStart& start) const {
  const std::vector<TumourPlace>& places = places_.tumour_places;
  if (places.empty()) return nullptr;
  const auto count = static_cast<std::uint32_t>(places.size());
  // Of the starts of a grid by their number alone: the same in every run.
  const PhiloxWords words =
      start.start_set == StartSet::kTraining
          ? random_words(start.run_seed, start.slot, Purpose::kReset, kPlaceDraw, start.episode, 0)
          : random_words(0, start.start_index, Purpose::kEvaluation, kPlaceDraw, 0, 0);
  return &places[bounded(words[0], count)];
}

ToolMount Task::mount_of(const RollPitchYaw& angles) const {
  return turns_tool(task_) ? turned(places_.mount, angles) : places_.mount;
}

Vector3d Task::orientation_error(const TaskState& state) const {
  if (state.held || state.place == nullptr) return Vector3d::Zero();
  return mount_of(state.angles).jaw_direction().cross(-state.place->normal);
}

std::uint32_t Task::episode_limit(const EpisodeStart& start) const {
  if (start.episode_limit != 0) return start.episode_limit;
  return std::max(1U, task_.episode_steps() / task_.action_repeat());
}

RewardState Task::reward_state(const TaskState& state) const {
  RewardState s;
  s.held = state.held;
  s.distance_q = (state.tip - q_of(state)).norm();
  s.distance_target = (state.tip - places_.target).norm();
  s.workspace_diagonal = workspace_diagonal_;
  s.grasp_distance_q = (state.held_from - q_of(state)).norm();
  s.exposure = state.exposure;
  return s;
}

double Task::reward_of(const TaskState& state) const {
  const RewardWeights weights{task_.exposure_weight(), task_.exposure_distance_m(),
                              task_.grasp_distance_per_m()};
  return reward(task_.reward(), reward_state(state), weights);
}

// -c (|p - q| + jaw) while free, c (taken - |p - p_T| - |g - q|) while held, g being the grasp
// point: with the last term a grasp far from q does not save the approach to q (the flaw that P
// VI-B names). What is left to turn counts beside it.
double Task::potential_of(const TaskState& state) const {
  const double c = task_.progress_per_m();
  const double per_deg = task_.progress_per_deg();
  if (!(c > 0) && !(per_deg > 0)) return 0;
  const Vector3d& q = q_of(state);
  const double turning = per_deg > 0 ? -per_deg * turn_left(state, places_.mount) : 0;
  const bool by_axis = task_.progress_by_axis();
  const auto length = [by_axis](const Vector3d& way) {
    return by_axis ? way.lpNorm<1>() : way.norm();
  };
  if (!state.held) {
    // By axes the jaw is one of them: a closed one has to open before it can take hold.
    const double jaw = by_axis ? jaw_length_ * kDegree * (jaw_open_deg_ - state.jaw_deg) : 0;
    return turning - c * (length(state.tip - q) + jaw);
  }
  // A little more than there is left at q, so that taking hold is worth little by itself [m].
  const double taken = state.place != nullptr ? length(q - places_.target) + 0.01
                       : by_axis              ? 0.15
                                              : 0.13;
  return turning + c * (taken - length(state.tip - places_.target) - length(state.held_from - q));
}

bool Task::is_reached(const TaskState& state) const {
  return state.held && (state.tip - places_.target).norm() < task_.success_radius_m();
}

bool Task::is_over(const TaskState& state) const {
  return task_.end_distance_m() > 0 && state.held &&
         (state.tip - places_.target).norm() < task_.end_distance_m();
}

bool Task::needs_exposure() const {
  return task_.reward() == pb::REWARD_OMENTUM || task_.observation() == pb::OBSERVATION_OMENTUM ||
         task_.observation() == pb::OBSERVATION_IMAGE ||
         task_.observation() == pb::OBSERVATION_ORIENTED;
}

}  // namespace omentum
