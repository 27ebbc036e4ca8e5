#pragma once

#include <array>
#include <functional>
#include <memory>
#include <vector>

#include "core/backend.h"
#include "core/task.h"
#include "sim_worker/backend/exposure.h"
#include "sim_worker/backend/seed_defects.h"
#include "sim_worker/backend/sim_setup.h"
#include "sim_worker/instrument/arm.h"
#include "sim_worker/instrument/jaw.h"
#include "sim_worker/tissue/randomise.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Counters since construction, for status topics and tests.
struct SimCounters {
  std::uint64_t axes_dropped = 0;          ///< increments dropped at the workspace box
  std::uint64_t goals_unreachable = 0;     ///< goals without an inverse
  std::array<std::uint64_t, 5> pinches{};  ///< by PinchResult
  std::uint64_t grasps_lost = 0;
};

/// The simulation behind the Backend seam: PSM, grasp, tissue, exposure. What actions, observations
/// and rewards mean is in core/task.h. Lanes beyond one kernel width are further groups of lanes;
/// no lane ever sees another.
class SimBackend : public Backend, public Snapshots {
 public:
  /// Draws the image observation of one lane: surface vertices (x y z interleaved, W), tip, jaw
  /// angle -> floats.
  using ImageSource =
      std::function<void(std::span<const float>, const Eigen::Vector3d&, double, std::span<float>)>;

  SimBackend(std::shared_ptr<const SimSetup> setup, int lanes, unsigned lane_width = 0,
             ImageSource image = {});

  int lanes() const override { return static_cast<int>(environments_.size()); }
  int observation_size() const override { return observation_size_; }
  std::size_t columns() const override { return columns_; }
  void reset(int lane, const EpisodeStart& start) override;
  void observe(int lane, std::span<float> observation) const override;
  void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) override;
  EpisodeFacts facts(int lane) const override;
  EpisodeFacts clock(int lane) const override;
  bool at_target(int lane) const override;
  Action hold_action(int lane) const override;
  bool healthy(int lane) const override;
  std::uint32_t ticks_per_step() const override;

  Snapshots* snapshots() override { return robot_ ? nullptr : this; }
  std::uint32_t state_format() const override { return kSimStateFormat; }
  Bytes save(int lane) const override;
  Result<void> load(int lane, std::span<const std::byte> state) override;
  void positions(int lane, std::vector<float>& out) const override;

  /// What a pinch on the given particle would come to now.
  PinchResult judge(int lane, const Nearest& nearest) const;

  /// Where the tip of a robot is at the end of a control period in which it was led towards a goal,
  /// both p_WT [m].
  using RobotTip = std::function<Eigen::Vector3d(const Eigen::Vector3d& goal)>;
  /// One lane alone: from here on the tool is where `robot` says, in place of the arm of the scene.
  /// States of such a back end cannot be saved.
  void follow_robot(RobotTip robot);
  /// The episode begins with the tip commanded to one place and the robot's at another, p_WT [m].
  void place_tip(int lane, const Eigen::Vector3d& commanded, const Eigen::Vector3d& robot);

  const SimCounters& counters() const { return counters_; }
  const SimSetup& setup() const { return *setup_; }
  const Task& task() const { return task_; }
  /// Vertices of the drawn surface, x y z interleaved in W [m].
  void surface(int lane, std::vector<float>& out) const;
  /// The tissue of a lane, for tests and pictures.
  Tissue<float>& tissue_of(int lane) { return *groups_[lane / width_]; }
  int lane_in_group(int lane) const { return lane % width_; }
  /// Goal of the last command, p_WT [m], and whether it closes the jaw: what a robot would follow.
  Eigen::Vector3d commanded_tip(int lane) const {
    const double* tip = environments_[lane].tip;
    return {tip[0], tip[1], tip[2]};
  }
  bool jaw_closed(int lane) const { return environments_[lane].jaw_closed != 0; }
  double jaw_deg(int lane) const { return environments_[lane].jaw_deg; }
  /// What the task is told of a lane.
  TaskState task_state(int lane) const;
  /// Direction of the jaw in W: from C to T.
  Eigen::Vector3d jaw_direction(int lane) const {
    return task_.mount_of(angles_of(lane)).jaw_direction();
  }

 private:
  /// State of one environment beside its tissue; plain numbers, written to the state bytes as they
  /// stand.
  struct Environment {
    double tip[3];  ///< commanded, p_WT [m]; where the tip is unless the arm has effects
    double jaw_deg;
    double slip;  ///< accumulated [m]
    double pending_bonus;
    double held_from[3];  ///< tip when the present grasp took hold, p_WT [m]
    double episode_return;
    double start_position[3];
    double grasp_position[3];
    std::uint64_t run_seed;
    std::uint64_t episode;
    std::uint32_t slot;
    std::uint32_t episode_step;   ///< decisions
    std::uint32_t episode_limit;  ///< decisions
    std::uint32_t start_set;
    std::uint32_t start_index;
    float exposure;             ///< while held, of the present state
    std::uint8_t jaw_closed;    ///< command in force
    std::uint8_t jaw_was_open;  ///< since the last pinch attempt the jaw was commanded open
    std::uint8_t holds_rigid;   ///< named defect grasp_any_body
    std::uint8_t grasped_ever, reached, lost_ever;
    std::uint8_t unused[2];
  };

  /// Where the jaw tip is, p_WT [m].
  Eigen::Vector3d tip_of(int lane) const;
  /// Where the encoders say it is: what a robot can observe.
  Eigen::Vector3d measured_tip(int lane) const;
  /// How the tool is turned.
  RollPitchYaw angles_of(int lane) const {
    return angles_.empty() ? RollPitchYaw::Zero() : angles_[static_cast<std::size_t>(lane)];
  }
  EpisodeStart start_of_lane(int lane) const;
  /// The state that reward and potential are of.
  TaskState rewarded_state(int lane) const;
  /// Whether the tissue of the task is held; a body under it that is held alone does not count.
  bool is_held(int lane) const;
  bool jaws_hold(int lane) const;
  /// Of the lane's tissue [m].
  double thickness_of(int lane) const;

  // Parts of a control period, in their order.
  void move_jaw_and_grasp(std::span<const ToolCommand> commands);
  void limit_motion(std::span<const ToolCommand> commands, std::span<ToolMotion> motion);
  void turn_tool(int lane, const RollPitchYaw& turn, ToolMotion& motion);
  void move_tissue(std::span<ToolMotion> motion, std::span<StepOutcome> outcomes);
  void move_with_robot(std::span<ToolMotion> motion);
  void estimate_exposure(std::size_t group);

  void try_grasp(int lane, const Nearest& nearest);
  void attach(int lane);
  void take_body(int lane);
  void slip_or_lose(int lane, StepOutcome& outcome);
  void release(int lane);
  /// Parameters of the lane's episode: as drawn, or those of the scene.
  DrawnParameters parameters_of(int lane) const;
  void place_arm(int lane, const Eigen::Vector3d& tip);
  void place_on_lattice(int lane, std::uint32_t particle);
  const Bytes& settled_state() const;
  std::size_t head_bytes() const;

  std::shared_ptr<const SimSetup> setup_;
  Task task_;
  SeedDefects defects_;
  int observation_size_;
  std::size_t columns_;
  int width_;
  std::vector<std::unique_ptr<Tissue<float>>> groups_;
  std::vector<Environment> environments_;
  /// Per environment; empty while no arm has effects.
  std::vector<Arm> arms_;
  /// Per environment; empty while no arm has effects and no robot is followed.
  std::vector<ArmState> arm_states_;
  /// Per environment, written to the state bytes; empty unless the task turns the tool.
  std::vector<RollPitchYaw> angles_;
  RobotTip robot_;
  mutable ExposureEstimator exposure_;
  ImageSource image_;
  SimCounters counters_;
  /// Tissue state at rest without the tool; made at the first lattice task.
  mutable Bytes settled_;
  unsigned lane_width_;
};

}  // namespace omentum
