// Sensors beside the robot: lines, tables and ports.
#include "dvrk_gateway/recording/sensor_sources.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "core/ply.h"
#include "core/read_file.h"
#include "dvrk_gateway/protocol/udp_socket.h"
#include "dvrk_gateway/recording/plain_folder.h"
#include "proto/foxglove.pb.h"
#include "tests/dvrk_gateway/recorded_session.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

template <typename Message>
const Message& as(const SensorMessage& message) {
  return dynamic_cast<const Message&>(*message);
}

TEST(SensorJson, IsOneSample) {
  const auto force = parse_sensor_json(SensorKind::kForce,
                                       R"({"t_s":1.5,"fx_N":0.1,"fy_N":-0.2,"fz_N":3,"tz_Nm":1})");
  ASSERT_TRUE(force) << force.error();
  EXPECT_EQ(as<pb::ForceSample>(force.value()).fy_n(), -0.2);
  EXPECT_EQ(as<pb::ForceSample>(force.value()).tz_nm(), 1);
  const auto tip = parse_sensor_json(
      SensorKind::kTracker, R"({"t_s":0,"x_m":1,"y_m":2,"z_m":3,"qw":1,"qx":0,"qy":0,"qz":0})");
  ASSERT_TRUE(tip) << tip.error();
  EXPECT_THAT(as<pb::TrackerSample>(tip.value()).position_m(), ElementsAre(1, 2, 3));
  EXPECT_EQ(as<pb::TrackerSample>(tip.value()).orientation_wxyz_size(), 4);
  const auto markers = parse_sensor_json(SensorKind::kMarkers, R"({"t_s":0,"p_m":[1,2,3,4,5,6]})");
  ASSERT_TRUE(markers) << markers.error();
  EXPECT_EQ(as<pb::MarkersSample>(markers.value()).position_m_size(), 6);
  const auto cloud = parse_sensor_json(SensorKind::kCloud, R"({"t_s":2,"p_m":[1,2,3]})");
  ASSERT_TRUE(cloud) << cloud.error();
  EXPECT_EQ(as<foxglove::PointCloud>(cloud.value()).data().size(), 12U);
  EXPECT_EQ(as<foxglove::PointCloud>(cloud.value()).timestamp().seconds(), 2);
}

TEST(SensorJson, WhatCannotBeMeantIsRefusedInOneLine) {
  const auto refusal = [](SensorKind kind, const char* text) {
    const auto message = parse_sensor_json(kind, text);
    return message ? "taken" : message.error();
  };
  EXPECT_EQ(refusal(SensorKind::kForce, "1.0, 2.0"), "no JSON object");
  EXPECT_EQ(refusal(SensorKind::kForce, "[1]"), "no JSON object");
  EXPECT_EQ(refusal(SensorKind::kForce, R"({"t_s":1,"fx_N":0,"fy_N":0})"), "fz_N is missing");
  EXPECT_EQ(refusal(SensorKind::kForce, R"({"t_s":1,"fx_N":"0","fy_N":0,"fz_N":0})"),
            "fx_N is no finite number");
  EXPECT_EQ(refusal(SensorKind::kForce, R"({"t_s":1,"fx_N":0,"fy_N":0,"fz_N":0,"f_lbf":1})"),
            "a member that is not known");
  EXPECT_EQ(refusal(SensorKind::kMarkers, R"({"t_s":1,"p_m":[1,2]})"),
            "p_m has 2 numbers, needed x y z of each point");
  EXPECT_EQ(refusal(SensorKind::kMarkers, R"({"t_s":1,"p_m":[1,2,null]})"),
            "p_m has what is no finite number");
  EXPECT_EQ(refusal(SensorKind::kColor, "{}"), "images come by files");
}

TEST(SensorSource, OptionsSayWhatIsAllowed) {
  EXPECT_EQ(parse_sensor_source("force=udp:5000").port, 5000);
  EXPECT_EQ(parse_sensor_source("cloud=file:a/clouds.csv").path, "a/clouds.csv");
  for (const char* bad : {"force", "lidar=udp:5000", "force=udp:0", "force=udp:70000",
                          "force=udp:1.5", "force=tcp:5000", "force=file:", "color=udp:5000"}) {
    try {
      parse_sensor_source(bad);
      ADD_FAILURE() << bad;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr(std::string("--source ") + bad + ": "));
      EXPECT_THAT(error.what(), HasSubstr("allowed NAME=udp:PORT"));
    }
  }
}

class Sources : public testing::Test {
 protected:
  /// What a poll brings: forces fx, and how many lines could not be read.
  void poll(SensorSource& source) {
    source.poll([this](SensorKind, const SensorMessage& message) {
      if (message == nullptr)
        ++bad_;
      else if (const auto* force = dynamic_cast<const pb::ForceSample*>(message.get()))
        fx_.push_back(force->fx_n());
      else
        others_.push_back(message);
    });
  }
  void append(const std::string& name, const std::string& text) {
    std::ofstream(folder_ / name, std::ios::app | std::ios::binary) << text;
  }
  std::unique_ptr<SensorSource> follow(const std::string& sensor, const std::string& name) {
    return open_sensor_source(parse_sensor_source(sensor + "=file:" + (folder_ / name)));
  }
  test::TempDir folder_;
  std::vector<double> fx_;
  std::vector<SensorMessage> others_;
  int bad_ = 0;
};

TEST_F(Sources, ATableIsFollowedFromWhereItEndsWithItsUnits) {
  append("force.csv", "t_ms,fx_N,fy_N,fz_N\n0,1,0,0\n1,2");
  const auto source = follow("force", "force.csv");
  poll(*source);
  append("force.csv", "2,0,0\n2,3,0,0\n3,4,");
  poll(*source);
  EXPECT_THAT(fx_, ElementsAre(3)) << "not what was there, not what is not whole";
  append("force.csv", "0,0\n4,five,0,0\n5,6,0,0\n");
  poll(*source);
  EXPECT_THAT(fx_, ElementsAre(3, 4, 6));
  EXPECT_EQ(bad_, 1);
}

TEST_F(Sources, ATableMayComeLateAndBeBegunAnew) {
  const auto source = follow("force", "force.csv");
  poll(*source);
  append("force.csv", "t_s,fx_N,");
  poll(*source);
  append("force.csv", "fy_N,fz_N\n0,1,0,0\n1,2,0,0\n");
  poll(*source);
  EXPECT_THAT(fx_, ElementsAre(1, 2));
  std::filesystem::remove(folder_ / "force.csv");
  poll(*source);
  append("force.csv", "t_s,fx_N,fy_N,fz_N\n9,7,0,0\n");
  poll(*source);
  EXPECT_THAT(fx_, ElementsAre(1, 2, 7));
  EXPECT_EQ(bad_, 0);
}

TEST_F(Sources, CloudsAndImagesAreTheFilesThatATableNames) {
  append("clouds.csv", "t_s,file\n");
  append("color.csv", "t_s,file\n");
  const auto clouds = follow("cloud", "clouds.csv"), images = follow("color", "color.csv");
  append("a.ply", encode_ply({{1, 2, 3}, {4, 5, 6}}));
  append("a.png", "\x89PNG\r\n\x1a\npicture");
  append("clouds.csv", "0.1,a.ply\n0.2,absent.ply\n");
  append("color.csv", "0.5,a.png\n0.6,a.ply\n");
  poll(*clouds);
  poll(*images);
  ASSERT_EQ(others_.size(), 2U);
  EXPECT_EQ(as<foxglove::PointCloud>(others_[0]).data().size(), 24U);
  EXPECT_EQ(as<foxglove::CompressedImage>(others_[1]).format(), "png");
  EXPECT_EQ(as<foxglove::CompressedImage>(others_[1]).timestamp().nanos(), 500'000'000);
  EXPECT_EQ(bad_, 2);
}

TEST_F(Sources, APortTakesLinesAndCountsWhatIsNone) {
  UdpSocket free_port(0);
  const std::uint16_t port = free_port.port();
  EXPECT_THROW(open_sensor_source(parse_sensor_source("force=udp:" + std::to_string(port))), Error)
      << "in use";
  UdpSocket sensor(0);
  std::unique_ptr<SensorSource> source;
  std::uint16_t own = 0;
  for (own = 40'000; own < 60'000 && !source; ++own) {
    try {
      source = open_sensor_source(parse_sensor_source("force=udp:" + std::to_string(own)));
    } catch (const Error&) {  // taken by another
    }
  }
  ASSERT_TRUE(source);
  const UdpAddress to{0x7f000001, static_cast<std::uint16_t>(own - 1)};
  const std::string line = R"({"t_s":0,"fx_N":1,"fy_N":0,"fz_N":0})";
  ASSERT_EQ(sensor.send(line + "\n" + line + "\n", to), SendOutcome::kSent);
  ASSERT_EQ(sensor.send("hello", to), SendOutcome::kSent);
  poll(*source);  // loopback has delivered when send() returns
  EXPECT_THAT(fx_, ElementsAre(1, 1));
  EXPECT_EQ(bad_, 1);
}

TEST_F(Sources, GoIntoTheRecordingAndItsPlainFolder) {
  test::RecordedSession session;
  RobotRecorderOptions options;
  options.path = folder_ / "a.mcap";
  options.setup = test::recording_setup(session.mount);
  options.min_free_bytes = 0;
  options.longest_queue = 100'000;
  append("force.csv", "t_s,fx_N,fy_N,fz_N\n");
  append("clouds.csv", "t_s,file\n");
  append("a.ply", encode_ply({{1, 2, 3}}));
  {
    RobotRecorder recorder(options);
    SensorSources sources(
        {"force=file:" + (folder_ / "force.csv"), "cloud=file:" + (folder_ / "clouds.csv")},
        recorder);
    for (const Period& period : session.take(30)) recorder.on_period(period);
    append("force.csv", "0,0.5,0,0\nbad\n");
    append("clouds.csv", "0,a.ply\n");
    sources.end();  // what is there is taken
    ASSERT_TRUE(recorder.finish().has_value());
  }
  const McapContent content = read_mcap(read_file(options.path).value());
  EXPECT_EQ(test::messages_of<pb::ForceSample>(content, "/force").at(0).fx_n(), 0.5);
  write_plain_folder(options.path, folder_ / "plain");
  EXPECT_THAT(read_file(folder_ / "plain/force.csv").value(), HasSubstr(",0.5,0,0,0,0,0\n"));
  const auto cloud = read_file(folder_ / "plain/clouds/000000.ply");
  ASSERT_TRUE(cloud) << cloud.error();
  EXPECT_EQ(parse_ply("cloud", cloud.value()).value().front(), Eigen::Vector3f(1, 2, 3));
}

}  // namespace
}  // namespace omentum
