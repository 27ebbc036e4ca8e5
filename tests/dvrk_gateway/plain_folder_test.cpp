// The plain folder of a recording, as mismatch reads it; and the options that record.
#include "dvrk_gateway/recording/plain_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "core/read_file.h"
#include "core/recording_info.h"
#include "core/table.h"
#include "dvrk_gateway/recording/gateway_recording.h"
#include "dvrk_gateway/recording/motion.h"
#include "dvrk_gateway/recording/robot_recorder.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/simulate/tool_track.h"
#include "tests/dvrk_gateway/recorded_session.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using testing::HasSubstr;

class PlainFolder : public testing::Test {
 protected:
  /// Of two seconds; a sensor measures beside it.
  void record(bool forces) {
    RobotRecorderOptions options;
    options.path = folder_ / "a.mcap";
    options.setup = test::recording_setup(session_.mount);
    options.setup.info.set_tool_rate_hz(50);
    options.setup.info.set_scene_text("name: \"believed\"\n");
    options.min_free_bytes = 0;
    RobotRecorder recorder(options);
    periods_ = session_.take(100);
    for (const Period& period : periods_) {
      recorder.on_period(period);
      const auto force = std::make_shared<pb::ForceSample>();
      force->set_fx_n(0.5);
      if (forces) recorder.add_sample("/force", force, period.began_ns);
    }
    ASSERT_TRUE(recorder.finish().has_value());
  }
  test::TempDir folder_;
  test::RecordedSession session_;
  std::vector<Period> periods_;
};

TEST_F(PlainFolder, IsReadByTheImporterAsItWasRecorded) {
  record(true);
  const std::string plain = folder_ / "plain";
  write_plain_folder(folder_ / "a.mcap", plain);
  const pb::RecordingInfo info = read_recording_info(plain);
  EXPECT_EQ(info.scene(), "scene.txtpb");
  EXPECT_EQ(read_file(plain + "/scene.txtpb").value(), "name: \"believed\"\n");
  std::vector<std::string> warnings;
  const ToolTrack track =
      tool_track_of(read_recording_folder(plain), plain, session_.mount, warnings);
  EXPECT_THAT(warnings, testing::IsEmpty());
  ASSERT_EQ(track.time.size(), periods_.size());
  // The goal in force when the robot measured is that of the period before.
  for (std::size_t k = 1; k < periods_.size(); ++k) {
    const RobotCommand& goal = session_.goals[k - 1];
    EXPECT_LT((track.p_WT[k] - session_.tip(goal.rotation, goal.translation)).norm(), 1e-12);
    EXPECT_NEAR(track.jaw_rad[k], goal.jaw, 1e-12);
    EXPECT_NEAR(track.time[k], 1e-9 * static_cast<double>(periods_[k].began_ns), 1e-9);
  }
  const CartesianPose& setpoint = periods_[0].robot.setpoint_cp.payload;
  EXPECT_LT((track.p_WT[0] - session_.tip(setpoint.rotation, setpoint.translation)).norm(), 1e-12)
      << "before the first goal the robot keeps its set-point";
}

TEST_F(PlainFolder, HasJointsAndForcesWithTheirUnits) {
  record(true);
  const std::string plain = folder_ / "plain";
  write_plain_folder(folder_ / "a.mcap", plain);
  const Table joints = read_table(plain + "/joints.csv");
  ASSERT_EQ(joints.rows(), periods_.size());
  const JointState& said = periods_.back().robot.measured_js.payload;
  EXPECT_NEAR(joints.column("q3_measured_m").back(), said.position[2], 1e-12);
  EXPECT_NEAR(joints.column("dq1_measured_rad_per_s").back(), said.velocity[0], 1e-12);
  EXPECT_NEAR(joints.column("effort3_N").back(), said.effort[2], 1e-12);
  EXPECT_EQ(read_table(plain + "/force.csv").column("fx_N").front(), 0.5);
}

TEST_F(PlainFolder, IsTheSameMotionAsTheFile) {
  record(false);
  write_plain_folder(folder_ / "a.mcap", folder_ / "plain");
  const auto motion = load_motion(folder_ / "plain");
  ASSERT_TRUE(motion) << motion.error();
  EXPECT_EQ(motion.value().size(), periods_.size());
  EXPECT_FALSE(std::filesystem::exists(folder_ / "plain/force.csv"));
}

TEST_F(PlainFolder, OfAKilledSessionHasWhatIsThere) {
  record(false);
  const std::string bytes = read_file(folder_ / "a.mcap").value();
  std::ofstream(folder_ / "cut.mcap", std::ios::binary) << bytes.substr(0, bytes.size() / 2);
  write_plain_folder(folder_ / "cut.mcap", folder_ / "plain");
  const std::size_t rows = read_table(folder_ / "plain/tool.csv").rows();
  EXPECT_GE(rows, 30U);
  EXPECT_LT(rows, 100U);
}

TEST_F(PlainFolder, WhatCannotBeWrittenIsOneLineAndLeavesNothing) {
  const auto refusal = [&](const std::string& file) -> std::string {
    try {
      write_plain_folder(file, folder_ / "plain");
      return "taken";
    } catch (const Error& error) {
      return error.what();
    }
  };
  EXPECT_THAT(refusal(folder_ / "absent.mcap"), HasSubstr("absent.mcap: cannot be opened"));
  std::ofstream(folder_ / "none.mcap") << "no recording";
  EXPECT_THAT(refusal(folder_ / "none.mcap"), HasSubstr("no /recording in it"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "plain"));
  std::filesystem::create_directory(folder_ / "plain");
  std::ofstream(folder_ / "plain/precious") << "x";
  EXPECT_THAT(refusal(folder_ / "none.mcap"), HasSubstr("not empty"));
}

TEST(RecordingPath, IsTheFileGivenOrOneNamedByTimeAndMode) {
  EXPECT_EQ(recording_path("here/a.mcap", "twin", 0), "here/a.mcap");
  EXPECT_EQ(recording_path("recordings", "twin", 1'000'000'000),
            "recordings/1970-01-01T00-00-01Z-twin.mcap");
}

}  // namespace
}  // namespace omentum
