#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "core/backend.h"
#include "core/picture_shape.h"
#include "core/psm.h"
#include "core/reward.h"
#include "proto/config.pb.h"

namespace omentum {

/// The task (docs/task.md): actions, observations, start, reward and end of an episode. Pure
/// functions of the configuration and of what a back end measured, the same for simulation and
/// robot.

/// A place of the sheet where q may be: p_W [m] and the normal out of the sheet's upper face, of
/// length 1, in W.
struct TumourPlace {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
};

/// What the task needs of the scene. Points in W [m].
struct TaskPlaces {
  Eigen::Vector3d tumour_point = Eigen::Vector3d::Zero();  ///< q
  Eigen::Vector3d target = Eigen::Vector3d::Zero();        ///< p_T
  Eigen::Vector3d tool_start = Eigen::Vector3d::Zero();    ///< p_0
  std::vector<Eigen::Vector3d> grid_starts, robot_starts;
  ToolMount mount;  ///< workspace box and reach of the arm, the tool as it is not turned
  std::vector<TumourPlace> tumour_places;  ///< of which every episode has one; none: q everywhere
};

/// What a back end measured of one environment. Jaw tip and grasp point are p_WT in W [m].
struct TaskState {
  Eigen::Vector3d tip = Eigen::Vector3d::Zero();           ///< where it is: earns the reward
  Eigen::Vector3d measured_tip = Eigen::Vector3d::Zero();  ///< by the encoders: is observed
  Eigen::Vector3d held_from = Eigen::Vector3d::Zero();     ///< tip when tissue was taken hold of
  bool held = false;                                       ///< tissue is in the jaws
  bool jaw_closed = false;                                 ///< command in force
  double jaw_deg = 0;   ///< angle of the jaw, where grasp.jaw_open_deg > 0
  double exposure = 0;  ///< visible fraction of the tumour while held, else 0
  RollPitchYaw angles = RollPitchYaw::Zero();  ///< how the tool is turned [rad]
  const TumourPlace* place = nullptr;          ///< of the episode; null: TaskPlaces::tumour_point
};

/// What an action commands for each control period of a decision.
struct ToolCommand {
  Eigen::Vector3d increment = Eigen::Vector3d::Zero();  ///< of the tip in W [m]
  bool closed = false;                                  ///< the jaw
  RollPitchYaw turn = RollPitchYaw::Zero();             ///< of the tool [rad]
};

/// One entry of the observation: a number, or a picture. The name of a picture ends in its shape,
/// row-major: image[32][32] (row, column), image[32][32][3] (row, column; red, green, blue).
struct ObservedEntry {
  std::string name;
  std::string unit;  ///< with range and frame where it has them; holds no comma
  int size = 1;      ///< values
};

/// What a policy of this task observes, in order: the list by which Task::observe() writes.
std::vector<ObservedEntry> observed_entries(const pb::Task& task);
std::vector<std::string> observation_names(const pb::Task& task);
int observation_size(const pb::Task& task);
/// Of one value, such as p_x or image[3][17]. Precondition: index < observation_size().
std::string observation_name(const pb::Task& task, int index);
/// The picture behind the numbers; of size 0 where the task observes none.
PictureShape picture_shape(const pb::Task& task);

/// Whether actions turn the tool.
bool turns_tool(const pb::Task& task);

/// One name per branch (or continuous dimension): x, y, z, gripper, and roll, pitch, yaw where the
/// tool is turned; jaw for the Gaussian head.
std::vector<std::string> action_names(const pb::Task& task);
/// What each of them does to the tip in W, or to the jaw, by index: "x_W 0=-0.0005 m 1=0 m
/// 2=0.0005 m", "jaw 0=open 1=closed". Holds no comma.
std::vector<std::string> action_meanings(const pb::Task& task);
/// Choices of each branch; empty for the Gaussian head.
std::vector<int> action_branches(const pb::Task& task);

/// Immutable; any thread.
class Task {
 public:
  /// `config` must be resolved and checked (core/config.h): its ranges are not looked at again.
  Task(const pb::Config& config, TaskPlaces places);

  const TaskPlaces& places() const { return places_; }
  double workspace_diagonal() const { return workspace_diagonal_; }  ///< L_ws [m]

  /// Precondition: every branch that the task has is below its size, action_branches(); only debug
  /// builds check it.
  ToolCommand decode(const Action& action) const;
  /// The hold script: jaw closed, straight towards p_T, then stay within half a step of it.
  /// `commanded_tip`: goal of the last command, p_WT [m].
  Action hold_action(const Eigen::Vector3d& commanded_tip) const;
  /// The action that brings the tip nearest to `way` from where it is [m, in W] in one decision.
  Action action_towards(const Eigen::Vector3d& way, bool closed) const;
  /// hold_action() would stay.
  bool at_target(const Eigen::Vector3d& commanded_tip) const;

  /// Where the tool starts, p_WT [m]: the grid point that `start` names, or for training a point
  /// drawn from (run seed, slot, episode). Aborts where the grid does not have start.start_index.
  Eigen::Vector3d start_position(const EpisodeStart& start) const;
  /// The place of q, drawn: for training as the start is, of the starts of a grid by their number.
  /// Null where the scene names none.
  const TumourPlace* place_of(const EpisodeStart& start) const;
  /// Decisions until the episode is truncated.
  std::uint32_t episode_limit(const EpisodeStart& start) const;

  /// Writes the observation but for the pixels of an image, whose place it returns. Precondition:
  /// observation_size() numbers.
  std::span<float> observe(const TaskState& state, std::span<float> observation) const;

  /// Of one control period, for the state before its motion.
  double reward_of(const TaskState& state) const;
  /// Its difference over a decision is part of the reward: minus the way that is left, times
  /// task.progress_per_m; by axes (task.progress_by_axis) that of the opening jaw, too; and minus
  /// what the tool has to turn, times task.progress_per_deg: towards the normal at q, with tissue
  /// in the jaws back. Such shaping leaves the optimal policy as it is [Ng99] and makes a motion of
  /// half a millimetre visible, which changes the distances' reward by 0.0009 only.
  double potential_of(const TaskState& state) const;
  /// Held within task.success_radius_m of p_T: the aim of the task.
  bool is_reached(const TaskState& state) const;
  /// Held within task.end_distance_m of p_T: the episode ends and earns task.end_bonus.
  bool is_over(const TaskState& state) const;
  double end_bonus() const { return task_.end_bonus(); }
  /// Reward or observation need TaskState::exposure after every control period.
  bool needs_exposure() const;

  /// The mount of the tool as it is turned.
  ToolMount mount_of(const RollPitchYaw& angles) const;
  /// d x n, of the jaw's direction d and the normal n into the sheet at q: the axis in W about
  /// which the jaw has to turn, as long as the sine of the angle. Zero while held, and where no
  /// normal is known.
  Eigen::Vector3d orientation_error(const TaskState& state) const;
  /// Where q is in this state, p_W [m].
  const Eigen::Vector3d& q_of(const TaskState& state) const {
    return state.place != nullptr ? state.place->p : places_.tumour_point;
  }

 private:
  RewardState reward_state(const TaskState& state) const;

  pb::Task task_;
  double jaw_open_deg_;
  double jaw_length_;  ///< [m]
  TaskPlaces places_;
  double workspace_diagonal_;
};

}  // namespace omentum
