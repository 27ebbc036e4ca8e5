// Motions out of recordings, for replay.
#include "dvrk_gateway/recording/motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <sstream>

#include "core/mcap.h"
#include "proto/foxglove.pb.h"
#include "proto/robot_recording.pb.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;

/// A recording put together by hand.
struct Mcap {
  std::ostringstream out;
  McapWriter writer{out};
  McapWriter::ChannelId commanded =
      writer.add_channel("/tool_commanded", *foxglove::PoseInFrame::descriptor());
  McapWriter::ChannelId tool = writer.add_channel("/tool", *foxglove::PoseInFrame::descriptor());
  McapWriter::ChannelId jaw = writer.add_channel("/jaw", *pb::JawSample::descriptor());

  static std::uint64_t ns(double t_s) {
    return static_cast<std::uint64_t>(std::llround(1e9 * t_s));
  }
  void add_pose(McapWriter::ChannelId channel, double t_s, const Vector3d& p,
                const std::string& frame = "W") {
    foxglove::PoseInFrame pose;
    pose.set_frame_id(frame);
    pose.mutable_pose()->mutable_position()->set_x(p.x());
    pose.mutable_pose()->mutable_position()->set_y(p.y());
    pose.mutable_pose()->mutable_position()->set_z(p.z());
    writer.write(channel, ns(t_s), 0, pose);
  }
  void add_jaw(double t_s, double commanded_rad, double measured_rad) {
    pb::JawSample sample;
    sample.set_commanded_rad(commanded_rad);
    sample.set_measured_rad(measured_rad);
    writer.write(jaw, ns(t_s), 0, sample);
  }
  std::string bytes() {
    EXPECT_TRUE(writer.finish().has_value());
    return out.str();
  }
};

TEST(Motion, OfAnMcapIsWhatWasCommandedWithTheJawHeldBetweenItsSamples) {
  Mcap file;
  file.add_pose(file.tool, 0.99, {9, 9, 9});
  file.add_pose(file.commanded, 1.00, {0.01, 0.02, 0.03});
  file.add_jaw(1.01, 0.7, 0.1);
  file.add_pose(file.commanded, 1.02, {0.01, 0.02, 0.04});
  file.add_jaw(1.03, -0.2, 0.1);
  file.add_pose(file.commanded, 1.04, {0.01, 0.02, 0.05});
  const auto motion = parse_motion("a.mcap", file.bytes());
  ASSERT_TRUE(motion) << motion.error();
  ASSERT_EQ(motion.value().size(), 3U);
  EXPECT_EQ(motion.value()[0].t_s, 1.00);
  EXPECT_EQ(motion.value()[2].p_WT, Vector3d(0.01, 0.02, 0.05));
  EXPECT_EQ(motion.value()[0].jaw_rad, 0.7) << "what is earlier than the jaw has its first value";
  EXPECT_EQ(motion.value()[1].jaw_rad, 0.7);
  EXPECT_EQ(motion.value()[2].jaw_rad, -0.2);
}

TEST(Motion, WithoutCommandsIsWhatWasMeasured) {
  Mcap file;
  file.add_jaw(0, std::nan(""), 0.3);
  file.add_pose(file.tool, 0.02, {0, 0, 0.02});  // a stream that came late
  file.add_pose(file.tool, 0.01, {0, 0, 0.01});
  const auto motion = parse_motion("a.mcap", file.bytes());
  ASSERT_TRUE(motion) << motion.error();
  EXPECT_EQ(motion.value()[0].p_WT.z(), 0.01);
  EXPECT_EQ(motion.value()[1].jaw_rad, 0.3);
}

TEST(Motion, WithoutAJawSaysSo) {
  Mcap file;
  file.add_pose(file.tool, 0, {0, 0, 0});
  file.add_pose(file.tool, 1, {0, 0, 0});
  EXPECT_TRUE(std::isnan(parse_motion("a.mcap", file.bytes()).value()[0].jaw_rad));
}

TEST(Motion, OfAnMcapThatCannotBeMeantIsRefusedInOneLine) {
  const auto refusal = [](Mcap& file) {
    const auto motion = parse_motion("a.mcap", file.bytes());
    return motion ? "taken" : motion.error();
  };
  Mcap empty, one, other_frame, not_finite, twice;
  EXPECT_THAT(refusal(empty), HasSubstr("a.mcap: neither /tool_commanded nor /tool"));
  one.add_pose(one.tool, 0, {0, 0, 0});
  EXPECT_THAT(refusal(one), HasSubstr("1 places of the tip, needed 2"));
  other_frame.add_pose(other_frame.tool, 0.5, {0, 0, 0}, "R");
  EXPECT_THAT(refusal(other_frame), HasSubstr("/tool at 0.5 s: its frame_id is not W"));
  not_finite.add_pose(not_finite.tool, 0, {0, std::nan(""), 0});
  EXPECT_THAT(refusal(not_finite), HasSubstr("not finite"));
  twice.add_pose(twice.tool, 1, {0, 0, 0});
  twice.add_pose(twice.tool, 1, {0, 0, 1});
  EXPECT_THAT(refusal(twice), HasSubstr("two poses of one time"));
}

TEST(Motion, OfAFileCutAnywhereIsAMotionOrOneLine) {
  Mcap file;
  for (int k = 0; k < 4; ++k) {
    file.add_pose(file.commanded, 0.02 * k, {0, 0, 0.001 * k});
    file.writer.flush();
  }
  const std::string bytes = file.bytes();
  std::size_t longest = 0;
  for (std::size_t size = 0; size <= bytes.size(); ++size) {
    const auto motion = parse_motion("a.mcap", bytes.substr(0, size));
    if (motion) {
      longest = motion.value().size();
    } else {
      EXPECT_EQ(motion.error().find('\n'), std::string::npos);
    }
  }
  EXPECT_EQ(longest, 4U);
}

class MotionOfATable : public testing::Test {
 protected:
  void write(const std::string& name, const std::string& text) {
    std::ofstream(folder_ / name) << text;
  }
  std::string refusal(const std::string& path) {
    const auto motion = load_motion(path);
    return motion ? "taken" : motion.error();
  }
  test::TempDir folder_;
};

TEST_F(MotionOfATable, HasItsUnitsByTheNamesAndItsFrameByTheRecording) {
  write("tool.csv",
        "t_ms,tip_commanded_x_mm,tip_commanded_y_mm,tip_commanded_z_mm,jaw_commanded_deg\n"
        "0,10,0,0,0\n20,20,0,0,90\n");
  write("recording.txtpb",
        "frame: \"board\" transform { file: \"tool.csv\" p_m: [0, 0, 0.1] "
        "q_wxyz: [0.70710678118654757, 0, 0, 0.70710678118654757] }");
  for (const std::string& path : {folder_.path(), folder_ / "tool.csv"}) {
    const auto motion = load_motion(path);
    ASSERT_TRUE(motion) << motion.error();
    ASSERT_EQ(motion.value().size(), 2U);
    EXPECT_DOUBLE_EQ(motion.value()[1].t_s, 0.02);
    EXPECT_LT((motion.value()[1].p_WT - Vector3d(0, 0.02, 0.1)).norm(), 1e-15);
    EXPECT_DOUBLE_EQ(motion.value()[1].jaw_rad, M_PI / 2);
  }
}

TEST_F(MotionOfATable, FallsBackToWhatWasMeasured) {
  write("tool.csv", "t_s,tip_measured_x_m,tip_measured_y_m,tip_measured_z_m\n0,1,2,3\n1,1,2,4\n");
  const auto motion = load_motion(folder_.path());
  ASSERT_TRUE(motion) << motion.error();
  EXPECT_EQ(motion.value()[1].p_WT.z(), 4);
  EXPECT_TRUE(std::isnan(motion.value()[1].jaw_rad));
}

TEST_F(MotionOfATable, ARowThatIsALittleBackInTimeIsLeftOutAndCounted) {
  std::string text = "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m\n";
  for (int k = 0; k < 200; ++k) text += fmt::format("{:.7f},{},0,0\n", 0.02 * k, k);
  write("tool.csv", text + "3.9799997,200,0,0\n4,201,0,0\n");
  testing::internal::CaptureStderr();
  const auto motion = load_motion(folder_.path());
  const std::string said = testing::internal::GetCapturedStderr();
  ASSERT_TRUE(motion) << motion.error();
  ASSERT_EQ(motion.value().size(), 201U);
  EXPECT_EQ(motion.value().back().p_WT.x(), 201);
  EXPECT_THAT(said, HasSubstr("tool.csv:202:1\" 1 of 202 rows"));
  write("tool.csv", text + "3.97999,200,0,0\n");
  EXPECT_THAT(refusal(folder_.path()), HasSubstr("tool.csv:202:1: t_s 3.97999 after 3.98"));
  write("tool.csv", text + "3.98,0,0,0\n3.98,0,0,0\n3.98,0,0,0\n");
  EXPECT_THAT(refusal(folder_.path()), HasSubstr("tool.csv:204:1"));
}

TEST_F(MotionOfATable, WhatIsWrongIsOneLineWithItsPlace) {
  EXPECT_THAT(refusal(folder_.path()), HasSubstr("tool.csv: cannot be opened"));
  write("tool.csv", "t_s,tip_commanded_x_m,tip_commanded_y_m\n0,0,0\n1,0,0\n");
  EXPECT_THAT(refusal(folder_.path()), HasSubstr("tip_commanded_z_m is missing"));
  write("tool.csv",
        "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m\n0,0,0,0\n0,0,0,0\n");
  EXPECT_THAT(refusal(folder_.path()), HasSubstr("tool.csv:3:1: t_s 0 after 0"));
  write("tool.csv", "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m\n0,0,0,0\n");
  EXPECT_THAT(refusal(folder_.path()), HasSubstr("1 places of the tip"));
  write("recording.txtpb", "tip_point: control_point");
  EXPECT_THAT(refusal(folder_.path()), HasSubstr("needed jaw_tip"));
}

}  // namespace
}  // namespace omentum
