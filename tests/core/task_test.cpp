// The task as every back end has it: core/task.h on plain numbers, without a simulation.

#include "core/task.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Strings = std::vector<std::string>;

TaskPlaces places() {
  TaskPlaces places;
  places.tumour_point = {0.017, 0.052, 0.024};
  places.target = {-0.036, 0.055, 0.110};
  places.tool_start = {0.0104, 0.0511, 0.1076};
  places.grid_starts = {{-0.05, 0.02, 0.1}, {0.01, 0.02, 0.1}, {0.01, 0.08, 0.1}};
  places.robot_starts = {{-0.04, 0.06, 0.1}};
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  X_WR.translation() = Vector3d(0.1427, 0, 0.1584);
  places.mount =
      make_tool_mount(X_WR, 0.5, 0.0102, {-0.0916, -0.0825, 0.001}, {0.0691, 0.1155, 0.119});
  return places;
}

Task task_of(const std::string& preset, const Strings& sets = {}) {
  return {load_config(preset, sets), places()};
}

TaskState held_state() {
  TaskState state;
  state.tip = {0.011, 0.044, 0.052};
  state.measured_tip = {0.012, 0.045, 0.053};
  state.held_from = {0.016, 0.051, 0.025};
  state.held = true;
  state.jaw_closed = true;
  state.jaw_deg = 3;
  state.exposure = 0.25;
  return state;
}

/// What the number means in W, by its unit alone: coordinate or distance [m].
double in_world(const std::string& unit, double value, const Task& task) {
  const ToolMount& mount = task.places().mount;
  const auto along = unit.find("along ");
  const int axis = along == std::string::npos ? -1 : unit[along + 6] - 'x';
  if (unit.rfind("100 mm", 0) == 0) return 0.1 * value;
  if (unit.rfind("-1 ... 1 over the workspace", 0) == 0) {
    const double low = mount.workspace_min[axis], high = mount.workspace_max[axis];
    return low + 0.5 * (value + 1) * (high - low);
  }
  if (unit.rfind("5 mm along", 0) == 0) return 0.005 * value;
  EXPECT_EQ(unit, "diagonal of the workspace");
  return value * task.workspace_diagonal();
}

class EveryPreset : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Presets, EveryPreset,
                         testing::Values("omentum", "paper", "paper_literal", "paper_swapped",
                                         "derived", "derived_head", "omentum_elastic",
                                         "omentum_soft"),
                         [](const auto& p) { return std::string(p.param); });

TEST_P(EveryPreset, ObservesWhatNamesAndUnitsSay) {
  const Task task = task_of(GetParam());
  const pb::Task config = load_config(GetParam(), {}).task();
  for (const bool held : {true, false}) {
    TaskState state = held_state();
    state.held = held;
    // 2 mm from the goal: the fine way is not clamped.
    const Vector3d goal = held ? places().target : places().tumour_point;
    state.measured_tip = goal + Vector3d(0.002, -0.001, 0.0015);
    std::vector<float> seen(static_cast<std::size_t>(observation_size(config)));
    EXPECT_TRUE(task.observe(state, seen).empty()) << "every number is written";
    const std::map<std::string, Vector3d> points = {
        {"p", state.measured_tip},
        {"q", places().tumour_point},
        {"p_T", places().target},
        {"goal", goal},
        {"grasp", held ? state.held_from : state.measured_tip},
        {"near_goal", goal - state.measured_tip}};
    const std::map<std::string, double> distances = {
        {"distance_p_q", (state.measured_tip - places().tumour_point).norm()},
        {"distance_p_p_T", (state.measured_tip - places().target).norm()},
        {"distance_p_goal", (state.measured_tip - goal).norm()}};
    const std::vector<ObservedEntry> entries = observed_entries(config);
    ASSERT_EQ(entries.size(), seen.size());
    for (std::size_t i = 0; i < seen.size(); ++i) {
      const auto& [name, unit, size] = entries[i];
      EXPECT_EQ(size, 1);
      EXPECT_EQ(observation_name(config, static_cast<int>(i)), name);
      const auto value = static_cast<double>(seen[i]);
      EXPECT_EQ(unit.find(','), std::string::npos) << name;
      if (name == "held_flag") {
        EXPECT_EQ(value, held ? 0 : 1) << unit;
      } else if (name == "jaw_closed") {
        EXPECT_NEAR(value, 1 - 3.0 / load_config(GetParam(), {}).grasp().jaw_open_deg(), 1e-6);
      } else if (name == "exposure") {
        EXPECT_EQ(value, 0.25);
      } else if (distances.contains(name)) {
        EXPECT_NEAR(in_world(unit, value, task), distances.at(name), 1e-7) << name;
      } else {
        const Vector3d& point = points.at(name.substr(0, name.size() - 2));
        const int axis = unit[unit.find("along ") + 6] - 'x';
        EXPECT_NEAR(in_world(unit, value, task), point[axis], 1e-7) << name << " in " << unit;
      }
    }
  }
}

TEST_P(EveryPreset, HoldScriptEndsAtTheTargetAndStaysThere) {
  for (const Strings& sets : {Strings{}, Strings{"task.action=ACTION_CONTINUOUS"}}) {
    const pb::Config config = load_config(GetParam(), sets);
    const Task task(config, places());
    Vector3d tip(0.0201, 0.0903, 0.0307);
    for (int step = 0; step < 400; ++step) {
      const ToolCommand command = task.decode(task.hold_action(tip));
      EXPECT_TRUE(command.closed);
      for (std::uint32_t r = 0; r < config.task().action_repeat(); ++r) tip += command.increment;
    }
    EXPECT_TRUE(task.at_target(tip));
    EXPECT_EQ(task.decode(task.hold_action(places().target)).increment, Vector3d::Zero());
    EXPECT_FALSE(task.at_target(tip + Vector3d(0, 0.006, 0)));
  }
}

TEST_P(EveryPreset, ActionNamesAndBranchesAreOfOneTable) {
  const pb::Task config = load_config(GetParam(), {}).task();
  EXPECT_EQ(action_names(config).size(), action_branches(config).size());
}

TEST(ObservedImage, IsOneEntryWithItsShapeAndNamesItsPixelsInTheOrderOfTheirBytes) {
  pb::Task config = load_config("omentum", Strings{"task.observation=OBSERVATION_IMAGE"}).task();
  config.set_image_size(8);
  config.set_image(pb::IMAGE_SHADED);
  EXPECT_EQ(observation_size(config), 20 + 3 * 64);
  EXPECT_EQ(observation_names(config).size(), 21U);
  EXPECT_EQ(observation_names(config).back(), "image[8][8][3]");
  EXPECT_EQ(observed_entries(config).back().unit, "intensity 0 ... 1");
  EXPECT_EQ(observation_name(config, 19), "near_goal_z");
  EXPECT_EQ(observation_name(config, 20), "image[0][0][0]");
  EXPECT_EQ(observation_name(config, 24), "image[0][1][1]");
  EXPECT_EQ(observation_name(config, 20 + 3 * 64 - 1), "image[7][7][2]");
  config.set_image(pb::IMAGE_OBJECT_IDS);
  EXPECT_EQ(observation_size(config), 20 + 64);
  EXPECT_EQ(observation_names(config).back(), "image[8][8]");
  EXPECT_EQ(observed_entries(config).back().unit, "object id / 6");
  EXPECT_EQ(observation_name(config, 20 + 9), "image[1][1]");
  const Task task = task_of("omentum", {"task.observation=OBSERVATION_IMAGE", "task.image_size=8"});
  std::vector<float> seen(20 + 64);
  EXPECT_EQ(task.observe(held_state(), seen).data(), seen.data() + 20);
}

TEST(EpisodeStarts, AreOfTheGridsOrDrawnOverTheGrid) {
  const Task task = task_of("omentum");
  EpisodeStart start;
  start.start_set = StartSet::kGrid;
  start.start_index = 2;
  EXPECT_EQ(task.start_position(start), places().grid_starts[2]);
  start.start_set = StartSet::kRobotGrid;
  start.start_index = 0;
  EXPECT_EQ(task.start_position(start), places().robot_starts[0]);
  start = {};
  start.run_seed = 4;
  const Vector3d first = task.start_position(start);
  EXPECT_EQ(task.start_position(start), first);
  for (start.episode = 1; start.episode < 50; ++start.episode) {
    const Vector3d p = task.start_position(start);
    EXPECT_NE(p, first);
    EXPECT_TRUE(p.x() >= -0.05 && p.x() <= 0.01 && p.y() >= 0.02 && p.y() <= 0.08) << p;
    EXPECT_LE(std::abs(p.z() - 0.1), 0.01);
  }
  EXPECT_EQ(task_of("derived").start_position(start), places().tool_start);
}

TEST(EpisodeEnd, NeedsHeldTissueNearTheTarget) {
  const Task task = task_of("derived");  // ends at 15 mm, reached within 3 mm
  TaskState state = held_state();
  state.tip = places().target + Vector3d(0, 0.0149, 0);
  EXPECT_TRUE(task.is_over(state));
  EXPECT_FALSE(task.is_reached(state));
  state.tip = places().target + Vector3d(0, 0.0029, 0);
  EXPECT_TRUE(task.is_reached(state));
  state.held = false;
  EXPECT_FALSE(task.is_over(state));
  EXPECT_FALSE(task.is_reached(state));
  state.held = true;
  EXPECT_FALSE(task_of("paper").is_over(state)) << "its episodes end by steps alone";
  EXPECT_EQ(task.episode_limit({}), 500U);
}

// docs/decisions/0031: every "step" of the text is a decision, and the jaw's action lets go.
TEST(PaperLiteral, HasOneMeaningOfAStep) {
  const pb::Config literal = load_config("paper_literal", {});
  EXPECT_EQ(task_of("paper_literal").episode_limit({}), 1500U);
  EXPECT_EQ(literal.task().action_repeat(), 1U);
  EXPECT_EQ(literal.task().control_period_s(), 0.02);
  EXPECT_EQ(literal.rollout().max_steps(), 3'000'000U);
  EXPECT_EQ(literal.rollout().slots() * literal.rollout().steps_per_segment(), 10240U);
  EXPECT_FALSE(literal.grasp().automatic());
  EXPECT_FALSE(literal.ppo().scale_rewards());
}

TEST(RewardOfATask, IsOfTheTrueTipAndOfTheGraspPoint) {
  const Task task = task_of("omentum", {"task.grasp_distance_per_m=2", "task.progress_per_m=3",
                                        "task.progress_by_axis=false"});
  TaskState state = held_state();
  RewardState s;
  s.held = true;
  s.distance_q = (state.tip - places().tumour_point).norm();
  s.distance_target = (state.tip - places().target).norm();
  s.workspace_diagonal = task.workspace_diagonal();
  s.grasp_distance_q = (state.held_from - places().tumour_point).norm();
  s.exposure = 0.25;
  const pb::Task config = load_config("omentum", {}).task();
  EXPECT_EQ(
      task.reward_of(state),
      reward(pb::REWARD_OMENTUM, s, {config.exposure_weight(), config.exposure_distance_m(), 2}));
  EXPECT_EQ(task.potential_of(state), 3 * (0.13 - s.distance_target - s.grasp_distance_q));
  EXPECT_TRUE(task.needs_exposure());
  EXPECT_FALSE(task_of("paper").needs_exposure());
}

// Half a millimetre towards the place is worth the same on every axis, however far the others are.
TEST(ProgressByAxis, CountsEveryAxisAlike) {
  const Task task = task_of("omentum", {"task.progress_per_m=300", "task.progress_by_axis=true"});
  for (const bool held : {false, true}) {
    TaskState state = held_state();
    state.held = held;
    const Eigen::Vector3d place = held ? places().target : places().tumour_point;
    state.tip = place + Eigen::Vector3d(0.05, -0.004, 0.002);
    const double before = task.potential_of(state);
    for (int axis = 0; axis < 3; ++axis) {
      TaskState nearer = state;
      nearer.tip[axis] += state.tip[axis] > place[axis] ? -0.0005 : 0.0005;
      EXPECT_NEAR(task.potential_of(nearer) - before, 0.15, 1e-12) << axis << held;
    }
  }
}

// A jaw that closed beside the tissue has to open before it can take hold: opening it is progress.
TEST(ProgressByAxis, CountsTheWayOfTheOpeningJaw) {
  const std::vector<std::string> knobs = {"task.progress_per_m=300", "grasp.jaw_open_deg=24",
                                          "grasp.jaw_length_m=0.01"};
  TaskState closed = held_state();
  closed.held = false;
  closed.jaw_deg = 0;
  TaskState half_open = closed;
  half_open.jaw_deg = 12;
  for (const bool by_axis : {false, true}) {
    std::vector<std::string> all = knobs;
    all.push_back(by_axis ? "task.progress_by_axis=true" : "task.progress_by_axis=false");
    const Task task = task_of("omentum", all);
    const double way = by_axis ? 0.01 * 12 * kDegree : 0;
    EXPECT_NEAR(task.potential_of(half_open) - task.potential_of(closed), 300 * way, 1e-12);
    half_open.held = closed.held = true;
    EXPECT_EQ(task.potential_of(half_open), task.potential_of(closed));
    half_open.held = closed.held = false;
  }
}

// ---- a tool that is turned ----------------------------------------------------------------------

/// Two places, the second inclined by 45 degrees towards +y.
Task oriented_task(const Strings& sets = {}) {
  TaskPlaces all = places();
  all.tumour_places = {{{0.01, 0.05, 0.03}, Vector3d::UnitZ()},
                       {{-0.01, 0.06, 0.02}, Vector3d(0, 1, 1).normalized()}};
  return {load_config("omentum_oriented", sets), all};
}

TEST(OrientedTask, HasThreeMoreBranchesWhichTurnTheTool) {
  const pb::Task config = load_config("omentum_oriented", {}).task();
  EXPECT_EQ(action_names(config), (Strings{"x", "y", "z", "gripper", "roll", "pitch", "yaw"}));
  EXPECT_EQ(action_branches(config), (std::vector<int>{3, 3, 3, 2, 3, 3, 3}));
  EXPECT_EQ(action_meanings(config)[4], "roll 0=-2 deg 1=0 deg 2=2 deg");
  EXPECT_FALSE(turns_tool(load_config("omentum", {}).task()));
  const ToolCommand command = oriented_task().decode({{2, 1, 0, 1, 2, 1, 0}, {}});
  EXPECT_EQ(command.increment, Vector3d(0.0005, 0, -0.0005));
  EXPECT_TRUE(command.closed);
  EXPECT_NEAR((command.turn - Vector3d(kDegree, 0, -kDegree)).norm(), 0, 1e-15);
  EXPECT_EQ(task_of("omentum").decode({{2, 1, 0, 1, 2, 1, 0}, {}}).turn, Vector3d::Zero());
  const Task task = oriented_task();
  EXPECT_EQ(task.decode(task.hold_action({0, 0, 0})).turn, Vector3d::Zero());
}

TEST(OrientedTask, ObservesAnglesNormalAndOrientationError) {
  const Task task = oriented_task();
  TaskState state = held_state();
  state.held = false;
  state.angles = {30 * kDegree, -15 * kDegree, 0};
  state.place = &task.places().tumour_places[1];
  ASSERT_NE(state.place, nullptr);
  std::vector<float> seen(29);
  EXPECT_TRUE(task.observe(state, seen).empty());
  const auto from = [&seen](std::size_t i) {
    return Eigen::Vector3f(seen[i], seen[i + 1], seen[i + 2]).cast<double>().eval();
  };
  EXPECT_NEAR((from(20) - Vector3d(30, -15, 0) / 75).norm(), 0, 1e-6);
  EXPECT_NEAR((from(23) - state.place->normal).norm(), 0, 1e-6);
  const Vector3d jaw = turned(task.places().mount, state.angles).jaw_direction();
  EXPECT_NEAR((from(26) - jaw.cross(-state.place->normal)).norm(), 0, 1e-6);
  // Laid against the sheet the jaw has no error left, and so it is while tissue is held.
  state.angles = {-45 * kDegree, 0, 0};
  EXPECT_NEAR(task.orientation_error(state).norm(), 0, 1e-12);
  state.angles.setZero();
  EXPECT_NEAR(task.orientation_error(state).norm(), std::sqrt(0.5), 1e-12);
  state.held = true;
  EXPECT_EQ(task.orientation_error(state), Vector3d::Zero());
}

TEST(OrientedTask, DrawsThePlaceOfAnEpisode) {
  const Task task = oriented_task();
  const TumourPlace* const first = task.places().tumour_places.data();
  int second = 0;
  for (std::uint32_t i = 0; i < 100; ++i) {
    // Of a start of the grid by its number alone.
    const EpisodeStart start{.start_set = StartSet::kGrid, .start_index = i};
    EpisodeStart other{.run_seed = 9, .slot = 7, .episode = 4};
    other.start_set = start.start_set;
    other.start_index = i;
    EXPECT_EQ(task.place_of(start), task.place_of(other));
    second += task.place_of(start) == first + 1 ? 1 : 0;
  }
  EXPECT_GT(second, 30);
  EXPECT_LT(second, 70);
  second = 0;
  for (std::uint64_t episode = 0; episode < 200; ++episode) {
    const EpisodeStart start{.run_seed = 3, .slot = 5, .episode = episode};
    EXPECT_EQ(task.place_of(start), task.place_of(start));
    second += task.place_of(start) == first + 1 ? 1 : 0;
  }
  EXPECT_GT(second, 70);
  EXPECT_LT(second, 130);
  EXPECT_EQ(task_of("omentum").place_of({}), nullptr);
}

// While free towards the normal, while held back; taking hold there is worth nothing by itself.
TEST(OrientedTask, EveryDegreeThatIsLeftToTurnIsProgress) {
  const Task task = oriented_task({"task.progress_per_m=0", "task.progress_per_deg=0.25"});
  TaskState state = held_state();
  state.held = false;
  state.place = &task.places().tumour_places[1];
  EXPECT_NEAR(task.potential_of(state), -0.25 * 45, 1e-9);
  state.angles = {-10 * kDegree, 0, 0};
  EXPECT_NEAR(task.potential_of(state), -0.25 * 35, 1e-9);
  // A spin about the jaw is on no way.
  const double there = task.potential_of(state);
  state.angles[2] = 5 * kDegree;
  EXPECT_LT(task.potential_of(state), there);
  state.angles = {-45 * kDegree, 0, 0};
  EXPECT_NEAR(task.potential_of(state), 0, 1e-6);
  state.held = true;
  EXPECT_NEAR(task.potential_of(state), 0, 1e-6);
  state.angles = {-10 * kDegree, 0, 0};
  EXPECT_NEAR(task.potential_of(state), 0.25 * 35, 1e-9);
}

TEST(OrientedTask, KnobsOutOfRangeAreRefusedByName) {
  const std::pair<const char*, const char*> bad[] = {
      {"task.turn_increment_deg=0", "task.turn_increment_deg: 0 deg, allowed 0.01 ... 10"},
      {"task.turn_limit_deg=90", "task.turn_limit_deg: 90 deg, allowed 1 ... 85"},
      {"task.progress_per_deg=-1", "task.progress_per_deg: -1 1/deg, allowed 0 ... 100"}};
  for (const auto& [set, text] : bad) {
    try {
      load_config("omentum_oriented", Strings{set});
      ADD_FAILURE() << set;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr(text));
    }
  }
}

}  // namespace
}  // namespace omentum
