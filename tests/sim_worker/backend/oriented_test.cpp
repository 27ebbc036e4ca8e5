// Preset omentum_oriented: places on the inclined sheet, a tool that is turned, and what it cannot
// be combined with.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "sim_worker/backend/sim_backend.h"
#include "tests/support/resting_sheet.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Strings = std::vector<std::string>;

constexpr std::uint8_t kKeep = 1;

std::shared_ptr<const SimSetup> oriented(const Strings& sets = {}) {
  return make_sim_setup(load_config("omentum_oriented", sets));
}

TEST(OrientedScene, PlacesLieOnTheRestingSheetInclinedBy30To60Degrees) {
  const auto setup = oriented();
  const test::RestingSheet sheet = test::resting_sheet(*setup);
  ASSERT_GE(setup->scene.tumour_places.size(), 50U);
  for (const TumourPlace& place : setup->scene.tumour_places) {
    std::size_t nearest = 0;
    for (std::size_t i = 0; i < sheet.position.size(); ++i) {
      if ((sheet.position[i] - place.p).norm() < (sheet.position[nearest] - place.p).norm())
        nearest = i;
    }
    EXPECT_LT((sheet.position[nearest] - place.p).norm(), 1e-4) << place.p.transpose();
    EXPECT_GT(sheet.normal[nearest].dot(place.normal), std::cos(kDegree)) << nearest;
    const double incline = std::acos(place.normal.z()) / kDegree;
    EXPECT_GE(incline, 29.9);
    EXPECT_LE(incline, 60.1);
    // Straight down the jaw is out of its cone.
    EXPECT_GT(incline, setup->config.grasp().max_approach_deg());
  }
}

TEST(OrientedTool, TurnsInStepsUpToItsLimitAndStandsAsTheArmCan) {
  SimBackend backend(oriented({"task.turn_limit_deg=7"}), 1);
  EpisodeStart start;
  start.start_set = StartSet::kGrid;
  backend.reset(0, start);
  std::vector<StepOutcome> outcomes(1);
  const Action roll{{kKeep, kKeep, kKeep, 0, 2, kKeep, kKeep}, {}};
  for (const double expected : {2.0, 4.0, 6.0, 7.0, 7.0}) {
    backend.step(std::span(&roll, 1), outcomes);
    EXPECT_NEAR(backend.task_state(0).angles[0] / kDegree, expected, 1e-9);
  }
  EXPECT_NEAR(std::acos(-backend.jaw_direction(0).z()) / kDegree, 7, 1e-6);
  backend.reset(0, start);
  EXPECT_EQ(backend.task_state(0).angles, Vector3d::Zero());
}

// What is held turns about the tip as the tool does.
TEST(OrientedTool, TurnsWhatItHolds) {
  const auto setup = oriented();
  SimBackend backend(setup, 1);
  EpisodeStart start;
  start.start_set = StartSet::kGraspLattice;
  start.start_index = 16 * 31 + 20;
  backend.reset(0, start);
  const auto held = backend.tissue_of(0).held(0);
  ASSERT_GT(held.size(), 3U);
  const std::vector<std::int32_t> particles(held.begin(), held.end());
  const auto offsets = [&] {
    std::vector<Vector3d> list;
    for (const std::int32_t i : particles)
      list.push_back(backend.tissue_of(0).position(0, i) - backend.commanded_tip(0));
    return list;
  };
  std::vector<StepOutcome> outcomes(1);
  const Action lift{{kKeep, kKeep, 2, 1, kKeep, kKeep, kKeep}, {}};
  for (int i = 0; i < 20; ++i) backend.step(std::span(&lift, 1), outcomes);
  const std::vector<Vector3d> before = offsets();
  const Eigen::Matrix3d R_before = rotation_of(backend.task_state(0).angles);
  const Action turn{{kKeep, kKeep, kKeep, 1, 2, 0, kKeep}, {}};
  for (int i = 0; i < 5; ++i) backend.step(std::span(&turn, 1), outcomes);
  const Eigen::Matrix3d R = rotation_of(backend.task_state(0).angles) * R_before.transpose();
  EXPECT_GT(std::acos(0.5 * (R.trace() - 1)) / kDegree, 5);
  const std::vector<Vector3d> after = offsets();
  double largest = 0;
  for (std::size_t k = 0; k < before.size(); ++k) {
    // Slip of the grasp moves all of them alike.
    const Vector3d slip = after[0] - R * before[0];
    EXPECT_LT((after[k] - R * before[k] - slip).norm(), 2e-6) << k;
    largest = std::max(largest, (after[k] - before[k]).norm());
  }
  EXPECT_GT(largest, 3e-4);
}

// The shaft lies as the jaw points: laid on its side near the sheet it pushes what upright it does
// not touch.
TEST(OrientedTool, PushesWithItsShaft) {
  const auto setup = oriented({"scene.gravity_scale=0"});
  SimBackend backend(setup, 2);
  for (int lane = 0; lane < 2; ++lane) {
    EpisodeStart start;
    start.start_set = StartSet::kGrid;
    start.start_index = 55;
    backend.reset(lane, start);
  }
  const auto farthest = [&](int lane) {
    double way = 0;
    const TissueBody& body = setup->scene.tissue;
    for (std::size_t i = 0; i < body.particles.size(); ++i) {
      const Vector3d rest = body.X_WB * body.particles[i];
      way = std::max(
          way, (backend.tissue_of(lane).position(backend.lane_in_group(lane), static_cast<int>(i)) -
                rest)
                   .norm());
    }
    return way;
  };
  std::vector<StepOutcome> outcomes(2);
  std::vector<Action> actions(2);
  for (int i = 0; i < 76; ++i) {  // down beside the sheet
    for (Action& a : actions) a = {{kKeep, kKeep, 0, 0, kKeep, kKeep, kKeep}, {}};
    backend.step(actions, outcomes);
  }
  for (int i = 0; i < 35; ++i) {  // one of them lies down
    actions[1] = {{kKeep, kKeep, kKeep, 0, 2, kKeep, kKeep}, {}};
    actions[0] = {{kKeep, kKeep, kKeep, 0, kKeep, kKeep, kKeep}, {}};
    backend.step(actions, outcomes);
  }
  EXPECT_GT(backend.task_state(1).angles[0] / kDegree, 30);
  EXPECT_LT(farthest(0), 1e-3);
  EXPECT_GT(farthest(1), 2e-3) << backend.task_state(1).angles.transpose() / kDegree;
}

TEST(OrientedTool, StatesCarryTheAnglesAndRefuseOthers) {
  const auto setup = oriented();
  SimBackend backend(setup, 1);
  std::vector<StepOutcome> outcomes(1);
  const Action roll{{kKeep, kKeep, kKeep, 0, 2, 0, kKeep}, {}};
  for (int i = 0; i < 3; ++i) backend.step(std::span(&roll, 1), outcomes);
  const TaskState before = backend.task_state(0);
  Bytes state = backend.save(0);
  backend.reset(0, {});
  ASSERT_TRUE(backend.load(0, state).has_value());
  EXPECT_EQ(backend.task_state(0).angles, before.angles);
  EXPECT_EQ(backend.task_state(0).place, before.place);
  // The angles are the last of the numbers before the tissue's.
  const SimBackend other(oriented({"task.action=ACTION_XYZ_GRIPPER"}), 1);
  const double wide = 80 * kDegree;
  const auto found = std::search(state.begin(), state.end(),
                                 reinterpret_cast<const std::byte*>(before.angles.data()),
                                 reinterpret_cast<const std::byte*>(before.angles.data() + 3));
  ASSERT_NE(found, state.end());
  std::copy_n(reinterpret_cast<const std::byte*>(&wide), sizeof wide, found);
  const Result<void> loaded = backend.load(0, state);
  ASSERT_FALSE(loaded.has_value());
  EXPECT_THAT(loaded.error(), testing::HasSubstr("turned by 80"));
  EXPECT_THAT(loaded.error(), testing::HasSubstr("allowed +- 75"));
}

TEST(OrientedSetup, RefusesWhatItCannotDoByName) {
  const std::pair<Strings, const char*> bad[] = {
      {{"scene.arm.transport_delay_s=0.02"},
       "task.action: ACTION_ORIENTED with effects of the arm"},
      {{"randomise={ parameter: \"arm.droop_s\" min: 0 max: 0.02 }"},
       "task.action: ACTION_ORIENTED with effects of the arm"},
      {{"scene.tissue.model=TISSUE_ELASTIC"}, "task.action: ACTION_ORIENTED with TISSUE_ELASTIC"},
      {{"scene.tumour_place={ position_m { x: 0 y: 0.05 z: 0.03 } normal { z: 2 } }"},
       ".normal: (0, 0, 2) of length 2, allowed 0.99 ... 1.01"},
      {{"scene.tumour_place={ position_m { x: 0 y: 0.05 z: 0.3 } normal { z: 1 } }"},
       ".position_m: coordinate z is 0.3 m, allowed 0.001 ... 0.119 m (workspace)"}};
  for (const auto& [sets, text] : bad) {
    try {
      oriented(sets);
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr(text));
    }
  }
  try {
    make_sim_setup(load_config("omentum", Strings{"task.observation=OBSERVATION_ORIENTED"}));
    ADD_FAILURE() << "a normal nobody knows";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(),
                testing::HasSubstr("task.observation: OBSERVATION_ORIENTED in a scene without"));
  }
}

}  // namespace
}  // namespace omentum
