#include "sim_worker/backend/sim_backend.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/check.h"
#include "core/reward.h"
#include "core/rng.h"
#include "core/trig.h"
#include "sim_worker/models.h"
#include "sim_worker/tissue/randomise.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kSettleTime =
    3.0;  // [s] the sheet has come to rest on kidney and tumour (docs/results.md)

constexpr double kNearRange = 0.005;  // [m] where the fine observation of the way left saturates

Vector3d to_vector(const double* p) { return {p[0], p[1], p[2]}; }

void assign(double* to, const Vector3d& from) {
  for (int k = 0; k < 3; ++k) to[k] = from[k];
}

/// Index of a value -1, 0, +1 in the action table of a preset, and back.
constexpr std::array<int, 3> kOrdered = {-1, 0, 1};  // index 0, 1, 2 -> -1, 0, +1
constexpr std::array<int, 3> kDerived = {0, 1, -1};  // index 0, 1, 2 -> 0, +1, -1 (D1)

struct ActionTable {
  std::array<int, 3> axis;   ///< W axis of branch 0, 1, 2
  std::array<int, 3> value;  ///< value of index 0, 1, 2
};

/// Unity is left-handed with y up: Unity (x, y, z) is W (x, z, y).
ActionTable action_table(pb::ActionKind kind) {
  switch (kind) {
    case pb::ACTION_DERIVED:
      return {{0, 2, 1}, kDerived};  // Unity x, y, z
    case pb::ACTION_DERIVED_HEAD:
      return {{2, 1, 0}, kOrdered};  // Unity y, z, x
    default:
      return {{0, 1, 2}, kOrdered};
  }
}

bool has_gripper(pb::ActionKind kind) {
  return kind == pb::ACTION_XYZ_GRIPPER || kind == pb::ACTION_CONTINUOUS;
}

}  // namespace

std::shared_ptr<const SimSetup> make_sim_setup(const pb::Config& config,
                                               const std::string& directory) {
  auto setup = std::make_shared<SimSetup>();
  setup->config = config;
  setup->scene = make_scene(config.scene(), directory);
  setup->warnings = setup->scene.warnings;
  setup->tissue =
      make_tissue_model(setup->scene, config.task().control_period_s(), setup->warnings);
  setup->mount = scene_tool_mount(setup->scene);
  setup->arm = std::make_shared<Arm>(setup->scene.config.arm(), setup->mount,
                                     config.task().control_period_s());
  setup->workspace_diagonal = (setup->scene.workspace_max - setup->scene.workspace_min).norm();
  setup->exposure = std::make_shared<ExposureEstimator>(
      setup->scene, static_cast<int>(config.task().exposure_samples()));
  const double speed = config.task().increment_m() / config.task().control_period_s();
  if (speed > 0.05 + 1e-9) {  // docs/task.md 5: warn above 50 mm/s
    setup->warnings.push_back(
        fmt::format("task.increment_m: {} m every {} s is {:.3g} m/s per axis, above 0.05 m/s",
                    config.task().increment_m(), config.task().control_period_s(), speed));
  }
  check_randomise(config, setup->scene);
  return setup;
}

SimBackend::SimBackend(std::shared_ptr<const SimSetup> setup, int lanes, unsigned lane_width,
                       ImageSource image)
    : setup_(std::move(setup)),
      width_(choose_kernel(lane_width).lanes),
      environments_(static_cast<std::size_t>(lanes)),
      exposure_(*setup_->exposure),
      image_(std::move(image)),
      exposure_every_step_(setup_->config.task().reward() == pb::REWARD_OMENTUM ||
                           setup_->config.task().observation() == pb::OBSERVATION_OMENTUM ||
                           setup_->config.task().observation() == pb::OBSERVATION_IMAGE),
      lane_width_(lane_width) {
  OMENTUM_CHECK(lanes > 0);
  if (setup_->arm->active()) arms_.resize(environments_.size());
  const LaneKernel<float>& kernel = choose_kernel(lane_width);
  for (int first = 0; first < lanes; first += width_) {
    groups_.push_back(setup_->tissue->make_tissue(kernel));
  }
  for (int lane = 0; lane < lanes; ++lane) reset(lane, {});
}

int SimBackend::observation_size() const {
  const pb::Task& task = setup_->config.task();
  switch (task.observation()) {
    case pb::OBSERVATION_DERIVED_HEAD:
      return 8;
    case pb::OBSERVATION_OMENTUM:
      return 20;
    case pb::OBSERVATION_IMAGE: {
      const int channels = task.image() == pb::IMAGE_SHADED ? 3 : 1;
      return 20 + channels * static_cast<int>(task.image_size() * task.image_size());
    }
    default:
      return 12;
  }
}

std::uint32_t SimBackend::state_format() const { return kSimStateFormat; }

std::uint32_t SimBackend::ticks_per_step() const {
  return setup_->config.task().action_repeat() * setup_->tissue->substeps();
}

Vector3d SimBackend::start_of(const EpisodeStart& start) const {
  const Scene& scene = setup_->scene;
  const pb::Task& task = setup_->config.task();
  if (start.start_set == StartSet::kGrid || start.start_set == StartSet::kRobotGrid) {
    const auto& starts =
        start.start_set == StartSet::kGrid ? scene.grid_starts : scene.robot_starts;
    OMENTUM_CHECK(start.start_index < starts.size(), "start {} of {}", start.start_index,
                  starts.size());
    return starts[start.start_index];
  }
  // Defect grid_stuck: the random start is drawn and not used.
  if (start.start_set == StartSet::kGraspLattice || !task.random_start() ||
      setup_->config.defects().grid_stuck() || scene.grid_starts.empty()) {
    return scene.tool_start;
  }
  // Training: uniform in the rectangle of the start grid, height +- range. A point out of the arm's
  // reach is drawn again with the next draw number; the rectangle is reachable, so this ends at
  // once in our scenes.
  Vector3d min = scene.grid_starts.front();
  Vector3d max = min;
  for (const Vector3d& p : scene.grid_starts) {
    min = min.cwiseMin(p);
    max = max.cwiseMax(p);
  }
  const double height = task.start_height_range_m();
  for (std::uint32_t draw = 0; draw < 64; ++draw) {
    const PhiloxWords words =
        random_words(start.run_seed, start.slot, Purpose::kReset, draw, start.episode, 0);
    Vector3d p(uniform(words[0], min.x(), max.x()), uniform(words[1], min.y(), max.y()),
               uniform(words[2], min.z() - height, max.z() + height));
    p = p.cwiseMax(scene.workspace_min).cwiseMin(scene.workspace_max);
    if (joints_for_tip(setup_->mount, p)) return p;
  }
  return scene.tool_start;
}

void SimBackend::draw_parameters(int lane) {
  const Environment& e = environments_[static_cast<std::size_t>(lane)];
  DrawnParameters drawn;
  if (static_cast<StartSet>(e.start_set) == StartSet::kTraining) {
    drawn = draw_randomised(setup_->config, setup_->scene, e.run_seed, e.slot, e.episode);
  }
  tissue_of(lane).set_parameters(lane_in_group(lane), drawn.parameters);
  tissue_of(lane).reset(lane_in_group(lane), drawn.offset);
}

void SimBackend::reset(int lane, const EpisodeStart& start) {
  Tissue<float>& tissue = tissue_of(lane);
  const int l = lane_in_group(lane);
  const pb::Defects& defects = setup_->config.defects();
  // Named defects of the seed carry something of the last episode over; everything else starts from
  // nothing.
  std::vector<Vector3d> old_velocities;
  std::vector<std::int32_t> old_patch;
  double pending_bonus = 0;
  if (start.follows_episode) {
    if (defects.reset_positions_only()) {
      const auto count = static_cast<int>(setup_->scene.tissue.particles.size());
      for (int i = 0; i < count; ++i) old_velocities.push_back(tissue.velocity(l, i));
    }
    if (defects.reset_patch_at_tool())
      old_patch.assign(tissue.held(l).begin(), tissue.held(l).end());
    pending_bonus = environments_[static_cast<std::size_t>(lane)].pending_bonus;
  }

  Environment e{};
  e.run_seed = start.run_seed;
  e.slot = start.slot;
  e.episode = start.episode;
  e.start_set = static_cast<std::uint32_t>(start.start_set);
  e.start_index = start.start_index;
  const pb::Task& task = setup_->config.task();
  e.episode_limit = start.episode_limit != 0
                        ? start.episode_limit
                        : std::max(1U, task.episode_steps() / task.action_repeat());
  const Vector3d tip = start_of(start);
  assign(e.tip, tip);
  assign(e.start_position, tip);
  for (double& v : e.grasp_position) v = std::nan("");
  e.jaw_deg = setup_->config.grasp().jaw_open_deg();
  e.jaw_was_open = 1;
  e.pending_bonus = pending_bonus;
  environments_[static_cast<std::size_t>(lane)] = e;
  if (!arms_.empty()) setup_->arm->reset(arms_[static_cast<std::size_t>(lane)], tip);
  draw_parameters(lane);

  for (std::size_t i = 0; i < old_velocities.size(); ++i) {
    if (setup_->scene.tissue.fixed[i] == 0)
      tissue.set_velocity(l, static_cast<int>(i), old_velocities[i]);
  }
  for (const std::int32_t i : old_patch) tissue.set_position(l, i, tip);
  if (start.start_set == StartSet::kGraspLattice) place_on_lattice(lane, start.start_index);
}

const Bytes& SimBackend::settled_state() const {
  if (!settled_.empty()) return settled_;
  // The sheet alone, tool at p_0, until it rests: one lane of a batch of its own.
  const auto tissue = setup_->tissue->make_tissue(choose_kernel(lane_width_));
  const std::vector<ToolMotion> still(
      static_cast<std::size_t>(tissue->lanes()),
      ToolMotion{setup_->scene.tool_start, setup_->scene.tool_start});
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
  Environment& e = environments_[static_cast<std::size_t>(lane)];
  const Vector3d tip = tissue.position(l, static_cast<int>(particle))
                           .cwiseMax(setup_->scene.workspace_min)
                           .cwiseMin(setup_->scene.workspace_max);
  assign(e.tip, tip);
  assign(e.start_position, tip);
  if (!arms_.empty()) setup_->arm->reset(arms_[static_cast<std::size_t>(lane)], tip);
  e.jaw_closed = 1;
  e.jaw_deg = 0;
  e.jaw_was_open = 0;
  // A point out of the arm's reach, or with nothing but fixed particles around, holds nothing: its
  // exposure is that of the untouched sheet.
  if (joints_for_tip(setup_->mount, tip)) attach(lane);
}

SimBackend::Command SimBackend::decode(const Action& action) const {
  const pb::Task& task = setup_->config.task();
  Command command;
  if (task.action() == pb::ACTION_CONTINUOUS) {
    for (int k = 0; k < 3; ++k) {
      const double v = static_cast<double>(action.continuous[static_cast<std::size_t>(k)]);
      command.increment[k] = task.increment_m() * std::clamp(v, -1.0, 1.0);
    }
    command.closed = action.continuous[3] > 0;
    return command;
  }
  const ActionTable table = action_table(task.action());
  for (std::size_t b = 0; b < 3; ++b) {
    OMENTUM_DCHECK(action.branch[b] < 3);
    command.increment[table.axis[b]] = task.increment_m() * table.value[action.branch[b]];
  }
  command.closed = !has_gripper(task.action()) || action.branch[3] == 1;
  return command;
}

Vector3d SimBackend::tip_of(int lane) const {
  const auto k = static_cast<std::size_t>(lane);
  return to_vector(arms_.empty() ? environments_[k].tip : arms_[k].p_WT_true);
}

Vector3d SimBackend::measured_tip(int lane) const {
  const auto k = static_cast<std::size_t>(lane);
  return to_vector(arms_.empty() ? environments_[k].tip : arms_[k].p_WT_measured);
}

/// From commanded to true motion of the tips, with the load of the last step.
void SimBackend::move_arms(std::vector<ToolMotion>& motion) {
  for (std::size_t k = 0; k < arms_.size(); ++k) {
    const int lane = static_cast<int>(k);
    motion[k].from = tip_of(lane);
    setup_->arm->step(arms_[k], to_vector(environments_[k].tip),
                      tissue_of(lane).held_force(lane_in_group(lane)));
    motion[k].to = tip_of(lane);
  }
}

bool SimBackend::is_held(int lane) const {
  const auto& tissue = *groups_[static_cast<std::size_t>(lane / width_)];
  const auto held = tissue.held(lane_in_group(lane));
  // Ascending, and a body under the sheet comes after it.
  const bool tissue_held =
      !held.empty() && held.front() < static_cast<int>(setup_->scene.tissue.particles.size());
  return tissue_held || environments_[static_cast<std::size_t>(lane)].holds_rigid != 0;
}

bool SimBackend::jaws_hold(int lane) const {
  const auto& tissue = *groups_[static_cast<std::size_t>(lane / width_)];
  return is_held(lane) || !tissue.held(lane_in_group(lane)).empty();
}

RewardState SimBackend::reward_state(int lane) const {
  const Environment& e = environments_[static_cast<std::size_t>(lane)];
  RewardState state;
  state.held = setup_->config.defects().reward_jaw_closed() ? e.jaw_closed != 0 : is_held(lane);
  state.distance_q = (tip_of(lane) - setup_->scene.tumour_point).norm();
  state.distance_target = (tip_of(lane) - setup_->scene.target).norm();
  state.workspace_diagonal = setup_->workspace_diagonal;
  state.grasp_distance_q = (to_vector(e.held_from) - setup_->scene.tumour_point).norm();
  state.exposure = static_cast<double>(e.exposure);
  return state;
}

double SimBackend::reward_now(int lane) const {
  const pb::Task& task = setup_->config.task();
  const RewardWeights weights{task.exposure_weight(), task.exposure_distance_m(),
                              task.grasp_distance_per_m()};
  return reward(task.reward(), reward_state(lane), weights);
}

double SimBackend::potential_now(int lane) const {
  const double weight = setup_->config.task().progress_per_m();
  return weight > 0 ? progress_potential(reward_state(lane), weight) : 0;
}

// One decision: action_repeat control periods of reward, jaw, limited motion, tissue, slip,
// exposure.
void SimBackend::step(std::span<const Action> actions, std::span<StepOutcome> outcomes) {
  OMENTUM_CHECK(actions.size() == environments_.size() && outcomes.size() == environments_.size());
  const pb::Task& task = setup_->config.task();
  const auto W = static_cast<std::size_t>(width_);
  std::vector<Command> commands(environments_.size());
  std::vector<StepOutcome> control(environments_.size());
  std::vector<double> rewards(environments_.size(), 0);
  std::vector<std::uint8_t> ended(environments_.size(), 0);
  for (std::size_t k = 0; k < commands.size(); ++k) {
    commands[k] = decode(actions[k]);
    outcomes[k] = {};
    outcomes[k].held_before = is_held(static_cast<int>(k));
    rewards[k] += environments_[k].pending_bonus - potential_now(static_cast<int>(k));
    environments_[k].pending_bonus = 0;
  }
  std::vector<ToolMotion> motion(groups_.size() * W);
  std::vector<float> exposures(W);
  for (std::uint32_t repeat = 0; repeat < task.action_repeat(); ++repeat) {
    for (int lane = 0; lane < lanes(); ++lane) {
      if (ended[static_cast<std::size_t>(lane)] == 0)
        rewards[static_cast<std::size_t>(lane)] += reward_now(lane);
    }
    move_jaw_and_grasp(commands, control);
    for (std::size_t k = 0; k < environments_.size(); ++k) {
      Environment& e = environments_[k];
      const Vector3d from = to_vector(e.tip);
      const LimitedCommand limited = limit_command(setup_->mount, from, commands[k].increment);
      counters_.axes_dropped += static_cast<std::uint64_t>(limited.axes_dropped);
      counters_.goals_unreachable += limited.unreachable ? 1 : 0;
      motion[k] = {from, limited.p_WT};
      assign(e.tip, limited.p_WT);
    }
    move_arms(motion);
    for (std::size_t g = 0; g < groups_.size(); ++g) {
      groups_[g]->step(std::span(motion).subspan(g * W, W));
      std::uint32_t wanted = 0;
      for (std::size_t l = 0; l < W && g * W + l < environments_.size(); ++l) {
        const std::size_t k = g * W + l;
        slip_or_lose(static_cast<int>(k), outcomes[k]);
        if (is_held(static_cast<int>(k))) {
          wanted |= 1U << l;
        } else {
          environments_[k].exposure = 0;
        }
      }
      if (!exposure_every_step_) continue;
      exposure_.of_lanes(*groups_[g], wanted, exposures);
      for (std::size_t l = 0; l < W && g * W + l < environments_.size(); ++l) {
        if ((wanted >> l & 1U) != 0) environments_[g * W + l].exposure = exposures[l];
      }
    }
    for (std::size_t k = 0; k < environments_.size(); ++k) {
      Environment& e = environments_[k];
      const double distance = (tip_of(static_cast<int>(k)) - setup_->scene.target).norm();
      const bool held = is_held(static_cast<int>(k));
      if (held && distance < task.success_radius_m()) e.reached = 1;
      if (ended[k] == 0 && task.end_distance_m() > 0 && held && distance < task.end_distance_m()) {
        ended[k] = 1;
        // D adds the bonus after the end signal, so it lands on the next episode: a named defect.
        (setup_->config.defects().bonus_next_episode() ? e.pending_bonus : rewards[k]) +=
            task.end_bonus();
      }
    }
  }
  for (std::size_t k = 0; k < environments_.size(); ++k) {
    Environment& e = environments_[k];
    ++e.episode_step;
    rewards[k] += potential_now(static_cast<int>(k));
    outcomes[k].reward = static_cast<float>(rewards[k]);
    e.episode_return += static_cast<double>(outcomes[k].reward);
    outcomes[k].terminated = ended[k] != 0;
    outcomes[k].truncated = ended[k] == 0 && e.episode_step >= e.episode_limit;
  }
}

void SimBackend::observe(int lane, std::span<float> observation) const {
  OMENTUM_CHECK(static_cast<int>(observation.size()) == observation_size());
  const Environment& e = environments_[static_cast<std::size_t>(lane)];
  const Scene& scene = setup_->scene;
  const pb::ObservationKind kind = setup_->config.task().observation();
  const bool raw = kind == pb::OBSERVATION_DERIVED || kind == pb::OBSERVATION_DERIVED_HEAD;
  const Vector3d p = measured_tip(lane);
  std::size_t next = 0;
  const auto add = [&](double value) { observation[next++] = static_cast<float>(value); };
  const auto add_position = [&](const Vector3d& position) {
    if (raw) {
      // Units of 100 mm, Unity axes (x, z, y).
      add(10 * position.x());
      add(10 * position.z());
      add(10 * position.y());
      return;
    }
    for (int k = 0; k < 3; ++k) {
      add(2 * (position[k] - scene.workspace_min[k]) /
              (scene.workspace_max[k] - scene.workspace_min[k]) -
          1);
    }
  };
  const auto add_distance = [&](double distance) {
    add(raw ? 10 * distance : distance / setup_->workspace_diagonal);
  };
  const bool held = is_held(lane);
  add(held ? 0 : 1);
  add_position(p);
  if (kind == pb::OBSERVATION_DERIVED_HEAD) {
    const Vector3d& goal = held ? scene.target : scene.tumour_point;
    add_position(goal);
    add_distance((p - goal).norm());
    return;
  }
  add_position(scene.tumour_point);
  add_position(scene.target);
  add_distance((p - scene.tumour_point).norm());
  add_distance((p - scene.target).norm());
  if (kind != pb::OBSERVATION_OMENTUM && kind != pb::OBSERVATION_IMAGE) return;
  // How far the jaw is closed: its angle where it has one (a robot measures it), else the command.
  const double open = setup_->config.grasp().jaw_open_deg();
  add(open > 0 ? 1 - e.jaw_deg / open : static_cast<double>(e.jaw_closed));
  add(static_cast<double>(e.exposure));
  // Where the sheet was taken hold of: without it the value of a held state cannot be told.
  add_position(held ? to_vector(e.held_from) : p);
  // The way that is left, fine: over the workspace's width a millimetre is 0.01 of an input, and
  // greedy policies stood still 3 mm from p_T (docs/decisions/0009).
  const Vector3d way = (held ? scene.target : scene.tumour_point) - p;
  for (int k = 0; k < 3; ++k) add(std::clamp(way[k] / kNearRange, -1.0, 1.0));
  if (kind != pb::OBSERVATION_IMAGE) return;
  OMENTUM_CHECK(static_cast<bool>(image_), "observation OBSERVATION_IMAGE needs an image source");
  std::vector<float> vertices;
  surface(lane, vertices);
  image_(vertices, p, e.jaw_deg, observation.subspan(next));
}

EpisodeFacts SimBackend::clock(int lane) const {
  const Environment& e = environments_[static_cast<std::size_t>(lane)];
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

bool SimBackend::at_target(int lane) const {
  const pb::Task& task = setup_->config.task();
  const Vector3d way =
      setup_->scene.target - to_vector(environments_[static_cast<std::size_t>(lane)].tip);
  // Half a step and a rounding: what hold_action() leaves.
  return way.cwiseAbs().maxCoeff() <= 0.5 * task.increment_m() * task.action_repeat() + 1e-9;
}

EpisodeFacts SimBackend::facts(int lane) const {
  const Environment& e = environments_[static_cast<std::size_t>(lane)];
  EpisodeFacts facts = clock(lane);
  const pb::Defects& defects = setup_->config.defects();
  if (defects.exposure_seed_64px()) {
    std::vector<float> vertices;
    surface(lane, vertices);
    facts.exposure = static_cast<float>(exposure_.seed_64px(vertices));
  } else {
    std::array<float, 16> exposures{};
    exposure_.of_lanes(*groups_[static_cast<std::size_t>(lane / width_)], 1U << lane_in_group(lane),
                       std::span(exposures).first(static_cast<std::size_t>(width_)));
    facts.exposure = exposures[static_cast<std::size_t>(lane_in_group(lane))];
  }
  // The seed zeroes its counter each frame before the read at the frame's end: a reader in between
  // sees nothing.
  if (defects.exposure_racy() && e.episode_step % 2 == 1) facts.exposure = 0;
  return facts;
}

Action SimBackend::hold_action(int lane) const {
  const Environment& e = environments_[static_cast<std::size_t>(lane)];
  const pb::Task& task = setup_->config.task();
  const Vector3d way = setup_->scene.target - to_vector(e.tip);
  const double reach = task.increment_m() * task.action_repeat();
  Action action;
  if (task.action() == pb::ACTION_CONTINUOUS) {
    for (int k = 0; k < 3; ++k) {
      action.continuous[static_cast<std::size_t>(k)] =
          static_cast<float>(std::clamp(way[k] / reach, -1.0, 1.0));
    }
    action.continuous[3] = 1;
    return action;
  }
  const ActionTable table = action_table(task.action());
  for (std::size_t b = 0; b < 3; ++b) {
    const double distance = way[table.axis[b]];
    // Half a step: nearer than that, another step would only overshoot.
    const int wanted = distance > 0.5 * reach ? 1 : distance < -0.5 * reach ? -1 : 0;
    const auto index =
        std::find(table.value.begin(), table.value.end(), wanted) - table.value.begin();
    action.branch[b] = static_cast<std::uint8_t>(index);
  }
  action.branch[3] = has_gripper(task.action()) ? 1 : 0;
  return action;
}

bool SimBackend::healthy(int lane) const {
  return groups_[static_cast<std::size_t>(lane / width_)]->healthy(lane_in_group(lane));
}

void SimBackend::positions(int lane, std::vector<float>& out) const {
  const auto& tissue = *groups_[static_cast<std::size_t>(lane / width_)];
  out.clear();
  for (int i = 0; i < tissue.particles(); ++i) {
    const Vector3d p = tissue.position(lane_in_group(lane), i);
    for (int k = 0; k < 3; ++k) out.push_back(static_cast<float>(p[k]));
  }
}

void SimBackend::surface(int lane, std::vector<float>& out) const {
  auto& tissue = *groups_[static_cast<std::size_t>(lane / width_)];
  const float* vertices = tissue.surface_positions();
  out.clear();
  for (int v = 0; v < tissue.surface_vertices(); ++v) {
    for (int k = 0; k < 3; ++k) {
      out.push_back(vertices[static_cast<std::size_t>((3 * v + k) * width_ + lane_in_group(lane))]);
    }
  }
}

/// Bytes of a state before those of the tissue.
std::size_t SimBackend::head_bytes() const {
  return sizeof(Environment) + (arms_.empty() ? 0 : sizeof(ArmState));
}

Bytes SimBackend::save(int lane) const {
  Bytes bytes(head_bytes());
  std::memcpy(bytes.data(), &environments_[static_cast<std::size_t>(lane)], sizeof(Environment));
  if (!arms_.empty()) {
    std::memcpy(bytes.data() + sizeof(Environment), &arms_[static_cast<std::size_t>(lane)],
                sizeof(ArmState));
  }
  groups_[static_cast<std::size_t>(lane / width_)]->save(lane_in_group(lane), bytes);
  return bytes;
}

Result<void> SimBackend::load(int lane, std::span<const std::byte> state) {
  const std::size_t head = head_bytes();
  if (state.size() < head) {
    return Failure{
        fmt::format("environment state of {} bytes, needed more than {}", state.size(), head)};
  }
  Environment e{};
  std::memcpy(&e, state.data(), sizeof e);
  for (int k = 0; k < 3; ++k) {
    // The tip never leaves the workspace; anything else is not a state of ours.
    if (!(e.tip[k] >= setup_->scene.workspace_min[k] &&
          e.tip[k] <= setup_->scene.workspace_max[k])) {
      return Failure{fmt::format("environment state has the tip at {} m on axis {}", e.tip[k], k)};
    }
  }
  if (!std::isfinite(e.jaw_deg) || !std::isfinite(e.slip) || !std::isfinite(e.episode_return) ||
      !std::isfinite(e.pending_bonus) ||
      !std::isfinite(e.held_from[0] + e.held_from[1] + e.held_from[2]) ||
      !std::isfinite(e.exposure) || e.episode_limit == 0) {
    return Failure{"environment state holds a non-finite number or a zero episode limit"};
  }
  ArmState arm{};
  if (!arms_.empty()) {
    std::memcpy(&arm, state.data() + sizeof(Environment), sizeof arm);
    std::array<double, sizeof(ArmState) / sizeof(double)> numbers{};
    std::memcpy(numbers.data(), &arm, sizeof arm);
    if (!std::all_of(numbers.begin(), numbers.end(), [](double v) { return std::isfinite(v); }))
      return Failure{"arm state holds a non-finite number"};
  }
  const Result<std::size_t> used = tissue_of(lane).load(lane_in_group(lane), state.subspan(head));
  if (!used) return Failure{used.error()};
  if (!arms_.empty()) arms_[static_cast<std::size_t>(lane)] = arm;
  environments_[static_cast<std::size_t>(lane)] = e;
  return {};
}

}  // namespace omentum
