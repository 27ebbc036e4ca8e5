// The gateway program on the bus of a live training, with the double as its robot.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

#include "core/segment_fields.h"
#include "core/wire.h"
#include "tests/integration/programs.h"
#include "tests/integration/robot_touches.h"

namespace omentum {
namespace {

using test::Programs;
using test::operator+;
using testing::HasSubstr;

/// A port of its own for each test process, below those that the system hands out.
std::string port() { return std::to_string(30000 + getpid() % 2500); }

TEST(GatewayBus, TakesThePolicyOfTheLearnerAndTellsWhatTheRobotDoes) {
  Programs programs;
  test::Process robot({OMENTUM_DVRK_DOUBLE, "--port", port()}, programs.folder() / "double.out",
                      programs.folder() / "double.err");
  test::Process learner = programs.learner("live", test::endless_task());
  test::Process worker = programs.worker("live", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("live", 1));
  const std::string out = programs.folder() / "gateway.out",
                    err = programs.folder() / "gateway.err";
  test::Process gateway(
      {OMENTUM_DVRK_GATEWAY, "--robot", "127.0.0.1:" + port(), "--policy", "bus", "--run", "live",
       "--domain", std::to_string(programs.domain()), "--ros", "--arm", "PSM2"},
      out, err);

  const dds::Participant participant(programs.domain(), test::loopback_profile().uri, "test");
  BusReader<RobotStatus> reader(participant, run_partition("live"), "test");
  RobotStatus last;
  const auto heard = [&](const std::function<bool()>& condition) {
    return test::eventually([&] {
      EXPECT_TRUE(reader.take(16, [&](Arrival<RobotStatus>&& arrival) {
        if (arrival.info.valid) last = std::move(arrival.record);
      }));
      return condition();
    });
  };
  // The double has homed; nobody told where it stands.
  ASSERT_TRUE(heard([&] { return last.reason_name == "NO_REGISTRATION" && last.is_homed; }))
      << last.reason_text << test::read_text(err);
  EXPECT_EQ(last.robot, "PSM2");
  EXPECT_EQ(last.pid, static_cast<std::uint32_t>(gateway.pid()));
  EXPECT_EQ(last.phase, RobotPhase::kWaiting);
  EXPECT_EQ(last.operating_state, "ENABLED");
  EXPECT_FALSE(last.registered);
  EXPECT_GT(last.datagrams, 0U);
  EXPECT_EQ(last.malformed + last.foreign + last.cut + last.unsent + last.sent, 0U);
  EXPECT_GE(last.policy_version, 1U);
  EXPECT_EQ(last.measured_jp.size(), 6U);
  EXPECT_THAT(test::read_text(out),
              HasSubstr("policy version " + std::to_string(last.policy_version)));
  gateway.kill(SIGTERM);
  EXPECT_EQ(gateway.wait(test::kRunTime), 1) << "no episode ran";
}

TEST(GatewayBus, AnEpisodeThatTheOperatorArmsIsPublishedAsOfARobot) {
  Programs programs;
  programs.train("done", test::tiny_task());
  const std::string table = programs.folder() / "touches.csv";
  const std::string registration = programs.folder() / "registration.txtpb";
  std::ofstream(table) << test::robot_touches();
  const test::Finished registered =
      programs.finish({OMENTUM_DVRK_GATEWAY, "--policy", programs.run_dir("done"), "--registration",
                       registration, "register", "--touches", table});
  ASSERT_EQ(registered.code, 0) << registered.err;

  const dds::Participant participant(programs.domain(), test::loopback_profile().uri, "test");
  BusReader<RobotStatus> states(participant, run_partition("done"), "states");
  BusReader<RolloutSegment> segments(participant, run_partition("done"), "segments", 64);
  BusReader<EpisodeSummary> summaries(participant, run_partition("done"), "summaries");
  test::Process robot({OMENTUM_DVRK_DOUBLE, "--port", port()}, programs.folder() / "double.out",
                      programs.folder() / "double.err");
  const std::string out = programs.folder() / "gateway.out";
  test::Process gateway({OMENTUM_DVRK_GATEWAY, "--robot", "127.0.0.1:" + port(), "--policy",
                         programs.run_dir("done"), "--registration", registration, "--run", "done",
                         "--domain", std::to_string(programs.domain())},
                        out, programs.folder() / "gateway.err");
  RobotStatus last;
  bool asked = false;
  std::vector<RolloutSegment> got;
  ASSERT_TRUE(test::eventually([&] {
    EXPECT_TRUE(states.take(16, [&](Arrival<RobotStatus>&& arrival) {
      if (arrival.info.valid) last = std::move(arrival.record);
    }));
    if (last.phase == RobotPhase::kReady && !std::exchange(asked, true)) gateway.kill(SIGUSR1);
    EXPECT_TRUE(segments.take(16, [&](Arrival<RolloutSegment>&& arrival) {
      if (arrival.info.valid) got.push_back(std::move(arrival.record));
    }));
    return !got.empty();
  })) << last.reason_text
      << test::read_text(out);
  const RolloutSegment& segment = got[0];
  EXPECT_EQ(segment.source, Source::kDvrk);
  EXPECT_EQ(segment.worker_id, last.gateway_id);
  EXPECT_EQ(segment.payload_crc32c, segment_crc(segment));
  EXPECT_EQ(segment.policy_version, last.policy_version);
  EXPECT_EQ(segment.weights_hash, last.weights_hash);
  EXPECT_TRUE(last.registered);
  EXPECT_GT(last.sent, 0U);
  // A machine that is too busy for the loop stops the arm: also that is told.
  if (segment.failed != 0) {
    EXPECT_THAT(test::read_text(out), HasSubstr("stopped: "));
    return;
  }
  EXPECT_EQ(segment.steps, 30U) << "60 periods in decisions of two";
  EXPECT_EQ(gateway.wait(test::kRunTime), 0);
  int told = 0;
  EXPECT_TRUE(summaries.take(16, [&](Arrival<EpisodeSummary>&& arrival) {
    if (arrival.info.valid && arrival.record.source == Source::kDvrk) ++told;
  }));
  EXPECT_EQ(told, 1);
}

TEST(GatewayBus, OptionsThatDoNotGoTogetherEndWithOneLine) {
  Programs programs;
  const test::Strings base = {OMENTUM_DVRK_GATEWAY, "--robot", "127.0.0.1:" + port(), "--policy"};
  const auto refused = [&](const test::Strings& more) {
    const test::Finished finished = programs.finish(base + more);
    EXPECT_EQ(finished.code, 2);
    EXPECT_EQ(test::lines_of(finished.err).size(), 1U) << finished.err;
    return finished.err;
  };
  EXPECT_THAT(refused({"bus"}), HasSubstr("--policy bus: needs --run"));
  EXPECT_THAT(refused({"x", "--ros"}), HasSubstr("--ros: needs --run"));
  EXPECT_THAT(refused({"bus", "--run", "r", "--arm", "P/1"}), HasSubstr("--arm \"P/1\""));
  EXPECT_THAT(refused({"bus", "--run", "a/b"}), HasSubstr("run.name \"a/b\""));
  EXPECT_THAT(refused({"bus", "--run", "r", "check"}), HasSubstr("--policy bus: only episodes"));
}

}  // namespace
}  // namespace omentum
