#include "sim_worker/backend/sim_backend.h"

#include <array>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "sim_worker/backend/control_step.h"
#include "sim_worker/models.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// The sheet has come to rest on kidney and tumour after it [s] (decision 0020).
constexpr double kSettleTime = 3.0;

Vector3d to_vector(const double* p) { return {p[0], p[1], p[2]}; }

void assign(double* to, const Vector3d& from) {
  for (int k = 0; k < 3; ++k) to[k] = from[k];
}

/// limit_command() of a tool that turns, which meets the limits of the wrist often: of axes that
/// the arm cannot follow together each is followed that it can, so that the tip goes along a limit
/// instead of standing at it.
LimitedCommand limit_along_reach(const ToolMount& mount, const Vector3d& from,
                                 const Vector3d& increment) {
  LimitedCommand limited = limit_command(mount, from, increment);
  if (!limited.unreachable) return limited;
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3d alone = increment[axis] * Vector3d::Unit(axis);
    limited.p_WT = limit_command(mount, limited.p_WT, alone).p_WT;
  }
  return limited;
}

}  // namespace

SimBackend::SimBackend(std::shared_ptr<const SimSetup> setup, int lanes, unsigned lane_width,
                       ImageSource image)
    : setup_(std::move(setup)),
      task_(make_task(*setup_)),
      defects_(setup_->config.defects()),
      observation_size_(omentum::observation_size(setup_->config.task())),
      columns_(action_columns(action_branches(setup_->config.task()).size())),
      width_(choose_kernel(lane_width).lanes),
      environments_(lanes),
      exposure_(*setup_->exposure),
      image_(std::move(image)),
      lane_width_(lane_width) {
  OMENTUM_CHECK(lanes > 0);
  if (setup_->arm->active() || draws_arm(setup_->config)) {
    arms_.assign(environments_.size(), *setup_->arm);
    arm_states_.resize(environments_.size());
  }
  if (turns_tool(setup_->config.task())) angles_.assign(environments_.size(), RollPitchYaw::Zero());
  const LaneKernel<float>& kernel = choose_kernel(lane_width);
  for (int first = 0; first < lanes; first += width_) {
    groups_.push_back(setup_->tissue->make_tissue(kernel));
  }
  for (int lane = 0; lane < lanes; ++lane) reset(lane, {});
}

std::uint32_t SimBackend::ticks_per_step() const {
  return setup_->config.task().action_repeat() * setup_->tissue->substeps();
}

// -----------------------------------------------------------------------------------------
// start of an episode

/// What the running episode of a lane began with, as far as draws follow from it.
EpisodeStart SimBackend::start_of_lane(int lane) const {
  const Environment& e = environments_[lane];
  EpisodeStart start;
  start.run_seed = e.run_seed;
  start.slot = e.slot;
  start.episode = e.episode;
  start.start_set = static_cast<StartSet>(e.start_set);
  start.start_index = e.start_index;
  return start;
}

DrawnParameters SimBackend::parameters_of(int lane) const {
  const std::optional<DrawKey> key =
      draw_key(start_of_lane(lane), setup_->scene.grid_starts.size());
  return key ? draw_randomised(setup_->config, setup_->scene, *key) : not_drawn(setup_->scene);
}

void SimBackend::reset(int lane, const EpisodeStart& start) {
  Tissue<float>& tissue = tissue_of(lane);
  const int l = lane_in_group(lane);
  const TissueBody& body = setup_->scene.tissue;
  // Named defects of the seed carry something of the last episode over; everything else starts from
  // nothing.
  std::vector<Vector3d> old_velocities;
  std::vector<std::int32_t> old_patch;
  double pending_bonus = 0;
  if (start.follows_episode) {
    old_velocities = defects_.reset_positions_only(tissue, l, body);
    old_patch = defects_.reset_patch_at_tool(tissue, l);
    pending_bonus = environments_[lane].pending_bonus;
  }

  Environment e{};
  e.run_seed = start.run_seed;
  e.slot = start.slot;
  e.episode = start.episode;
  e.start_set = static_cast<std::uint32_t>(start.start_set);
  e.start_index = start.start_index;
  e.episode_limit = task_.episode_limit(start);
  const bool stuck = start.start_set == StartSet::kTraining && defects_.grid_stuck();
  const Vector3d tip = stuck ? setup_->scene.tool_start : task_.start_position(start);
  assign(e.tip, tip);
  assign(e.start_position, tip);
  for (double& v : e.grasp_position) v = std::nan("");
  e.jaw_deg = setup_->config.grasp().jaw_open_deg();
  e.jaw_was_open = 1;
  e.pending_bonus = pending_bonus;
  environments_[lane] = e;
  if (!angles_.empty()) angles_[lane].setZero();
  const DrawnParameters drawn = parameters_of(lane);
  if (!arms_.empty())
    arms_[lane] = Arm(drawn.arm, setup_->mount, setup_->config.task().control_period_s());
  place_arm(lane, tip);
  tissue.set_parameters(l, drawn.parameters);
  tissue.reset(l, drawn.offset);

  for (std::size_t i = 0; i < old_velocities.size(); ++i) {
    if (body.fixed[i] == 0) tissue.set_velocity(l, static_cast<int>(i), old_velocities[i]);
  }
  for (const std::int32_t i : old_patch) tissue.set_position(l, i, tip);
  if (start.start_set == StartSet::kGraspLattice) place_on_lattice(lane, start.start_index);
}

void SimBackend::place_arm(int lane, const Vector3d& tip) {
  if (!arms_.empty()) arms_[lane].reset(arm_states_[lane], tip);
}

const Bytes& SimBackend::settled_state() const {
  if (!settled_.empty()) return settled_;
  // The sheet alone, tool at p_0, until it rests: one lane of a batch of its own.
  const auto tissue = setup_->tissue->make_tissue(choose_kernel(lane_width_));
  const std::vector<ToolMotion> still(
      tissue->lanes(), ToolMotion{setup_->scene.tool_start, setup_->scene.tool_start});
  const auto steps = static_cast<int>(std::ceil(kSettleTime / setup_->tissue->control_period));
  for (int i = 0; i < steps; ++i) tissue->step(still);
  tissue->save(0, settled_);
  return settled_;
}

void SimBackend::place_on_lattice(int lane, std::uint32_t particle) {
  Tissue<float>& tissue = tissue_of(lane);
  const int l = lane_in_group(lane);
  OMENTUM_CHECK(particle < setup_->scene.tissue.particles.size(), "lattice particle {}", particle);
  const Result<std::size_t> loaded = tissue.load(l, settled_state());
  OMENTUM_CHECK(loaded.has_value(), "{}", loaded.has_value() ? "" : loaded.error());
  Environment& e = environments_[lane];
  const Vector3d tip = tissue.position(l, static_cast<int>(particle))
                           .cwiseMax(setup_->scene.workspace_min)
                           .cwiseMin(setup_->scene.workspace_max);
  assign(e.tip, tip);
  assign(e.start_position, tip);
  place_arm(lane, tip);
  e.jaw_closed = 1;
  e.jaw_deg = 0;
  e.jaw_was_open = 0;
  // A point out of the arm's reach, or with nothing but fixed particles around, holds nothing: its
  // exposure is that of the untouched sheet.
  if (joints_for_tip(setup_->mount, tip)) attach(lane);
}

// -----------------------------------------------------------------------------------------
// one decision

Vector3d SimBackend::tip_of(int lane) const {
  return to_vector(arm_states_.empty() ? environments_[lane].tip : arm_states_[lane].p_WT_true);
}

Vector3d SimBackend::measured_tip(int lane) const {
  return to_vector(arm_states_.empty() ? environments_[lane].tip : arm_states_[lane].p_WT_measured);
}

TaskState SimBackend::task_state(int lane) const {
  const Environment& e = environments_[lane];
  TaskState state;
  state.tip = tip_of(lane);
  state.measured_tip = measured_tip(lane);
  state.held_from = to_vector(e.held_from);
  state.held = is_held(lane);
  state.jaw_closed = e.jaw_closed != 0;
  state.jaw_deg = e.jaw_deg;
  state.exposure = static_cast<double>(e.exposure);
  state.angles = angles_of(lane);
  state.place = task_.place_of(start_of_lane(lane));
  return state;
}

TaskState SimBackend::rewarded_state(int lane) const {
  return defects_.reward_jaw_closed(task_state(lane));
}

// One decision: action_repeat control periods of reward, jaw, limited motion, tissue, slip,
// exposure.
void SimBackend::step(std::span<const Action> actions, std::span<StepOutcome> outcomes) {
  OMENTUM_CHECK(actions.size() == environments_.size() && outcomes.size() == environments_.size());
  std::vector<ToolCommand> commands(environments_.size());
  std::vector<double> rewards(environments_.size(), 0);
  std::vector<std::uint8_t> ended(environments_.size(), 0);
  std::vector<ToolMotion> motion(groups_.size() * width_);
  for (std::size_t k = 0; k < commands.size(); ++k) {
    commands[k] = task_.decode(actions[k]);
    outcomes[k] = {};
    outcomes[k].held_before = is_held(static_cast<int>(k));
    rewards[k] =
        environments_[k].pending_bonus - task_.potential_of(rewarded_state(static_cast<int>(k)));
    environments_[k].pending_bonus = 0;
  }
  for (std::uint32_t repeat = 0; repeat < setup_->config.task().action_repeat(); ++repeat) {
    for (std::size_t k = 0; k < environments_.size(); ++k) {
      if (ended[k] == 0) rewards[k] += task_.reward_of(rewarded_state(static_cast<int>(k)));
    }
    move_jaw_and_grasp(commands);
    limit_motion(commands, motion);
    move_tissue(motion, outcomes);
    for (std::size_t k = 0; k < environments_.size(); ++k) {
      Environment& e = environments_[k];
      const TaskState state = task_state(static_cast<int>(k));
      if (task_.is_reached(state)) e.reached = 1;
      if (ended[k] == 0 && task_.is_over(state)) {
        ended[k] = 1;
        defects_.bonus_next_episode(task_.end_bonus(), rewards[k], e.pending_bonus);
      }
    }
  }
  for (std::size_t k = 0; k < environments_.size(); ++k) {
    Environment& e = environments_[k];
    ++e.episode_step;
    rewards[k] += task_.potential_of(rewarded_state(static_cast<int>(k)));
    outcomes[k].reward = static_cast<float>(rewards[k]);
    e.episode_return += static_cast<double>(outcomes[k].reward);
    outcomes[k].terminated = ended[k] != 0;
    outcomes[k].truncated = ended[k] == 0 && e.episode_step >= e.episode_limit;
  }
}

void SimBackend::limit_motion(std::span<const ToolCommand> commands, std::span<ToolMotion> motion) {
  for (std::size_t k = 0; k < environments_.size(); ++k) {
    Environment& e = environments_[k];
    const Vector3d from = to_vector(e.tip);
    const LimitedCommand limited =
        angles_.empty()
            ? limit_command(setup_->mount, from, commands[k].increment)
            : limit_along_reach(task_.mount_of(angles_[k]), from, commands[k].increment);
    counters_.axes_dropped += static_cast<std::uint64_t>(limited.axes_dropped);
    counters_.goals_unreachable += limited.unreachable ? 1 : 0;
    motion[k] = {from, limited.p_WT};
    assign(e.tip, limited.p_WT);
    if (!angles_.empty()) turn_tool(static_cast<int>(k), commands[k].turn, motion[k]);
  }
}

/// Turns the tool about its tip at the end of the motion; what it holds turns with it.
void SimBackend::turn_tool(int lane, const RollPitchYaw& turn, ToolMotion& motion) {
  RollPitchYaw& angles = angles_[lane];
  const LimitedTurn limited = limit_turn(setup_->mount, motion.to, angles, turn,
                                         setup_->config.task().turn_limit_deg() * kDegree);
  counters_.axes_dropped += static_cast<std::uint64_t>(limited.axes_dropped);
  counters_.goals_unreachable += limited.unreachable ? 1 : 0;
  const Eigen::Matrix3d before = turned(setup_->mount, angles).R_WC;
  const Eigen::Matrix3d after = turned(setup_->mount, limited.angles).R_WC;
  motion.axis = {-before.col(2), -after.col(2)};
  if (limited.angles != angles && !tissue_of(lane).held(lane_in_group(lane)).empty())
    tissue_of(lane).turn_held(lane_in_group(lane), after * before.transpose());
  angles = limited.angles;
}

void SimBackend::move_tissue(std::span<ToolMotion> motion, std::span<StepOutcome> outcomes) {
  const auto W = static_cast<std::size_t>(width_);
  for (std::size_t g = 0; g < groups_.size(); ++g) {
    const std::size_t first = g * W;
    const std::size_t used = std::min(W, environments_.size() - first);
    if (robot_) {
      move_with_robot(motion);
    } else if (arms_.empty()) {
      groups_[g]->step(motion.subspan(first, W));
    } else {
      control_step<float>(std::span(arms_).subspan(first, used),
                          std::span(arm_states_).subspan(first, used), *groups_[g],
                          motion.subspan(first, W));
    }
    for (std::size_t k = first; k < first + used; ++k)
      slip_or_lose(static_cast<int>(k), outcomes[k]);
    estimate_exposure(g);
  }
}

void SimBackend::follow_robot(RobotTip robot) {
  OMENTUM_CHECK(lanes() == 1, "a robot is one lane, not {}", lanes());
  robot_ = std::move(robot);
  arm_states_.resize(environments_.size());
  const Vector3d tip = to_vector(environments_[0].tip);
  place_tip(0, tip, tip);
}

void SimBackend::place_tip(int lane, const Vector3d& commanded, const Vector3d& robot) {
  Environment& e = environments_[lane];
  assign(e.tip, commanded);
  assign(e.start_position, commanded);
  assign(arm_states_[lane].p_WT_true, robot);
  assign(arm_states_[lane].p_WT_measured, robot);
}

void SimBackend::move_with_robot(std::span<ToolMotion> motion) {
  const Vector3d from = tip_of(0);
  const Vector3d to = robot_(motion[0].to);
  motion[0] = {from, to};
  assign(arm_states_[0].p_WT_true, to);
  assign(arm_states_[0].p_WT_measured, to);
  groups_[0]->step(motion);
}

void SimBackend::estimate_exposure(std::size_t group) {
  const auto W = static_cast<std::size_t>(width_);
  const std::size_t first = group * W;
  const std::size_t used = std::min(W, environments_.size() - first);
  std::uint32_t wanted = 0;
  for (std::size_t l = 0; l < used; ++l) {
    if (is_held(static_cast<int>(first + l))) {
      wanted |= 1U << l;
    } else {
      environments_[first + l].exposure = 0;
    }
  }
  if (!task_.needs_exposure()) return;
  std::array<float, 16> exposures{};
  exposure_.of_lanes(*groups_[group], wanted, std::span(exposures).first(W));
  for (std::size_t l = 0; l < used; ++l) {
    if ((wanted >> l & 1U) != 0) environments_[first + l].exposure = exposures[l];
  }
}

// -----------------------------------------------------------------------------------------
// what the outside sees

void SimBackend::observe(int lane, std::span<float> observation) const {
  OMENTUM_CHECK(static_cast<int>(observation.size()) == observation_size_);
  const TaskState state = task_state(lane);
  const std::span<float> pixels = task_.observe(state, observation);
  if (pixels.empty()) return;
  OMENTUM_CHECK(static_cast<bool>(image_), "observation OBSERVATION_IMAGE needs an image source");
  std::vector<float> vertices;
  surface(lane, vertices);
  image_(vertices, state.measured_tip, state.jaw_deg, pixels);
}

EpisodeFacts SimBackend::clock(int lane) const {
  const Environment& e = environments_[lane];
  EpisodeFacts facts;
  facts.episode = e.episode;
  facts.episode_step = e.episode_step;
  facts.episode_limit = e.episode_limit;
  facts.held = is_held(lane);
  facts.grasped_ever = e.grasped_ever != 0;
  facts.reached = e.reached != 0;
  facts.lost_ever = e.lost_ever != 0;
  facts.episode_return = e.episode_return;
  const Vector3d tip = tip_of(lane);
  for (std::size_t k = 0; k < 3; ++k) {
    facts.start_position[k] = e.start_position[k];
    facts.grasp_position[k] = e.grasp_position[k];
    facts.tool_position[k] = tip[static_cast<Eigen::Index>(k)];
  }
  return facts;
}

EpisodeFacts SimBackend::facts(int lane) const {
  EpisodeFacts facts = clock(lane);
  if (defects_.exposure_seed_64px()) {
    std::vector<float> vertices;
    surface(lane, vertices);
    facts.exposure = static_cast<float>(exposure_.seed_64px(vertices));
  } else {
    std::array<float, 16> exposures{};
    exposure_.of_lanes(*groups_[lane / width_], 1U << lane_in_group(lane),
                       std::span(exposures).first(width_));
    facts.exposure = exposures[lane_in_group(lane)];
  }
  facts.exposure = defects_.exposure_racy(facts.exposure, facts.episode_step);
  return facts;
}

bool SimBackend::at_target(int lane) const {
  return task_.at_target(to_vector(environments_[lane].tip));
}

Action SimBackend::hold_action(int lane) const {
  return task_.hold_action(to_vector(environments_[lane].tip));
}

bool SimBackend::healthy(int lane) const {
  return groups_[lane / width_]->healthy(lane_in_group(lane));
}

}  // namespace omentum
