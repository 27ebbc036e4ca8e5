// Recordings of captured wire logs.
#include "dvrk_gateway/recording/wire_log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <sstream>

#include "dvrk_gateway/recording/motion.h"
#include "proto/foxglove.pb.h"
#include "tests/dvrk_gateway/recorded_session.h"
#include "tests/support/wire_log.h"

namespace omentum {
namespace {

using test::messages_of;
using testing::ElementsAre;
using testing::HasSubstr;

struct Converted {
  Result<WireLogCounts> counts = Failure{"not yet"};
  McapContent content;
};

Converted convert(const std::string& log) {
  std::istringstream in(log);
  std::ostringstream out;
  Converted converted;
  converted.counts = convert_wire_log(in, test::recording_setup(test::plain_mount()), out);
  converted.content = read_mcap(out.str());
  return converted;
}

const std::string kJoints =
    R"({"measured_js":{"AutomaticTimestamp":false,"Effort":null,"Name":null,)"
    R"("Position":[0,0,0.12,0,0,0],"Timestamp":3.5,"Valid":true,"Velocity":null}})";

TEST(WireLog, LinesAreWhatTheySay) {
  const auto robot = parse_wire_line("1.5\t{}");
  ASSERT_TRUE(robot);
  EXPECT_EQ(robot.value().time_ns, 1'500'000'000);
  EXPECT_FALSE(robot.value().from_client);
  const auto client = parse_wire_line("0.25\t>> {\"hold\":\"\"}");
  ASSERT_TRUE(client);
  EXPECT_TRUE(client.value().from_client);
  EXPECT_EQ(client.value().datagram, "{\"hold\":\"\"}");
  for (const char* bad :
       {"", "1.5 {}", "\t{}", "x\t{}", "nan\t{}", "inf\t{}", "-1\t{}", "1e300\t{}"})
    EXPECT_FALSE(parse_wire_line(bad)) << bad;
}

TEST(WireLog, GoodLinesAreRecordedAndBadOnesCountedAndTold) {
  const Converted log =
      convert("# header\n\n1.00\t" + kJoints + "\r\n" +
              "no tab\n"
              "1.01\t{\"measured_js\":\n"
              "0.50\t" +
              kJoints + "\n" + "1.02\t>> {\"servo_jp\":{\"Goal\":[0,0,0.12,0,0,0]}}\n" +
              "1.03\t>> {\"servo_jp\":{\"Goal\":[0,0,0.13]}}\n" +
              "1.04\t>> {\"servo_jp\":{\"Goal\":[0,0,1e999,0,0,0]}}\n" + std::string(80'000, 'x') +
              "\n" + "1.05\t>> {\"jaw/servo_jp\":{\"Goal\":[0.4]}}");
  ASSERT_TRUE(log.counts) << log.counts.error();
  const WireLogCounts& counts = log.counts.value();
  EXPECT_EQ(counts.comments, 2U);
  EXPECT_EQ(counts.robot, 1U);
  EXPECT_EQ(counts.client, 3U);
  EXPECT_EQ(counts.without_goal, 1U);
  EXPECT_EQ(counts.bad, 5U);
  EXPECT_THAT(counts.problems,
              ElementsAre(HasSubstr("line 4: no tab"), HasSubstr("line 5: no JSON"),
                          HasSubstr("line 6: its time is before"),
                          HasSubstr("line 9: of the client"), HasSubstr("line 10: longer than")));
  EXPECT_TRUE(log.content.complete);
  EXPECT_EQ(log.content.of_topic("/joints").size(), 1U);
  EXPECT_EQ(log.content.of_topic("/tool_commanded").size(), 1U);
  ASSERT_EQ(log.content.of_topic("/jaw").size(), 1U);
  EXPECT_EQ(messages_of<pb::JawSample>(log.content, "/jaw")[0].commanded_rad(), 0.4);
  EXPECT_EQ(log.content.of_topic("/jaw")[0]->log_time, 1'050'000'000U);
}

TEST(WireLog, OfSeveralGoalsOfADatagramTheLastThatRunsCounts) {
  const Converted log = convert("1\t" + kJoints +
                                "\n2\t>> {\"servo_jp\":{\"Goal\":[0,0,0.15,0,0,0]},"
                                "\"move_jp\":{\"Goal\":[0,0,0.2,0,0,0]}}\n");
  ASSERT_TRUE(log.counts) << log.counts.error();
  const auto joints = messages_of<foxglove::JointStates>(log.content, "/joints_commanded");
  ASSERT_EQ(joints.size(), 1U);
  EXPECT_EQ(joints[0].joints(2).position(), 0.15);
}

TEST(WireLog, LinesOfOneTimeStayApart) {
  std::string log;
  for (const char* z : {"0.12", "0.13"})
    log += std::string("1\t>> {\"servo_jp\":{\"Goal\":[0,0,") + z + ",0,0,0]}}\n";
  std::istringstream in(log + "1\t" + kJoints + "\n");
  std::ostringstream out;
  ASSERT_TRUE(convert_wire_log(in, test::recording_setup(test::plain_mount()), out));
  const auto motion = parse_motion("log", out.str());
  ASSERT_TRUE(motion) << motion.error();
  EXPECT_EQ(motion.value().size(), 2U);
}

TEST(WireLog, ATimeThatStepsALittleBackLosesNoDatagram) {
  const auto goal = [](const char* time, const char* z) {
    return std::string(time) + "\t>> {\"servo_jp\":{\"Goal\":[0,0," + z + ",0,0,0]}}\n";
  };
  const Converted log =
      convert("1\t" + kJoints + "\n" + goal("2.0000003", "0.12") + goal("2.0000000", "0.13") +
              goal("1.9999997", "0.14") + goal("1.9999990", "0.15") + goal("2.0000003", "0.16"));
  ASSERT_TRUE(log.counts) << log.counts.error();
  EXPECT_EQ(log.counts.value().client, 4U);
  EXPECT_EQ(log.counts.value().stepped_back, 2U);
  EXPECT_THAT(log.counts.value().problems, ElementsAre(HasSubstr("line 5: its time is before")))
      << "by more than 1 us";
  const auto goals = log.content.of_topic("/joints_commanded");
  ASSERT_EQ(goals.size(), 4U);
  for (std::size_t k = 0; k < goals.size(); ++k)
    EXPECT_EQ(goals[k]->log_time, 2'000'000'300U + k) << "in the order of the log";
}

TEST(WireLog, TwoArmsInOneLogAreRefusedByTheirNames) {
  const auto pose = [](const std::string& time, const std::string& arm) {
    return time + "\t{\"local/measured_cp\":{\"AutomaticTimestamp\":false,\"MovingFrame\":\"" +
           arm +
           "\",\"Position\":{\"Rotation\":[[0,1,0],[1,0,0],[0,0,-1]],\"Translation\":[0,0,-0.11]},"
           "\"ReferenceFrame\":\"" +
           arm + "_base\",\"Timestamp\":0.0,\"Valid\":true}}\n";
  };
  EXPECT_TRUE(convert(pose("0", "PSM1") + pose("1", "PSM1")).counts);
  EXPECT_THAT(convert(pose("0", "PSM1") + pose("1", "PSM2")).counts.error(),
              testing::AllOf(HasSubstr("\"PSM1\" and \"PSM2\""), HasSubstr("two arms in one log")));
}

TEST(WireLog, WithoutARobotIsRefusedWithTheFirstLine) {
  EXPECT_THAT(convert("").counts.error(), HasSubstr("no datagram of a robot"));
  EXPECT_THAT(convert("PK\x03\x04\n").counts.error(), HasSubstr("line 1: no tab"));
}

TEST(WireLog, TheRecordedSessionBecomesARecording) {
  const std::vector<test::WireLine> lines = test::read_wire_log();
  if (lines.empty()) GTEST_SKIP() << "no dvrk_wire in OMENTUM_REAL_DATA";
  const char* folder = std::getenv("OMENTUM_REAL_DATA");  // NOLINT(concurrency-mt-unsafe)
  std::ifstream log(std::string(folder) + "/dvrk_wire/psm1_kinsim_session.tsv");
  std::ostringstream out;
  const auto counts = convert_wire_log(log, test::recording_setup(test::plain_mount()), out);
  ASSERT_TRUE(counts) << counts.error();
  EXPECT_EQ(counts.value().robot + counts.value().client + counts.value().bad, lines.size());
  // The one text of the client that is no JSON, as the session tried (docs/dvrk.md 5.2 row 4).
  EXPECT_THAT(counts.value().problems, ElementsAre(HasSubstr("of the client")));
  const McapContent content = read_mcap(out.str());
  ASSERT_TRUE(content.complete);
  // docs/dvrk.md 4.4: six joints and valid poses from 2.355 s on, FAULT at 15.687 s.
  const auto first_pose = content.of_topic("/tool").front();
  EXPECT_NEAR(1e-9 * static_cast<double>(first_pose->log_time), 2.355, 0.01);
  foxglove::PoseInFrame pose;
  ASSERT_TRUE(pose.ParseFromString(first_pose->data));
  EXPECT_NEAR(pose.pose().position().z(), -0.1135 - 0.0102, 1e-6);
  const auto states = content.of_topic("/robot_state");
  const auto fault = std::find_if(states.begin(), states.end(), [](const McapMessage* message) {
    pb::RobotStateSample state;
    return state.ParseFromString(message->data) && state.state() == "FAULT";
  });
  ASSERT_NE(fault, states.end());
  EXPECT_NEAR(1e-9 * static_cast<double>((*fault)->log_time), 15.687, 0.01);
  // Where the robot was told to go it went: the goal of row 1 shows 20 ms later.
  const auto goals = messages_of<foxglove::JointStates>(content, "/joints_commanded");
  ASSERT_GE(goals.size(), 10U);
  EXPECT_NEAR(goals.front().joints(2).position() - 0.12, 0.03, 1e-9);
  EXPECT_TRUE(parse_motion("log", out.str()).has_value());
}

}  // namespace
}  // namespace omentum
