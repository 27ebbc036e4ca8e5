// Bags of ROS become recordings: by the names of CRTK, by a map, with frames, in either version.
#include "mismatch/ros/bag.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "mismatch/bag_builder.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/recording_mcap.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using test::Bag;
using test::Definitions;
using test::kMs;
using test::kStart;
using test::robot;
using test::RosBytes;
using testing::HasSubstr;
using testing::IsEmpty;

class Bags : public testing::Test {
 protected:
  Recording read(Bag& bag, const std::string& map = "ros {}",
                 McapCompression compression = McapCompression::kNone) const {
    bag.file().save(path(), compression);
    pb::ImportMap parsed;
    parse_text_proto("map", map, parsed);
    Recording found;
    import_bags(parsed, path(), [&](const std::string&, const Recording& r) { found = r; });
    return found;
  }
  std::string refused(Bag& bag, const std::string& map = "ros {}") const {
    try {
      read(bag, map);
    } catch (const Error& error) {
      EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
      return error.what();
    }
    return "nothing refused";
  }
  std::string path() const { return folder_ / "bag.mcap"; }
  test::TempDir folder_;
};

double value(const Recording& recording, const std::string& topic, std::size_t row,
             const std::string& column) {
  const Series* series = recording.find(topic);
  if (series == nullptr || series->find(column) == series->columns.size()) return NAN;
  return series->at(row, series->find(column));
}

TEST_F(Bags, NamesOfCrtkBecomeChannels) {
  Bag bag = robot(false);
  const Recording r = read(bag);
  EXPECT_TRUE(is_bag(path()));
  ASSERT_NE(r.find("tool"), nullptr);
  EXPECT_EQ(r.find("tool")->time_ns[1], 20 * kMs) << "header.stamp, from the first one on";
  EXPECT_EQ(r.info.start_unix_ns(), static_cast<std::uint64_t>(kStart));
  EXPECT_EQ(r.info.tip_point(), pb::control_point) << "what the dVRK tells of its tip";
  EXPECT_EQ(value(r, "tool", 1, "tip_measured_x_m"), 0.001);
  EXPECT_EQ(value(r, "tool", 1, "tip_measured_qw"), std::sqrt(0.5)) << "ROS has x y z w";
  EXPECT_EQ(value(r, "tool", 1, "tip_measured_qx"), 0);
  EXPECT_EQ(value(r, "tool_setpoint", 0, "tip_setpoint_x_m"), 1e-5);
  EXPECT_EQ(value(r, "tool_commanded", 0, "tip_commanded_x_m"), 2e-5);
  EXPECT_EQ(value(r, "joints", 2, "q3_measured_m"), 0.1 + 0.001 * 2) << "the insertion is in m";
  EXPECT_EQ(value(r, "joints", 2, "q2_measured_rad"), -0.2);
  EXPECT_EQ(value(r, "joints", 2, "dq3_measured_m_per_s"), 3);
  EXPECT_EQ(value(r, "joints", 2, "effort1_Nm"), 0.5);
  // One channel of three topics: two at one time, one between.
  ASSERT_EQ(r.find("jaw")->rows(), 10);
  EXPECT_EQ(value(r, "jaw", 2, "jaw_measured_rad"), 0.299);
  EXPECT_EQ(value(r, "jaw", 2, "jaw_setpoint_rad"), 0.3);
  EXPECT_TRUE(std::isnan(value(r, "jaw", 2, "jaw_commanded_rad")));
  EXPECT_EQ(value(r, "jaw", 3, "jaw_commanded_rad"), 0.25);
  // What presses on the tool, in W: minus x of the tip is minus y of W.
  EXPECT_NEAR(value(r, "force", 0, "fy_N"), -1, 1e-15);
  EXPECT_NEAR(value(r, "force", 0, "fx_N"), 0, 1e-15);
  EXPECT_NEAR(value(r, "force", 0, "tx_Nm"), 0.1, 1e-15);
  ASSERT_EQ(r.depth.size(), 5);
  EXPECT_EQ(r.depth.time_ns[4], 80 * kMs);
  EXPECT_EQ(parse_depth_png("test", r.depth.fetch(4)).value().depth,
            (std::vector<std::uint16_t>{0, 400, 500, 504, 65535, 1}));
  EXPECT_EQ(r.info.depth_unit_m(), 1e-3);
  EXPECT_EQ(r.info.camera().fy(), 2.5);
  EXPECT_NEAR(r.info.camera().view_direction(2), -1, 1e-15);
  const Cloud seen = seen_clouds(r).fetch(0);
  ASSERT_EQ(seen.size(), 5);
  EXPECT_NEAR(seen[0].z(), 0.5 - 0.4, 1e-6) << "0.4 m below the camera";
  EXPECT_THAT(r.warnings, testing::ElementsAre(AllOf(HasSubstr("/rosout (std_msgs/String)"),
                                                     HasSubstr("5 messages left out"))));
  EXPECT_THAT(r.notes, testing::Contains(AllOf(HasSubstr("/PSM1/measured_cp"), HasSubstr("/tool"),
                                               HasSubstr("times of header.stamp"))));
}

TEST_F(Bags, BothVersionsByteOrdersAndCompressionsGiveOneRecording) {
  Bag first = robot(true);
  write_recording_mcap(read(first), folder_ / "first.mcap");
  const Recording one = read_recording_mcap(folder_ / "first.mcap");
  for (const auto form : {RosBytes::kLittle, RosBytes::kBig}) {
    for (const auto compression :
         {McapCompression::kNone, McapCompression::kLz4, McapCompression::kZstd}) {
      Bag second = robot(false, form);
      EXPECT_THAT(difference(one, read(second, "ros {}", compression)), IsEmpty());
    }
  }
}

TEST_F(Bags, ExportAndImportAgainIsTheIdentity) {
  Bag bag = robot(false);
  const Recording r = read(bag);
  write_recording_mcap(r, folder_ / "r.mcap");
  EXPECT_THAT(difference(r, read_recording_mcap(folder_ / "r.mcap")), IsEmpty());
  write_recording_folder(r, folder_ / "r");
  EXPECT_THAT(difference(r, read_recording_folder(folder_ / "r")), IsEmpty());
}

TEST_F(Bags, FramesAreTurnedIntoW) {
  Bag bag = robot(false, RosBytes::kLittle, "base");
  // A quarter about z, and up.
  const std::string frame =
      "frame { name: \"base\" transform { p_m: \"0 0 1\" rotation: \"0 0 90\" form: EULER axes: "
      "\"xyz\" degrees: true } }";
  const Recording r = read(bag, "ros { " + frame + " }");
  EXPECT_NEAR(value(r, "tool", 1, "tip_measured_x_m"), -0.02, 1e-15);
  EXPECT_NEAR(value(r, "tool", 1, "tip_measured_y_m"), 0.001, 1e-15);
  EXPECT_NEAR(value(r, "tool", 1, "tip_measured_z_m"), 1.03, 1e-15);
  EXPECT_NEAR(value(r, "tool", 1, "tip_measured_qz"), 1, 1e-15) << "a quarter and a quarter";
  EXPECT_NEAR(value(r, "force", 0, "fx_N"), 1, 1e-15);
  EXPECT_NEAR(r.info.camera().p_m(2), 1.5, 1e-15) << "through /tf_static";
  const Recording world = read(bag, "ros { world: \"base\" }");
  EXPECT_EQ(value(world, "tool", 1, "tip_measured_x_m"), 0.001);
  EXPECT_THAT(refused(bag, "ros { world: \"table\" }"), HasSubstr("no transform to W"));
  const Recording taken = read(bag);
  EXPECT_THAT(taken.warnings, testing::Contains(HasSubstr("base is taken for W")));
  EXPECT_EQ(value(taken, "tool", 1, "tip_measured_x_m"), 0.001);
  bag.transform("/tf", kStart, "base", "cam", {0, 0, 0.6}, {1, 0, 0, 0});
  EXPECT_THAT(refused(bag, "ros { " + frame + " }"), HasSubstr("moves"));
}

TEST_F(Bags, AForceAtTheBaseIsTheForceAtTheTip) {
  Bag bag(false);
  bag.pose("/PSM1/measured_cp", kStart, "W", {0.1, 0, 0});
  bag.wrench("/PSM1/spatial/measured_cf", kStart + kMs, "W", {0, 0, 2}, {0, -0.2, 0});
  bag.wrench("/PSM1/spatial/measured_cf", kStart - kMs, "W", {0, 0, 2}, {0, 0, 0});
  const Recording r = read(bag);
  ASSERT_EQ(r.find("force")->rows(), 1);
  EXPECT_EQ(value(r, "force", 0, "fz_N"), -2);
  EXPECT_NEAR(value(r, "force", 0, "ty_Nm"), 0, 1e-15) << "a force at the tip turns nothing there";
  EXPECT_THAT(r.warnings, testing::Contains(HasSubstr("1 samples at times when the tip is not")));
}

TEST_F(Bags, AMapNamesOtherTopics) {
  Bag bag(true);
  for (int k = 0; k < 3; ++k) {
    const std::int64_t t = kStart + k * 10 * kMs;
    bag.pose("/ur5/pose", t, "W", {0.1 * k, 0, 0});
    bag.joints("/ur5/states", t, {"shoulder", "lift", "elbow"}, {1, 2, 3});
    bag.joints("/slide/states", t, {}, {1, 2, 3});
    bag.wrench("/ft", t, "W", {1, 2, 3}, {0, 0, 0});
    bag.transform("/tf", t, "W", "needle", {0, 0.5 + k, 0}, {0, 0, 0, 1});
    bag.pose("/marker/a", t, "W", {1, 2, 3.0 + k});
  }
  const Recording r = read(bag, R"(
    name: "case_{file}" set: "specimen=s1"
    ros {
      topic { name: "/ur5/pose" to: "tool" log_time: true }
      topic { name: "/ur5/states" to: "joints" }
      topic { name: "/ft" to: "force" factor: -1 }
      topic { name: "/tf" to: "tracker" child: "needle" }
      topic { name: "/marker/a" to: "markers" marker: "a" }
      topic { name: "/slide/states" to: "none" }
    })");
  EXPECT_EQ(r.info.name(), "case_bag");
  EXPECT_EQ(r.info.specimen(), "s1");
  EXPECT_EQ(r.find("tool")->time_ns[0], 3 * kMs) << "of the log";
  EXPECT_EQ(value(r, "joints", 0, "q3_measured_rad"), 3) << "an elbow is no insertion";
  EXPECT_EQ(value(r, "force", 0, "fy_N"), -2);
  EXPECT_EQ(value(r, "tracker", 2, "tip_optical_y_m"), 2.5);
  EXPECT_EQ(value(r, "markers", 1, "a_z_m"), 4);
  EXPECT_THAT(r.warnings, testing::ElementsAre(HasSubstr("3 messages left out: as the map says")));
  const Recording linear = read(
      bag, "ros { topic { name: \"/slide/states\" to: \"joints_commanded\" linear: [1, 2] } }");
  EXPECT_EQ(value(linear, "joints_commanded", 0, "q2_commanded_m"), 2);
  EXPECT_EQ(value(linear, "joints_commanded", 0, "q3_commanded_rad"), 3);
  EXPECT_THAT(refused(bag, "ros { topic { name: \"/ft\" to: \"cloud\" } }"),
              HasSubstr("allowed of geometry_msgs/WrenchStamped: force"));
  EXPECT_THAT(refused(bag, "ros { topic { name: \"/f\" to: \"force\" } }"),
              HasSubstr("ros.topic /f: none, the bag has /ur5/pose"));
  EXPECT_THAT(refused(bag, "ros { topic { name: \"/tf\" to: \"tool\" } }"), HasSubstr("child"));
  EXPECT_THAT(refused(bag, "ros {} source { files: \"a\" }"), HasSubstr("one of them"));
}

TEST_F(Bags, ARecordingHasOneArm) {
  Bag bag(false);
  bag.pose("/PSM1/measured_cp", kStart, "W", {1, 0, 0});
  bag.pose("/ECM/measured_cp", kStart, "W", {2, 0, 0});
  const Recording one = read(bag);
  EXPECT_EQ(value(one, "tool", 0, "tip_measured_x_m"), 1);
  EXPECT_THAT(one.warnings, testing::ElementsAre(HasSubstr("left out: not of the arm /PSM1")));
  bag.pose("/PSM2/measured_cp", kStart, "W", {3, 0, 0});
  EXPECT_THAT(refused(bag), HasSubstr("arms /ECM, /PSM1, /PSM2: a recording has one"));
  EXPECT_EQ(value(read(bag, "ros { arm: \"/PSM2\" }"), "tool", 0, "tip_measured_x_m"), 3);
  EXPECT_THAT(refused(bag, "ros { arm: \"/PSM3\" }"), HasSubstr("the bag has /ECM, /PSM1, /PSM2"));
}

TEST_F(Bags, ATruncatedBagGivesItsReadablePrefixAndSaysSo) {
  // Without chunks every message counts; here one chunk that is whole and one that is cut.
  Bag whole = robot(false), more = robot(true);
  const std::string bytes = whole.file().bytes();
  const std::size_t tail = 9 + 4 + 9 + 20 + 8;    // end of data, footer, magic
  const std::string chunk = more.file().bytes();  // behind magic and header
  std::ofstream(path(), std::ios::binary)
      << bytes.substr(0, bytes.size() - tail) << chunk.substr(8 + 21, chunk.size() / 2);
  const Recording r = read_bag(path(), {}, {});
  EXPECT_EQ(r.find("tool")->rows(), 5);
  EXPECT_THAT(r.warnings, testing::Contains(HasSubstr("file ends inside a")));
}

TEST_F(Bags, WhatCannotBeReadIsToldByTopicAndByte) {
  Bag jpeg(false);
  jpeg.pose("/PSM1/measured_cp", kStart, "W", {1, 0, 0});
  jpeg.packed("/color/compressed", kStart, "jpeg", "\xff\xd8\xff");
  EXPECT_THAT(read(jpeg).warnings, testing::Contains(HasSubstr("JPEG, and a recording holds PNG")));
  Bag blind(false);
  blind.depth("/d", kStart, "W", {1, 2, 3, 4, 5, 6});
  EXPECT_THAT(refused(blind), HasSubstr("depth without intrinsics"));
  EXPECT_EQ(read(blind, "info { camera { fx: 1 fy: 1 width: 3 height: 2 } } ros {}").depth.size(),
            1);
  EXPECT_THAT(refused(blind, "info { camera { fx: 1 fy: 1 width: 4 height: 2 } } ros {}"),
              HasSubstr("3 x 2 pixels, the camera has 4 x 2"));
  blind.depth("/e", kStart, "W", {1, 2, 3, 4, 5, 6});
  EXPECT_THAT(refused(blind), HasSubstr("nothing of a recording"));
  Bag odd(false);
  odd.pose("/PSM1/measured_cp", kStart, "W", {1, 0, 0}, {0, 0, 0, 0});
  odd.pose("/PSM1/measured_cp", kStart + kMs, "W", {NAN, 0, 0});
  odd.pose("/PSM1/measured_cp", 0, "W", {2, 0, 0});
  const Recording r = read(odd);
  EXPECT_THAT(r.warnings, testing::Contains(HasSubstr("1 message whose orientation is no unit")));
  EXPECT_THAT(r.warnings, testing::Contains(HasSubstr("1 message without finite numbers")));
  EXPECT_THAT(r.warnings, testing::Contains(HasSubstr("1 of 3 messages without header.stamp")));
  Bag broken(false);
  broken.pose("/PSM1/measured_cp", kStart, "W", {1, 0, 0});
  const std::uint16_t idl =
      broken.file().topic("/PSM1/measured_js", "sensor_msgs/msg/JointState", "", "ros2idl");
  broken.file().message(idl, kStart, "abc");
  EXPECT_THAT(read(broken).warnings, testing::Contains(HasSubstr("needed ros1 by ros1msg or cdr")));
  broken.write("/PSM1/setpoint_cp", "geometry_msgs/msg/PoseStamped", Definitions(false).pose(), 0,
               RosBytes(RosBytes::kLittle).text("x"));
  EXPECT_THAT(read(broken).warnings,
              testing::Contains(testing::MatchesRegex(
                  ".*/PSM1/setpoint_cp .*left out: byte .*PoseStamped: ends inside.*")));
}

TEST_F(Bags, OtherContainersAreRefusedNamingTheConversion) {
  for (const std::string name : {"a.bag", "b.db3"}) {
    std::ofstream(folder_ / name) << "x";
    try {
      is_bag(folder_ / name);
      ADD_FAILURE() << name;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr("mcap convert"));
    }
  }
  EXPECT_THROW(read_recording_mcap(folder_ / "none.mcap"), Error);
  Bag bag = robot(false);
  bag.file().save(path());
  try {
    read_recording_mcap(path());
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("mismatch import"));
  }
}

}  // namespace
}  // namespace omentum
