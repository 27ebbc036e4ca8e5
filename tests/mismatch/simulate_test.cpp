// Simulation of recorded commands and the folder it writes.

#include "sim_worker/playback/simulate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "core/check.h"
#include "core/config.h"
#include "core/recording_info.h"
#include "core/table.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/simulate/simulated_recording.h"
#include "mismatch/simulate/tool_track.h"
#include "sim_worker/models.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
namespace fs = std::filesystem;

std::shared_ptr<const TissueModel> model_of(Scene& scene,
                                            const std::vector<std::string>& overrides = {}) {
  scene = make_scene(load_scene(deploy_dir() + "/scenes/omentum.txtpb", overrides), deploy_dir());
  std::vector<std::string> warnings;
  return make_tissue_model(scene, 0.02, warnings);
}

Arm nominal_arm(const Scene& scene) { return {scene.config.arm(), scene_tool_mount(scene), 0.02}; }

/// Grasps the flat sheet at a particle and lifts it 30 mm in 0.6 s, twice the speed cap of the task
/// and beyond nothing.
ToolTrack lift_track(const Vector3d& grip) {
  ToolTrack track;
  track.time = {0, 0.1, 0.7, 1};
  const Vector3d up = grip + Vector3d(0, 0, 0.03);
  track.p_WT = {grip, grip, up, up};
  track.jaw_rad = {0.4, 0, 0, 0};
  return track;
}

TEST(ToolTrack, TipIsLinearBetweenRowsAndJawIsAStep) {
  const ToolTrack track = lift_track(Vector3d::Zero());
  EXPECT_NEAR(track.tip_at(0.4).z(), 0.015, 1e-12);
  EXPECT_EQ(track.tip_at(-1).z(), 0);
  EXPECT_EQ(track.tip_at(9).z(), 0.03);
  EXPECT_EQ(track.jaw_at(0.09), 0.4);
  EXPECT_EQ(track.jaw_at(0.1), 0);
}

TEST(Simulate, HeldTissueFollowsTheCommandedTipWithoutAnySpeedCap) {
  Scene scene;
  const auto model = model_of(scene);
  const int particle = 15 * 31 + 28;
  const Vector3d grip = scene.tissue.X_WB * scene.tissue.particles[particle];
  ToolTrack track = lift_track(grip);
  track.jaw_rad = {0, 0, 0, 0};  // closed from the start: the sheet has no time to fall
  const SimulatedRecording r = simulate_recording(*model, nominal_arm(scene), track, {});
  ASSERT_EQ(r.time.size(), 51U);
  EXPECT_EQ(r.missed_grasps, 0);
  EXPECT_NEAR(r.time.back(), 1.0, 1e-12);
  // The patch keeps its place at the tip.
  const Vector3d offset = r.points[10][particle] - r.tip[10];
  EXPECT_NEAR((r.points[35][particle] - r.tip[35] - offset).norm(), 0, 1e-9);
  EXPECT_NEAR((r.tip[35] - grip).z(), 0.03, 1e-9);
  EXPECT_GT(r.force.back().norm(), 0.01);
  EXPECT_LT(r.force.back().z(), 0) << "the tissue pulls the tool down";
}

class FromRest : public testing::TestWithParam<const char*> {};

TEST_P(FromRest, TissueDoesNotMoveInTheFirstSecond) {
  Scene scene;
  const auto model = model_of(scene, {"scene.tissue.model=" + std::string(GetParam())});
  ToolTrack track = lift_track(Vector3d(0, 0, 0.1));
  track.jaw_rad = {0.4, 0.4, 0.4, 0.4};
  RecordingStart start;
  start.from_rest = true;
  const SimulatedRecording r = simulate_recording(*model, nominal_arm(scene), track, {}, start);
  EXPECT_LE(r.start_speed, 1e-4);
  double hangs = 0;
  for (std::size_t i = 0; i < r.points.front().size(); ++i) {
    const Vector3d& rest = r.points.front()[i];
    EXPECT_LT((r.points.back()[i] - rest).norm(), 1e-5) << i;
    if (i < scene.tissue.particles.size())
      hangs = std::max(hangs, (rest - scene.tissue.X_WB * scene.tissue.particles[i]).norm());
  }
  EXPECT_GT(hangs, 1e-4) << "rest is not the shape of the scene";
}

INSTANTIATE_TEST_SUITE_P(Models, FromRest, testing::Values("TISSUE_CLUSTER", "TISSUE_ELASTIC"));

TEST(Simulate, AJawThatClosesOnNothingIsCounted) {
  Scene scene;
  const auto model = model_of(scene);
  const SimulatedRecording r =
      simulate_recording(*model, nominal_arm(scene), lift_track(Vector3d(0, 0, 0.2)), {});
  EXPECT_EQ(r.missed_grasps, 1);
  EXPECT_EQ(r.force.back().norm(), 0);
}

TEST(Simulate, ALongerToolThanBelievedHoldsTheTissueLowerThanTheEncodersSay) {
  Scene scene;
  const auto model = model_of(scene);
  // A place of the sheet that the arm reaches: beside q of preset omentum.
  const Vector3d grip(0.0154, 0.0521, 0.0236);
  pb::ArmEffects effects;
  effects.set_tool_length_offset_m(0.004);
  const Arm arm(effects, scene_tool_mount(scene), 0.02);
  const SimulatedRecording r = simulate_recording(*model, arm, lift_track(grip), {});
  ASSERT_EQ(r.arm.size(), r.time.size());
  for (std::size_t i = 0; i < r.time.size(); ++i)
    EXPECT_NEAR(r.measured_tip[i].z() - r.tip[i].z(), 0.004, 1e-9) << i;
}

TEST(Simulate, TheWrittenFolderIsARecordingWithTheSameCommands) {
  Scene scene;
  const auto model = model_of(scene);
  const Vector3d grip = scene.tissue.X_WB * scene.tissue.particles[15 * 31 + 28];
  const ToolTrack track = lift_track(grip);
  const SimulatedRecording r = simulate_recording(*model, nominal_arm(scene), track, {});
  const test::TempDir place;
  const std::string folder = place / "recording";
  pb::RecordingInfo info;
  info.set_name("lift");
  const CloudOf cloud = [](std::size_t step) {
    return std::vector<Eigen::Vector3f>(step + 1, Eigen::Vector3f(1, 2, 3));
  };
  write_recording_folder(make_recording(info, track, r, cloud, 25), folder);
  std::vector<std::string> warnings;
  const ToolTrack again = tool_track_of(read_recording_folder(folder), folder, {}, warnings);
  EXPECT_THAT(warnings, testing::IsEmpty());
  ASSERT_EQ(again.time.size(), r.time.size());
  for (std::size_t i = 0; i < r.time.size(); ++i) {
    EXPECT_NEAR((again.p_WT[i] - r.tip[i]).norm(), 0, 1e-9) << i;
    EXPECT_NEAR(again.jaw_rad[i], track.jaw_at(r.time[i]), 1e-9) << i;
  }
  const Table markers = read_table(folder + "/markers.csv");
  EXPECT_EQ(markers.names.size(), 1 + 3 * 961U);
  EXPECT_NEAR(markers.column("marker7_y_m").back(), r.points.back()[7].y(), 1e-9);
  EXPECT_NEAR(read_table(folder + "/force.csv").column("fz_N").back(), r.force.back().z(), 1e-9);
  // The header, then 12 bytes per point.
  std::ifstream ply(folder + "/clouds/000025.ply", std::ios::binary);
  std::stringstream content;
  content << ply.rdbuf();
  const std::size_t header = content.str().find("end_header\n") + 11;
  EXPECT_EQ(content.str().size(), header + 12 * 26);
  EXPECT_THROW(OutputFolder again_there(folder), Error) << "not empty";
}

TEST(Simulate, CameraThatLagsSeesTheStateBetweenSteps) {
  SimulatedRecording r;
  r.time = {0, 0.02, 0.04};
  for (const float x : {0.0F, 2.0F, 3.0F}) {
    r.surface.push_back({x, -x});
    r.tip.emplace_back(x, 0, 0);
  }
  EXPECT_EQ(seen_at(r, 0.02).surface, r.surface[1]);
  EXPECT_NEAR(seen_at(r, 0.025).surface[0], 2.25F, 1e-6);
  EXPECT_NEAR(seen_at(r, 0.005).tip.x(), 0.5, 1e-12);
  EXPECT_EQ(seen_at(r, -0.1).surface, r.surface[0]) << "before the recording: its start";
  EXPECT_EQ(seen_at(r, 9).surface, r.surface[2]);
}

TEST(Simulate, ClocksShiftTheTimeStampsOfTheirStreamOnly) {
  Scene scene;
  const auto model = model_of(scene);
  const ToolTrack track = lift_track(Vector3d(0, 0, 0.2));
  SimulatedRecording r = simulate_recording(*model, nominal_arm(scene), track, {});
  r.clocks.set_force_s(0.013);
  const test::TempDir place;
  const std::string folder = place / "recording";
  write_recording_folder(make_recording({}, track, r, {}, 0), folder);
  EXPECT_NEAR(read_table(folder + "/force.csv").column("t_s")[3], r.time[3] + 0.013, 1e-9);
  EXPECT_NEAR(read_table(folder + "/markers.csv").column("t_s")[3], r.time[3], 1e-9);
}

TEST(RecordingInfo, UnknownFieldsAreNamedWithTheirPlace) {
  const std::string folder = testing::TempDir() + "omentum_unknown_field";
  fs::create_directories(folder);
  std::ofstream(folder + "/recording.txtpb") << "name: \"a\"\ncolour: 3\n";
  try {
    read_recording_info(folder);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("recording.txtpb:2:"));
    EXPECT_THAT(error.what(), testing::HasSubstr("colour"));
  }
}

TEST(SceneFile, WhatIsWrongWithTheWholeSceneHasThePlaceOfItsKnob) {
  const test::TempDir folder;
  const std::string path = folder / "scene.txtpb";
  std::ofstream(path) << "tissue {\n  grid {}\n  anchor_max_y_m: -1\n}\n"
                         "rigid_body { name: \"a\" }\nrigid_body {\n  name: \"b\"\n}\n";
  const auto place = [&](const std::string& error) { return place_in_scene(path, error); };
  EXPECT_EQ(place("scene.tissue.anchor_max_y_m: -1 fixes 0"), path + ":3:3: ");
  // What the file leaves at its default has the place of what surrounds it.
  EXPECT_EQ(place("scene.tissue.thickness_m: 0"), path + ":1:1: ");
  EXPECT_EQ(place("scene.rigid_body[1].mesh.path: empty"), path + ":6:1: ");
  EXPECT_EQ(place("scene.rigid_body[1].name: b"), path + ":7:3: ");
  EXPECT_EQ(place("scene.rigid_body[7].name: b"), "");
  EXPECT_EQ(place("organ.stl: cannot be opened"), "");
  EXPECT_EQ(place_in_scene(folder / "none.txtpb", "scene.tissue: x"), "");
  try {
    make_scene(load_scene(path, {}), folder.path());
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(place(error.what()), path + ":3:3: ") << error.what();
  }
}

}  // namespace
}  // namespace omentum
