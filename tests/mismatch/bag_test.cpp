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
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/recording_mcap.h"
#include "support/ros_bag.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using test::BagFile;
using test::RosBytes;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr std::int64_t kStart = 1'700'000'000'000'000'000, kMs = 1'000'000;

/// Definitions as they stand in bags, of either version.
class Definitions {
 public:
  explicit Definitions(bool ros1) : ros1_(ros1) {}
  std::string joints() const {
    return "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
           "float64[] effort\n" +
           header();
  }
  std::string pose() const {
    return "std_msgs/Header header\nPose pose\n" + header() + part("geometry_msgs/Pose") +
           "Point position\nQuaternion orientation\n" + vectors();
  }
  std::string wrench() const {
    return "std_msgs/Header header\nWrench wrench\n" + header() + part("geometry_msgs/Wrench") +
           "Vector3 force\nVector3 torque\n" + vectors();
  }
  std::string transforms() const {
    return "geometry_msgs/TransformStamped[] transforms\n" +
           part("geometry_msgs/TransformStamped") +
           "std_msgs/Header header\nstring child_frame_id\nTransform transform\n" + header() +
           part("geometry_msgs/Transform") + "Vector3 translation\nQuaternion rotation\n" +
           vectors();
  }
  std::string image() const {
    return "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
           "uint8 is_bigendian\nuint32 step\nuint8[] data\n" +
           header();
  }
  std::string camera() const {
    const std::string k = ros1_ ? "K" : "k", d = ros1_ ? "D" : "d";
    return "std_msgs/Header header\nuint32 height\nuint32 width\nfloat64[] " + d + "\nfloat64[9] " +
           k + "\n" + header();
  }
  std::string packed() const {
    return "std_msgs/Header header\nstring format\nuint8[] data\n" + header();
  }
  std::string text() const { return "string data\n"; }

 private:
  static std::string part(const std::string& name) {
    return fmt::format("{:=<80}\nMSG: {}\n", "", name);
  }
  std::string header() const {
    return part("std_msgs/Header") + (ros1_ ? "uint32 seq\ntime stamp\nstring frame_id\n"
                                            : "builtin_interfaces/Time stamp\nstring frame_id\n");
  }
  static std::string vectors() {
    return part("geometry_msgs/Point") + "float64 x\nfloat64 y\nfloat64 z\n" +
           part("geometry_msgs/Vector3") + "float64 x\nfloat64 y\nfloat64 z\n" +
           part("geometry_msgs/Quaternion") + "float64 x 0\nfloat64 y\nfloat64 z\nfloat64 w\n";
  }
  bool ros1_;
};

/// A bag that is written message by message.
class Bag {
 public:
  explicit Bag(bool ros1, RosBytes::Form form = RosBytes::kLittle)
      : ros1_(ros1), form_(ros1 ? RosBytes::kPacked : form), file_(ros1), definitions_(ros1) {}

  std::string type(const std::string& package, const std::string& name) const {
    return package + (ros1_ ? "/" : "/msg/") + name;
  }
  RosBytes at(std::int64_t time_ns, const std::string& frame) const {
    RosBytes bytes(form_);
    bytes.header(time_ns, frame);
    return bytes;
  }
  void write(const std::string& topic, const std::string& type, const std::string& definition,
             std::int64_t log_ns, const RosBytes& bytes) {
    if (!channels_.contains(topic)) {
      std::string text = definition;
      // Defaults are of ROS 2.
      if (ros1_ && text.find(" x 0") != std::string::npos) text.erase(text.find(" x 0") + 2, 2);
      channels_[topic] = file_.topic(topic, type, text);
    }
    file_.message(channels_[topic], log_ns, bytes.bytes());
  }

  void pose(const std::string& topic, std::int64_t t, const std::string& frame,
            const std::vector<double>& p, const std::vector<double>& xyzw = {0, 0, 0, 1}) {
    write(topic, type("geometry_msgs", "PoseStamped"), definitions_.pose(), t + 3 * kMs,
          at(t, frame).fixed(p).fixed(xyzw));
  }
  void wrench(const std::string& topic, std::int64_t t, const std::string& frame,
              const std::vector<double>& force, const std::vector<double>& torque) {
    write(topic, type("geometry_msgs", "WrenchStamped"), definitions_.wrench(), t,
          at(t, frame).fixed(force).fixed(torque));
  }
  void joints(const std::string& topic, std::int64_t t, const std::vector<std::string>& names,
              const std::vector<double>& q, const std::vector<double>& dq = {},
              const std::vector<double>& effort = {}) {
    write(topic, type("sensor_msgs", "JointState"), definitions_.joints(), t,
          at(t, "").texts(names).open(q).open(dq).open(effort));
  }
  void transform(const std::string& topic, std::int64_t t, const std::string& parent,
                 const std::string& child, const std::vector<double>& p,
                 const std::vector<double>& xyzw) {
    RosBytes bytes(form_);
    bytes.put(std::uint32_t{1}).header(t, parent).text(child).fixed(p).fixed(xyzw);
    write(topic, type("tf2_msgs", "TFMessage"), definitions_.transforms(), t, bytes);
  }
  /// 3 x 2 pixels.
  void depth(const std::string& topic, std::int64_t t, const std::string& frame,
             const std::vector<std::uint16_t>& mm) {
    std::string data(12, '\0');
    std::memcpy(data.data(), mm.data(), 12);
    image(topic, t, frame, "16UC1", 6, data);
  }
  void image(const std::string& topic, std::int64_t t, const std::string& frame,
             const std::string& encoding, std::uint32_t step, const std::string& data) {
    write(topic, type("sensor_msgs", "Image"), definitions_.image(), t + 40 * kMs,
          at(t, frame)
              .put(std::uint32_t{2})
              .put(std::uint32_t{3})
              .text(encoding)
              .put(std::uint8_t{0})
              .put(step)
              .blob(data));
  }
  void camera(const std::string& topic, std::int64_t t, const std::string& frame) {
    write(topic, type("sensor_msgs", "CameraInfo"), definitions_.camera(), t,
          at(t, frame)
              .put(std::uint32_t{2})
              .put(std::uint32_t{3})
              .open<double>({0, 0, 0, 0, 0})
              .fixed<double>({2, 0, 1, 0, 2.5, 0.5, 0, 0, 1}));
  }
  void packed(const std::string& topic, std::int64_t t, const std::string& format,
              const std::string& data) {
    write(topic, type("sensor_msgs", "CompressedImage"), definitions_.packed(), t,
          at(t, "cam").text(format).blob(data));
  }
  void text(const std::string& topic, std::int64_t t) {
    write(topic, type("std_msgs", "String"), definitions_.text(), t, RosBytes(form_).text("hi"));
  }
  BagFile& file() { return file_; }

 private:
  bool ros1_;
  RosBytes::Form form_;
  BagFile file_;
  Definitions definitions_;
  std::map<std::string, std::uint16_t> channels_;
};

const std::vector<std::string> kNames = {"yaw", "pitch", "insertion"};

/// Everything that CRTK names, a camera and its pose.
Bag robot(bool ros1, RosBytes::Form form = RosBytes::kLittle, const std::string& frame = "W") {
  Bag bag(ros1, form);
  bag.transform("/tf_static", kStart, frame, "cam", {0, 0, 0.5}, {1, 0, 0, 0});
  bag.camera("/cam/depth/camera_info", kStart, "cam");
  for (int k = 0; k < 5; ++k) {
    const std::int64_t t = kStart + k * 20 * kMs;
    const double x = 0.001 * k;
    bag.pose("/PSM1/measured_cp", t, frame, {x, 0.02, 0.03},
             {0, 0, std::sqrt(0.5), std::sqrt(0.5)});
    bag.pose("/PSM1/setpoint_cp", t + kMs, frame, {x + 1e-5, 0.02, 0.03});
    bag.pose("/PSM1/servo_cp", t + 2 * kMs, frame, {x + 2e-5, 0.02, 0.03});
    bag.joints("/PSM1/measured_js", t, kNames, {0.1, -0.2, 0.1 + x}, {1, 2, 3}, {0.5, 0.6, 0.7});
    bag.joints("/PSM1/jaw/measured_js", t, {"jaw"}, {0.3 - x}, {-0.05}, {0.01});
    bag.joints("/PSM1/jaw/setpoint_js", t, {"jaw"}, {0.3});
    bag.joints("/PSM1/jaw/servo_jp", t + 5 * kMs, {}, {0.25});
    bag.wrench("/PSM1/body/measured_cf", t, "tip", {1, 0, 0}, {0, 0.1, 0});
    bag.depth("/cam/depth/image_raw", t, "cam",
              {0, 400, 500, static_cast<std::uint16_t>(500 + k), 65535, 1});
    bag.text("/rosout", t);
  }
  return bag;
}

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
  EXPECT_THAT(refused(broken), testing::MatchesRegex(".*byte .*/PSM1/setpoint_cp: geometry_msgs/"
                                                     "PoseStamped: ends inside.*"));
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
