// Bags as people have them: clocks that were set, damaged messages, cameras that were not
// calibrated, several parts. Nothing of it is taken for what it is not, and the rest comes in.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "core/check.h"
#include "core/config.h"
#include "core/mcap_chunk.h"
#include "mismatch/bag_builder.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/png_image.h"
#include "mismatch/recording/read_recording.h"
#include "mismatch/ros/bag.h"
#include "mismatch/ros/stamps.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;
using test::Bag;
using test::Definitions;
using test::kMs;
using test::kStart;
using test::RosBytes;
using testing::AllOf;
using testing::Contains;
using testing::Each;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr std::int64_t kSecond = 1000 * kMs;

/// Stamps every 10 ms, recorded 3 ms later.
std::vector<RosStamp> steady(std::size_t count) {
  std::vector<RosStamp> stamps;
  for (std::size_t k = 0; k < count; ++k) {
    const std::int64_t t = kStart + static_cast<std::int64_t>(k) * 10 * kMs;
    stamps.push_back({t + 3 * kMs, t, true});
  }
  return stamps;
}

std::size_t left_out(const RosTimes& times) {
  return static_cast<std::size_t>(std::count(times.left_out.begin(), times.left_out.end(), true));
}

TEST(RosTimes, StampsOfOneClockAreTakenWithoutAWord) {
  const RosTimes times = settle_times(steady(100), RosClock::kEither);
  EXPECT_FALSE(times.of_log);
  EXPECT_EQ(times.time_ns[7], kStart + 70 * kMs);
  EXPECT_THAT(times.told, IsEmpty());
  EXPECT_TRUE(settle_times(steady(100), RosClock::kLog).of_log);
  // Messages that were held up and came at once are later, not of another clock.
  std::vector<RosStamp> held_up = steady(100);
  for (std::size_t k = 0; k < 100; ++k)
    held_up[k].stamped = kStart + static_cast<std::int64_t>(k) * 2 * kSecond;
  for (std::size_t k = 0; k < 100; ++k)
    held_up[k].logged = held_up[k < 40 || k > 45 ? k : 45].stamped + 3 * kMs;
  EXPECT_THAT(settle_times(held_up, RosClock::kEither).told, IsEmpty());
  // Messages that a network swapped are sorted, and told.
  std::vector<RosStamp> swapped = steady(100);
  std::swap(swapped[40].stamped, swapped[41].stamped);
  const RosTimes sorted = settle_times(swapped, RosClock::kEither);
  EXPECT_FALSE(sorted.of_log);
  EXPECT_EQ(left_out(sorted), 0U);
  EXPECT_THAT(sorted.told, testing::ElementsAre(HasSubstr("sorted by stamp")));
}

TEST(RosTimes, AClockThatWasSetGivesWayToTheLog) {
  for (const std::int64_t step : {-4000 * kSecond, -203 * kMs, 4000 * kSecond}) {
    std::vector<RosStamp> stamps = steady(100);
    for (std::size_t k = 50; k < 100; ++k) stamps[k].stamped += step;
    const RosTimes times = settle_times(stamps, RosClock::kEither);
    EXPECT_TRUE(times.of_log) << step;
    EXPECT_EQ(left_out(times), 0U);
    ASSERT_EQ(times.told.size(), 1U) << step;
    EXPECT_THAT(times.told[0], AllOf(HasSubstr("at message 51 of 100"), HasSubstr("log_time")));
    const RosTimes stated = settle_times(stamps, RosClock::kStamps);
    EXPECT_FALSE(stated.of_log);
    EXPECT_THAT(stated.told, Contains(HasSubstr("as the map says")));
    // The log tells no better where it was made of the stamps.
    for (RosStamp& stamp : stamps) stamp.logged = stamp.stamped;
    const RosTimes part = settle_times(stamps, RosClock::kEither);
    EXPECT_EQ(left_out(part), step < 0 ? 50U : 0U) << "not two moments in one";
  }
}

TEST(RosTimes, StampsThatStrayOrStandAtZeroAreLeftOutAndCounted) {
  std::vector<RosStamp> stamps = steady(100);
  for (const std::size_t k : {20U, 60U}) stamps[k].stamped = 5 * kSecond;
  stamps[70].stamped += 50LL * 365 * 86400 * kSecond;
  const RosTimes stray = settle_times(stamps, RosClock::kEither);
  EXPECT_EQ(left_out(stray), 3U);
  EXPECT_TRUE(stray.left_out[20] && stray.left_out[60] && stray.left_out[70]);
  EXPECT_THAT(stray.told, Contains(HasSubstr("3 messages whose header.stamp strays")));
  std::vector<RosStamp> begun = steady(100);
  for (std::size_t k = 0; k < 3; ++k) begun[k] = {begun[k].logged, 0, false};
  const RosTimes zero = settle_times(begun, RosClock::kEither);
  EXPECT_EQ(left_out(zero), 3U);
  EXPECT_FALSE(zero.of_log);
  EXPECT_THAT(zero.told, Contains(HasSubstr("3 of 100 messages without header.stamp")));
  for (RosStamp& stamp : begun) stamp = {stamp.logged, 0, false};
  const RosTimes none = settle_times(begun, RosClock::kEither);
  EXPECT_TRUE(none.of_log);
  EXPECT_EQ(left_out(none), 0U);
  EXPECT_THAT(settle_times({}, RosClock::kEither).time_ns, IsEmpty());
}

class OddBags : public testing::Test {
 protected:
  Recording read(Bag& bag, const std::string& map = "ros {}") const {
    bag.file().save(path());
    pb::ImportMap parsed;
    parse_text_proto("map", map, parsed);
    Recording found;
    import_bags(parsed, path(), [&](const std::string&, const Recording& r) { found = r; });
    return found;
  }
  std::string path() const { return folder_ / "bag.mcap"; }
  test::TempDir folder_;
};

void add_arm(Bag& bag, const std::string& frame = "W") {
  for (int k = 0; k < 20; ++k)
    bag.pose("/PSM1/measured_cp", kStart + k * 10 * kMs, frame, {0.001 * k, 0, 0});
}

/// CameraInfo of 6 x 4 pixels with all that ROS 2 states.
void add_camera(Bag& bag, const std::vector<double>& K, const std::vector<double>& P,
                std::uint32_t binning = 0, const std::vector<std::uint32_t>& roi = {0, 0, 0, 0}) {
  const std::string line(80, '=');
  const std::string definition =
      "std_msgs/Header header\nuint32 height\nuint32 width\nfloat64[] d\nfloat64[9] k\n"
      "float64[12] p\nuint32 binning_x\nuint32 binning_y\nRegionOfInterest roi\n" +
      line +
      "\nMSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\n"
      "uint32 height\nuint32 width\nbool do_rectify\n" +
      line + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n";
  bag.write("/cam/camera_info", "sensor_msgs/msg/CameraInfo", definition, kStart,
            bag.at(kStart, "W")
                .put(std::uint32_t{4})
                .put(std::uint32_t{6})
                .open<double>({0.1, 0, 0, 0, 0})
                .fixed(K)
                .fixed(P)
                .put(binning)
                .put(binning)
                .fixed(roi)
                .put(std::uint8_t{0}));
}

const std::vector<double> kZeroK(9, 0), kZeroP(12, 0);
const std::vector<double> kK = {66, 0, 3, 0, 67, 2, 0, 0, 1};
const std::vector<double> kP = {60, 0, 2.5, 0, 0, 61, 1.5, 0, 0, 0, 1, 0};

/// A depth image of so many pixels.
void add_depth(Bag& bag, const std::string& topic, std::uint32_t width, std::uint32_t height,
               const std::string& frame = "W") {
  bag.write(topic, "sensor_msgs/msg/Image", Definitions(false).image(), kStart,
            bag.at(kStart, frame)
                .put(height)
                .put(width)
                .text("16UC1")
                .put(std::uint8_t{0})
                .put(2 * width)
                .blob(std::string(std::size_t{2} * width * height, '\1')));
}

TEST_F(OddBags, ACameraThatWasNotCalibratedIsLeftOutAndTheArmStays) {
  Bag bag(false);
  add_arm(bag);
  add_camera(bag, kZeroK, kZeroP);
  const Recording r = read(bag);
  EXPECT_EQ(r.find("tool")->rows(), 20U);
  EXPECT_FALSE(r.info.has_camera());
  EXPECT_THAT(r.warnings, Contains(AllOf(HasSubstr("/cam/camera_info"), HasSubstr("left out"),
                                         HasSubstr("not calibrated"))));
}

TEST_F(OddBags, ThePinholeIsThatOfThePicture) {
  const auto camera = [&](const std::string& topic, const std::vector<double>& K,
                          const std::vector<double>& P, std::string* told) {
    Bag bag(false);
    add_camera(bag, K, P);
    add_depth(bag, topic, 6, 4);
    const Recording r = read(bag);
    for (const std::string& warning : r.warnings) *told += warning + "\n";
    return r.info.camera();
  };
  std::string raw, rectified, alone;
  EXPECT_EQ(camera("/cam/image_raw", kK, kP, &raw).fx(), 66);
  EXPECT_THAT(raw, AllOf(HasSubstr("K and P differ"), HasSubstr("distortion")));
  const pb::RecordingCamera found = camera("/cam/image_rect_raw", kK, kP, &rectified);
  EXPECT_EQ(found.fx(), 60);
  EXPECT_EQ(found.fy(), 61);
  EXPECT_EQ(found.cx(), 2.5);
  EXPECT_EQ(found.cy(), 1.5);
  EXPECT_THAT(rectified, AllOf(HasSubstr("numbers of P"), Not(HasSubstr("distortion"))));
  EXPECT_EQ(camera("/cam/image_raw", kZeroK, kP, &alone).fx(), 60);
  EXPECT_THAT(alone, HasSubstr("K is zero"));
}

TEST_F(OddBags, ACropAndBinningMoveThePinhole) {
  Bag bag(false);
  add_camera(bag, kK, kZeroP, 2, {2, 0, 4, 4});  // x_offset, y_offset, height, width
  add_depth(bag, "/cam/image_raw", 2, 2);
  const Recording r = read(bag);
  EXPECT_EQ(r.info.camera().width(), 2U);
  EXPECT_EQ(r.info.camera().fx(), 33);
  EXPECT_EQ(r.info.camera().cx(), 0.5);
  EXPECT_EQ(r.info.camera().cy(), 1);
  EXPECT_THAT(r.warnings, Contains(HasSubstr("a crop of 4 x 4 at 2, 0, binning 2 x 2")));
}

TEST_F(OddBags, WhatNoTransformJoinsToTheToolIsLeftOut) {
  Bag bag(false);
  add_arm(bag, "PSM1_base");
  bag.transform("/tf_static", kStart, "table", "cam", {0, 0, 0.5}, {1, 0, 0, 0});
  add_camera(bag, kK, kP);
  add_depth(bag, "/cam/image_raw", 6, 4, "cam");
  const Recording apart = read(bag);
  EXPECT_EQ(apart.depth.size(), 0U);
  EXPECT_EQ(apart.find("tool")->rows(), 20U);
  EXPECT_THAT(apart.warnings, Contains(AllOf(HasSubstr("/cam/image_raw"), HasSubstr("table"),
                                             HasSubstr("PSM1_base"), HasSubstr("left out"))));
  bag.transform("/tf_static", kStart, "table", "PSM1_base", {0, 0, 0}, {0, 0, 0, 1});
  EXPECT_EQ(read(bag).depth.size(), 1U);
}

TEST_F(OddBags, AGoalWithoutFrameIsInThatOfItsArm) {
  Bag bag(false);
  bag.transform("/tf_static", kStart, "W", "PSM1_base", {0, 0, 1}, {0, 0, 0, 1});
  add_arm(bag, "PSM1_base");
  bag.pose("/PSM1/servo_cp", kStart, "", {0.5, 0, 0});
  const Recording r = read(bag);
  const Series& goals = *r.find("tool_commanded");
  EXPECT_EQ(goals.at(0, goals.find("tip_commanded_z_m")), 1);
}

TEST_F(OddBags, JointsGoByTheirNames) {
  const std::vector<std::string> names = {"outer_yaw", "outer_pitch", "outer_insertion"};
  Bag bag(false);
  bag.joints("/PSM1/measured_js", kStart, names, {1, 2, 0.3});
  bag.joints("/PSM1/measured_js", kStart + kMs, {names[2], names[0], names[1]}, {0.3, 1, 2});
  const Recording r = read(bag);
  const Series& joints = *r.find("joints");
  EXPECT_THAT(joints.columns,
              testing::ElementsAre("q1_measured_rad", "q2_measured_rad", "q3_measured_m"));
  for (std::size_t row = 0; row < 2; ++row) {
    EXPECT_EQ(joints.at(row, 0), 1);
    EXPECT_EQ(joints.at(row, 2), 0.3);
  }
  EXPECT_THAT(r.warnings, Contains(HasSubstr("1 message with the joints in another order")));
  // The first message decides for names that nobody knows; those of the dVRK have their numbers.
  Bag other(false);
  other.joints("/PSM1/measured_js", kStart, {"b", "a"}, {1, 2});
  other.joints("/PSM1/measured_js", kStart + kMs, {"a", "b"}, {2, 1});
  const Recording by_first = read(other);
  EXPECT_EQ(by_first.find("joints")->at(1, 0), 1);
  Bag sorted(false);
  sorted.joints("/PSM1/measured_js", kStart, {names[2], names[1], names[0]}, {0.3, 2, 1});
  EXPECT_EQ(read(sorted).find("joints")->at(0, 0), 1);
}

TEST_F(OddBags, DepthOfEightBitsIsNoDepthAndNoColour) {
  Bag bag(false);
  add_arm(bag);
  const std::string png = encode_png(2, 1, 8, 1, std::string("\0\1\2", 3), 0);
  bag.packed("/cam/depth/compressed", kStart, "16UC1; png compressed ", png);
  bag.image("/cam/depth/image_raw", kStart, "cam", "mono8", 3, std::string(6, '\1'));
  const Recording r = read(bag);
  EXPECT_EQ(r.color.size() + r.depth.size(), 0U);
  EXPECT_THAT(r.warnings, Contains(HasSubstr("half of each depth was lost")));
  EXPECT_THAT(r.warnings, Contains(HasSubstr("it is called depth")));
}

TEST_F(OddBags, DamagedMessagesAreLeftOutAndTheOthersCome) {
  Bag bag(false);
  add_arm(bag);
  const auto definition = Definitions(false).pose();
  bag.write("/PSM1/measured_cp", "geometry_msgs/msg/PoseStamped", definition, kStart,
            RosBytes(RosBytes::kLittle).text("x"));
  const std::string fields = std::string(80, '=') +
                             "\nMSG: sensor_msgs/PointField\nstring name\nuint32 offset\n"
                             "uint8 datatype\nuint32 count\n" +
                             std::string(80, '=') +
                             "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
                             "string frame_id\n";
  const auto cloud = [&](int k, const std::vector<std::string>& names, std::uint32_t height,
                         std::uint32_t width, std::uint32_t row_step) {
    RosBytes bytes = bag.at(kStart + k * kMs, "W");
    bytes.put(height).put(width).put(static_cast<std::uint32_t>(names.size()));
    std::uint32_t offset = 0;
    for (const std::string& name : names) {
      bytes.text(name).put(offset).put(std::uint8_t{7}).put(std::uint32_t{1});
      offset += 4;
    }
    bytes.put(std::uint8_t{0})
        .put(std::uint32_t{12})
        .put(row_step)
        .blob(std::string(std::size_t{12} * height * width, '\0'))
        .put(std::uint8_t{1});
    bag.write("/cloud", "sensor_msgs/msg/PointCloud2",
              "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\n"
              "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\n"
              "bool is_dense\n" +
                  fields,
              kStart, bytes);
  };
  cloud(0, {}, 0, 0, 0);
  cloud(1, {"x", "y", "z"}, 2, 3, 72);  // row_step of the whole cloud
  const Recording r = read(bag);
  EXPECT_EQ(r.find("tool")->rows(), 20U);
  ASSERT_EQ(r.clouds.size(), 1U);
  EXPECT_EQ(r.clouds.fetch(0).size(), 6U);
  EXPECT_THAT(r.warnings, Contains(AllOf(HasSubstr("/cloud: 1 message that cannot be read"),
                                         HasSubstr("without x, y or z"))));
  EXPECT_THAT(r.warnings, Contains(HasSubstr("row_step 72")));
  EXPECT_THAT(r.warnings, Contains(HasSubstr("/PSM1/measured_cp: 1 message that cannot be read")));
}

TEST_F(OddBags, PartsOfOneBagAreOneRecording) {
  Bag first(false), second(false);
  first.transform("/tf_static", kStart, "W", "base", {0, 0, 1}, {0, 0, 0, 1});
  for (int k = 0; k < 10; ++k) {
    first.pose("/PSM1/measured_cp", kStart + k * kMs, "base", {0, 0, 0});
    second.pose("/PSM1/measured_cp", kStart + (10 + k) * kMs, "base", {1, 0, 0});
  }
  const std::string bag = folder_ / "lift";
  fs::create_directory(bag);
  first.file().save(bag + "/lift_0.mcap");
  second.file().save(bag + "/lift_1.mcap");
  std::ofstream(bag + "/metadata.yaml") << "rosbag2_bagfile_information:\n"
                                           "  relative_file_paths:\n"
                                           "    - lift_0.mcap\n    - \"lift/lift_1.MCAP\"\n"
                                           "  files:\n    - path: lift_0.mcap\n";
  fs::rename(bag + "/lift_1.mcap", bag + "/lift_1.MCAP");
  const Recording r = read_bag(bag, {}, {});
  EXPECT_EQ(r.info.name(), "lift");
  ASSERT_EQ(r.find("tool")->rows(), 20U);
  EXPECT_EQ(r.find("tool")->at(15, 2), 1) << "transforms of the first part";
  std::vector<std::string> names;
  for_each_recording(
      bag, [&](const std::string& name, const Recording&) { names.push_back(name); },
      [](const std::string& path) { return read_bag(path, {}, {}); });
  EXPECT_THAT(names, testing::ElementsAre("lift"));
  names.clear();
  import_bags({}, folder_.path(),
              [&](const std::string& name, const Recording&) { names.push_back(name); });
  EXPECT_THAT(names, testing::ElementsAre("lift"));
  EXPECT_THAT(read_bag(bag + "/lift_0.mcap", {}, {}).warnings,
              Contains(HasSubstr("one of 2 parts of a bag")));
  fs::remove(bag + "/lift_1.MCAP");
  EXPECT_THAT(read_bag(bag, {}, {}).warnings, Contains(HasSubstr("names this part")));
}

TEST_F(OddBags, PartsWithoutMetadataAreInTheOrderOfTheirFirstStamps) {
  const std::string bag = folder_ / "lift";
  fs::create_directory(bag);
  for (const int part : {2, 10, 9}) {  // by their names 10 would come first
    Bag file(false);
    for (int k = 0; k < 10; ++k)
      file.pose("/PSM1/measured_cp", kStart + (10 * part + k) * kMs, "W", {0.1 * part, 0, 0});
    file.file().save(fmt::format("{}/lift_{}.mcap", bag, part));
  }
  std::ofstream(bag + "/lift_11.mcap") << "";  // the recorder was killed as it began
  const Recording r = read_bag(bag, {}, {});
  ASSERT_EQ(r.find("tool")->rows(), 30U);
  for (const auto& [row, x] : {std::pair{5, 0.2}, {15, 0.9}, {25, 1.0}})
    EXPECT_NEAR(r.find("tool")->at(row, 0), x, 1e-12);
  fs::rename(bag + "/lift_9.mcap", bag + "/other.mcap");
  EXPECT_THAT(parts_of_bag(bag), IsEmpty()) << "recordings of their own";
}

TEST_F(OddBags, OneBadFileOfAFolderIsLeftOutWithALine) {
  Bag bag(false);
  add_arm(bag);
  for (const char* name : {"a", "c"}) bag.file().save(folder_ / (std::string(name) + ".mcap"));
  std::ofstream(folder_ / "b.mcap") << "no bag";
  std::vector<std::string> names, told;
  const auto take = [&](const std::string& name, const Recording&) { names.push_back(name); };
  const auto left_out = [&](const std::string& path, const std::string& why) {
    told.push_back(recording_name(path) + ": " + why);
  };
  import_bags({}, folder_.path(), take, left_out);
  for_each_recording(
      folder_.path(), take, [](const std::string& path) { return read_bag(path, {}, {}); },
      left_out);
  EXPECT_THAT(names, testing::ElementsAre("a", "c", "a", "c"));
  EXPECT_THAT(told, testing::ElementsAre(testing::StartsWith("b: "), HasSubstr("b.mcap: ")));
  EXPECT_THROW(import_bags({}, folder_.path(), take), Error) << "where nobody is told";
  for (const char* name : {"a.mcap", "c.mcap"}) std::ofstream(folder_ / name) << "none";
  EXPECT_THROW(import_bags({}, folder_.path(), take, left_out), Error) << "none of them is good";
}

TEST_F(OddBags, MessagesThatAreCompressedOneByOneAreUnpacked) {
  Bag plain(false);
  add_arm(plain);
  const std::string pose =
      plain.at(kStart, "W").fixed<double>({1, 2, 3}).fixed<double>({0, 0, 0, 1}).bytes();
  Bag packed(false);
  const auto topic = packed.file().topic("/PSM1/measured_cp", "geometry_msgs/msg/PoseStamped",
                                         Definitions(false).pose());
  packed.file().message(topic, kStart, mcap::compress(McapCompression::kZstd, pose));
  const Recording r = read(packed);
  ASSERT_EQ(r.find("tool")->rows(), 1U);
  EXPECT_EQ(r.find("tool")->at(0, 1), 2);
  Bag other(false);
  const auto lz4 = other.file().topic("/PSM1/measured_cp", "geometry_msgs/msg/PoseStamped",
                                      Definitions(false).pose());
  add_arm(plain);
  other.file().message(lz4, kStart, mcap::compress(McapCompression::kLz4, pose));
  other.pose("/PSM1/setpoint_cp", kStart, "W", {0, 0, 0});
  EXPECT_THAT(read(other).warnings, Contains(HasSubstr("ros2 bag convert")));
}

TEST_F(OddBags, FilesThatBeginWithADotAreNobodysAndEndingsMayBeCapitals) {
  Bag bag(false);
  add_arm(bag);
  bag.file().save(folder_ / "LIFT.MCAP");
  std::ofstream(folder_ / "._LIFT.MCAP") << "Mac OS X";
  std::vector<std::string> names;
  const auto take = [&](const std::string& name, const Recording&) { names.push_back(name); };
  for_each_recording(folder_.path(), take,
                     [](const std::string& path) { return read_bag(path, {}, {}); });
  import_bags({}, folder_.path(), take);
  EXPECT_THAT(names, testing::ElementsAre("LIFT", "LIFT"));
}

}  // namespace
}  // namespace omentum
