// What is drawn per episode: of the tissue, of the arm, and for the evaluation.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "core/config.h"
#include "core/hash.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

std::shared_ptr<const SimSetup> drawn_setup(const std::string& preset,
                                            const std::vector<std::string>& overrides = {}) {
  return make_sim_setup(load_config(preset, overrides), deploy_dir() + "/scenes");
}

std::string drawn(const std::string& parameter, double min, double max) {
  return fmt::format("randomise={{ parameter: \"{}\" min: {} max: {} }}", parameter, min, max);
}

EpisodeStart training_start(std::uint32_t slot, std::uint64_t episode) {
  EpisodeStart start;
  start.run_seed = 9;
  start.slot = slot;
  start.episode = episode;
  return start;
}

EpisodeStart drawn_start(StartSet set, std::uint32_t index) {
  EpisodeStart start;
  start.run_seed = 9;
  start.start_set = set;
  start.start_index = index;
  return start;
}

/// One step of every lane with branch indices x, y, z, gripper.
void step_all(SimBackend& backend, std::array<std::uint8_t, 4> branch) {
  std::vector<Action> actions(static_cast<std::size_t>(backend.lanes()));
  std::vector<StepOutcome> outcomes(actions.size());
  for (Action& a : actions) std::ranges::copy(branch, a.branch.begin());
  backend.step(actions, outcomes);
}

/// Down, to one side, and up again.
void move_about(SimBackend& backend) {
  for (int i = 0; i < 6; ++i) step_all(backend, {2, 1, 0, 0});
  for (int i = 0; i < 4; ++i) step_all(backend, {1, 0, 2, 1});
}

Vector3d tip_at(const SimBackend& backend, int lane = 0) {
  const EpisodeFacts f = backend.clock(lane);
  return {f.tool_position[0], f.tool_position[1], f.tool_position[2]};
}

TEST(Randomise, DrawsAreReproducibleAndWithinRange) {
  const auto setup = drawn_setup(
      "omentum", {"randomise={ parameter: \"tissue.offset_x_m\" min: -0.002 max: 0.002 }",
                  "randomise={ parameter: \"tissue.stiffness_scale\" min: 0.5 max: 1.5 }"});
  SimBackend a(setup, 1, 1);
  SimBackend b(setup, 8, 8);
  double low = 1;
  double high = -1;
  for (std::uint64_t episode = 0; episode < 50; ++episode) {
    EpisodeStart start;
    start.run_seed = 9;
    start.slot = 3;
    start.episode = episode;
    a.reset(0, start);
    b.reset(5, start);
    ASSERT_EQ(fnv1a64(a.save(0)), fnv1a64(b.save(5)));
    const double x = a.tissue_of(0).position(0, 0).x() -
                     (setup->scene.tissue.X_WB * setup->scene.tissue.particles[0]).x();
    low = std::min(low, x);
    high = std::max(high, x);
  }
  EXPECT_GE(low, -0.00201);
  EXPECT_LE(high, 0.00201);
  EXPECT_GT(high - low, 0.003);
  EXPECT_THROW(drawn_setup("omentum", {"randomise={ parameter: \"tissue.colour\" min: 0 max: 1 }"}),
               Error);
}

TEST(Randomise, EffectsAreDrawnPerSlotAndEpisodeReproducibly) {
  const auto setup = drawn_setup(
      "omentum", {"scene.tissue.model=TISSUE_ELASTIC", "scene.tool.contact=false",
                  "randomise={ parameter: \"tissue.effects.gravity_tilt_x_deg\" min: -3 max: 3 }",
                  "randomise={ parameter: \"tissue.effects.strain_stiffening\" min: 0 max: 0.5 }"});
  SimBackend a(setup, 1, 1);
  SimBackend b(setup, 8, 8);
  std::vector<std::uint64_t> hashes;
  for (std::uint64_t episode = 0; episode < 3; ++episode) {
    EpisodeStart start;
    start.run_seed = 9;
    start.slot = 3;
    start.episode = episode;
    a.reset(0, start);
    b.reset(5, start);
    step_all(a, {1, 1, 1, 0});
    step_all(b, {1, 1, 1, 0});
    ASSERT_EQ(fnv1a64(a.save(0)), fnv1a64(b.save(5))) << episode;
    hashes.push_back(fnv1a64(a.save(0)));
  }
  EXPECT_NE(hashes[0], hashes[1]);
  EXPECT_NE(hashes[1], hashes[2]);
}

TEST(Randomise, ThicknessAndAdhesionAreDrawnPerSlotAndEpisodeAndKeptInTheState) {
  const auto setup =
      drawn_setup("omentum", {drawn("tissue.thickness_scale", 0.5, 1.4),
                              drawn("tissue.effects.adhesion.stiffness_pa_per_m", 1e4, 1e5)});
  SimBackend a(setup, 1, 1);
  SimBackend b(setup, 8, 8);
  std::vector<double> thicknesses;
  for (std::uint64_t episode = 0; episode < 3; ++episode) {
    a.reset(0, training_start(3, episode));
    b.reset(5, training_start(3, episode));
    for (int k = 0; k < 3; ++k) move_about(a);
    for (int k = 0; k < 3; ++k) move_about(b);
    ASSERT_EQ(fnv1a64(a.save(0)), fnv1a64(b.save(5))) << episode;
    ASSERT_TRUE(b.load(2, a.save(0)).has_value());
    move_about(a);
    move_about(b);
    ASSERT_EQ(fnv1a64(a.save(0)), fnv1a64(b.save(2))) << episode;
    thicknesses.push_back(a.tissue_of(0).thickness_scale(0));
    EXPECT_GE(thicknesses.back(), 0.5);
    EXPECT_LE(thicknesses.back(), 1.4);
  }
  EXPECT_NE(thicknesses[0], thicknesses[1]);
  EXPECT_NE(thicknesses[1], thicknesses[2]);
}

const std::vector<std::string> kDrawnArm = {drawn("arm.transport_delay_s", 0.02, 0.08),
                                            drawn("arm.joint_offset.yaw", -0.01, 0.01),
                                            drawn("arm.droop_s", 0, 0.045)};

TEST(Randomise, TheArmIsDrawnPerSlotAndEpisodeReproducibly) {
  const auto setup = drawn_setup("omentum", kDrawnArm);
  SimBackend a(setup, 1, 1);
  SimBackend b(setup, 8, 8);
  std::vector<std::uint64_t> hashes;
  for (std::uint64_t episode = 0; episode < 3; ++episode) {
    a.reset(0, training_start(3, episode));
    b.reset(5, training_start(3, episode));
    b.reset(2, training_start(4, episode));
    move_about(a);
    move_about(b);
    ASSERT_EQ(fnv1a64(a.save(0)), fnv1a64(b.save(5))) << episode;
    EXPECT_NE(tip_at(b, 5), tip_at(b, 2)) << episode;
    hashes.push_back(fnv1a64(a.save(0)));
  }
  EXPECT_NE(hashes[0], hashes[1]);
  EXPECT_NE(hashes[1], hashes[2]);
}

TEST(Randomise, AnArmDrawnFromOneValueIsThatArmOfTheScene) {
  SimBackend stated(
      drawn_setup("omentum", {"scene.arm.transport_delay_s=0.05",
                              "scene.arm.tip_backlash={ x: 0.0004 y: 0.0004 z: 0.0004 }",
                              "scene.arm.joint_offset.pitch=0.004"}),
      1, 1);
  SimBackend one_value(drawn_setup("omentum", {drawn("arm.transport_delay_s", 0.05, 0.05),
                                               drawn("arm.tip_backlash", 0.0004, 0.0004),
                                               drawn("arm.joint_offset.pitch", 0.004, 0.004)}),
                       1, 1);
  for (SimBackend* backend : {&stated, &one_value}) {
    backend->reset(0, training_start(1, 2));
    move_about(*backend);
  }
  EXPECT_EQ(fnv1a64(stated.save(0)), fnv1a64(one_value.save(0)));
}

TEST(Randomise, ALoadedStateGoesOnWithTheArmThatItWasDrawnWith) {
  const auto setup = drawn_setup("omentum", kDrawnArm);
  SimBackend first(setup, 1, 1);
  SimBackend second(setup, 1, 1);
  first.reset(0, training_start(3, 7));
  second.reset(0, training_start(5, 1));
  move_about(first);
  const Bytes state = first.save(0);
  ASSERT_TRUE(second.load(0, state).has_value());
  move_about(first);
  move_about(second);
  EXPECT_EQ(fnv1a64(first.save(0)), fnv1a64(second.save(0)));
}

TEST(Randomise, TheEvaluationDrawsWhatTrainingNeverDid) {
  const std::vector<std::string> knobs = {drawn("tissue.stiffness_scale", 0.5, 1.5)};
  const auto config = load_config("omentum", knobs);
  const auto setup = make_sim_setup(config, deploy_dir() + "/scenes");
  const auto stiffness = [&](const EpisodeStart& start) {
    return draw_randomised(config, setup->scene, draw_key(start, 100).value())
        .parameters.stiffness_scale;
  };
  std::vector<double> evaluated;
  for (std::uint32_t index = 0; index < 100; ++index) {
    const EpisodeStart start = drawn_start(StartSet::kGridDrawn, index);
    evaluated.push_back(stiffness(start));
    EXPECT_EQ(stiffness(start), evaluated.back());
    EXPECT_NE(stiffness(training_start(index, 0)), evaluated.back());
  }
  std::ranges::sort(evaluated);
  EXPECT_LT(evaluated.front(), 0.55);
  EXPECT_GT(evaluated.back(), 1.45);
  EXPECT_EQ(std::ranges::adjacent_find(evaluated), evaluated.end());
  EXPECT_FALSE(draw_key(drawn_start(StartSet::kGrid, 3), 100).has_value());
}

TEST(Randomise, AParameterDrawnAloneHasTheValueThatItHasAmongAll) {
  const std::vector<std::string> knobs = {drawn("tissue.stiffness_scale", 0.5, 1.5),
                                          drawn("tissue.gravity_scale", 0.8, 1.2)};
  const auto config = load_config("omentum", knobs);
  const auto setup = make_sim_setup(config, deploy_dir() + "/scenes");
  const auto draw = [&](std::uint32_t index) {
    const auto key = draw_key(drawn_start(StartSet::kGridDrawn, index), 100);
    return draw_randomised(config, setup->scene, key.value()).parameters;
  };
  const LaneParameters all = draw(37), stiffness = draw(137), gravity = draw(237);
  EXPECT_EQ(stiffness.stiffness_scale, all.stiffness_scale);
  EXPECT_EQ(stiffness.gravity_scale, 1);
  EXPECT_EQ(gravity.stiffness_scale, 1);
  EXPECT_EQ(gravity.gravity_scale, all.gravity_scale);
  EXPECT_NE(all.stiffness_scale, 1);
  EXPECT_NE(all.gravity_scale, 1);
}

TEST(Randomise, DrawnStartsAreThoseOfTheGrid) {
  const auto setup = drawn_setup("omentum", {drawn("tissue.offset_x_m", 0.001, 0.002)});
  SimBackend plain(setup, 1, 1);
  SimBackend other(setup, 1, 1);
  for (const std::uint32_t index : {0U, 37U, 99U}) {
    plain.reset(0, drawn_start(StartSet::kGrid, index));
    other.reset(0, drawn_start(StartSet::kGridDrawn, index + 100 * (index % 2)));
    EXPECT_EQ(tip_at(plain), tip_at(other));
    EXPECT_GE((other.tissue_of(0).position(0, 5) - plain.tissue_of(0).position(0, 5)).x(), 0.00099);
  }
}

TEST(BadInput, AnArmThatCannotBeDrawnIsRefusedInOneLine) {
  const auto message = [](const std::string& parameter, double min, double max) -> std::string {
    try {
      drawn_setup("omentum", {drawn(parameter, min, max)});
    } catch (const Error& error) {
      return error.what();
    }
    return "accepted";
  };
  using testing::AllOf;
  using testing::HasSubstr;
  EXPECT_THAT(message("arm.wobble", 0, 1),
              AllOf(HasSubstr("randomise arm.wobble: 0 ... 1"), HasSubstr("transport_delay_s")));
  EXPECT_THAT(message("arm.droop_s.elbow", 0, 1), HasSubstr("wrist_pitch"));
  EXPECT_THAT(message("arm.transport_delay_s.yaw", 0, 0.1), HasSubstr("no effect of that name"));
  EXPECT_THAT(message("arm.transport_delay_s", 0, 0.4), HasSubstr("allowed 0 ... 0.25"));
  EXPECT_THAT(message("arm.droop_s", -0.1, 0.1), HasSubstr("allowed 0 or more"));
  EXPECT_THAT(message("arm.droop_s", 0.1, 0), HasSubstr("min <= max"));
  EXPECT_EQ(message("arm.droop_s", 0, 0.1), "accepted");
}

TEST(BadInput, AStiffnessOfNothingIsRefusedInOneLine) {
  try {
    drawn_setup("omentum", {drawn("tissue.stiffness_scale", 0, 1)});
    ADD_FAILURE() << "accepted";
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(),
                 "randomise tissue.stiffness_scale: 0 ... 1, allowed within 0.001 ... 10");
  }
}

TEST(BadInput, AThicknessOrAdhesionThatCannotBeDrawnIsRefusedInOneLine) {
  const auto message = [](const std::string& preset, const std::string& parameter, double min,
                          double max) -> std::string {
    try {
      drawn_setup(preset, {drawn(parameter, min, max)});
    } catch (const Error& error) {
      return error.what();
    }
    return "accepted";
  };
  using testing::AllOf;
  using testing::HasSubstr;
  EXPECT_THAT(message("omentum", "tissue.thickness_scale", 0.5, 2),
              AllOf(HasSubstr("randomise tissue.thickness_scale: 0.5 ... 2"),
                    HasSubstr("the jaw opens by 24 deg and needs")));
  EXPECT_THAT(message("omentum", "tissue.thickness_scale", 0.1, 1),
              HasSubstr("allowed within 0.2 ... 5"));
  EXPECT_THAT(message("omentum_elastic", "tissue.thickness_scale", 0.8, 1.2),
              HasSubstr("TISSUE_ELASTIC, allowed with a sheet of TISSUE_CLUSTER"));
  const std::string adhesion = "tissue.effects.adhesion.stiffness_pa_per_m";
  EXPECT_THAT(message("omentum", adhesion, -1, 1e5), HasSubstr("allowed 0 ... 1"));
  EXPECT_THAT(message("derived", adhesion, 0, 1e5),
              HasSubstr("with a volume, allowed with a sheet"));
  EXPECT_EQ(message("omentum", adhesion, 0, 1e5), "accepted");
}

}  // namespace
}  // namespace omentum
