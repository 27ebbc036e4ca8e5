// The gateway against the double in simulated time: what stops it, how fast, and what a bad network
// changes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <memory>

#include "tests/dvrk_gateway/gateway_session.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::TwoSides;
using testing::HasSubstr;

constexpr std::int64_t kMs = TwoSides::kMs;
using test::kStartTip;
using test::Session;

Eigen::Isometry3d turned_base() {
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();
  X_AR.linear() = Eigen::AngleAxisd(0.8, Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  X_AR.translation() = Vector3d(0.3, -0.2, 0.1);
  return X_AR;
}

struct Stop {
  const char* name;
  StopReason reason;
  std::int64_t within_ms;  ///< of the cause the first hold leaves; the robot's period is 10 ms
  const char* told;        ///< what the operator reads, with the address
  std::function<void(Session&)> cause;
};

/// The cause comes `after_ns` into a period.
void expect_held_in_time(const Stop& stop, std::int64_t after_ns) {
  SCOPED_TRACE(std::string(stop.name) + ", ns into the period: " + std::to_string(after_ns));
  Session session;
  ASSERT_TRUE(session.guide->go_to(kStartTip));
  ASSERT_TRUE(session.follow_circle(20));
  session.sides.sleep_until(session.sides.now_ns() + after_ns);
  const std::int64_t caused_ns = session.sides.now_ns();
  stop.cause(session);
  const Result<void> went = session.follow_circle(60);
  ASSERT_FALSE(went);
  EXPECT_THAT(went.error(), HasSubstr(stop.told));
  EXPECT_EQ(session.port->period().judgement.memory.stop.reason, stop.reason) << went.error();
  for (int k = 0; k < 20; ++k) session.port->exchange({});
  const std::vector<std::int64_t> holds = session.hold_times();
  ASSERT_EQ(holds.size(), 3U);
  EXPECT_LE(holds[0] - caused_ns, stop.within_ms * kMs);
}

// Within 50 ms of what the thief sends: the robot looks at it up to 10 ms later.
TEST(GatewayStops, ATheftARestartAndASecondRobotAreHeldWithin50MsAndNamed) {
  const Stop stops[] = {
      {"theft", StopReason::kStale, 33, "127.0.0.1:40000",
       [](Session& s) { s.sides.robot().steal(test::kStranger); }},
      {"restart", StopReason::kForeignSource, 13, "127.0.0.1:40001",
       [](Session& s) { s.sides.restart(); }},
      {"restart behind one address", StopReason::kTimestampBackward, 13, "127.0.0.1:40000",
       [](Session& s) { s.sides.robot().restart_timestamps(); }},
      {"second robot", StopReason::kForeignSource, 3, "10.0.0.7:9",
       [](Session& s) { s.sides.tell_gateway("{}", test::kStranger); }},
  };
  for (const Stop& stop : stops) {
    for (const std::int64_t after_ms : {0, 1, 5, 9, 10, 11, 15, 19})
      expect_held_in_time(stop, after_ms * kMs);
  }
}

TEST(GatewayStops, TheOperatorIsNotMadeToWaitForThePeriod) {
  Session session;
  ASSERT_TRUE(session.guide->go_to(kStartTip));
  ASSERT_TRUE(session.follow_circle(20));
  std::int64_t stopped_ns = 0;
  session.sides.after_period = [&](DvrkDouble&) {  // in the middle of a period of the gateway
    if (stopped_ns == 0) stopped_ns = session.events.stop_ns = session.sides.now_ns();
  };
  ASSERT_FALSE(session.follow_circle(60));
  for (int k = 0; k < 5; ++k) session.port->exchange({});
  const std::vector<std::int64_t> holds = session.hold_times();
  ASSERT_EQ(holds.size(), 3U);
  EXPECT_LE(holds[0] - stopped_ns, kLookInterval_ns);
  // The other two follow at the period, in case that one gets lost.
  EXPECT_EQ(holds[1] - holds[0], 20 * kMs);
  EXPECT_EQ(holds[2] - holds[1], 20 * kMs);
}

TEST(GatewayStops, AfterATheftTheHoldsTakeTheStreamBack) {
  Session session;
  ASSERT_TRUE(session.guide->go_to(kStartTip));
  session.sides.robot().steal(test::kStranger);
  ASSERT_FALSE(session.follow_circle(60));
  for (int k = 0; k < 10; ++k) session.port->exchange({});
  EXPECT_EQ(session.sides.robot().destination(), test::kClient);
  EXPECT_EQ(session.port->period().judgement.memory.phase, SafetyPhase::kStopped);
}

TEST(GatewayStops, APolicyThatStallsIsHeldWithin50Ms) {
  Session session;
  ASSERT_TRUE(session.guide->go_to(kStartTip));
  ASSERT_TRUE(session.follow_circle(20));
  const std::int64_t last_ns = session.sides.gateway_link.sent.back().time_ns;
  for (int k = 0; k < 20; ++k) session.port->exchange({});
  const std::vector<std::int64_t> holds = session.hold_times();
  ASSERT_EQ(holds.size(), 3U);
  EXPECT_LE(holds[0] - last_ns, 50 * kMs);
  EXPECT_EQ(session.port->period().judgement.memory.stop.reason, StopReason::kPolicyLate);
}

TEST(GatewayNetwork, LossDuplicationReorderingAndJitterChangeThePathByLessThanOneAction) {
  Disturbance bad;
  bad.loss = 0.1;
  bad.duplication = 0.1;
  bad.reordering = 0.1;
  bad.jitter_s = 0.005;
  std::vector<Vector3d> undisturbed;
  Session plain;
  ASSERT_TRUE(plain.guide->go_to(kStartTip));
  ASSERT_TRUE(plain.follow_circle(500, [&] { undisturbed.push_back(plain.tip()); }));
  int ended = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Session session(bad, Eigen::Isometry3d::Identity(), seed);
    ASSERT_TRUE(session.guide->go_to(kStartTip));
    std::vector<Vector3d> path;
    const Result<void> went = session.follow_circle(500, [&] { path.push_back(session.tip()); });
    ended += went ? 0 : 1;
    double apart = 0;
    for (const Vector3d& tip : path) {
      double nearest = 1;
      for (const Vector3d& other : undisturbed) nearest = std::min(nearest, (tip - other).norm());
      apart = std::max(apart, nearest);
    }
    EXPECT_LE(apart, 0.0005) << "seed " << seed;
    EXPECT_LE((path.back() - undisturbed[path.size() - 1]).norm(), 0.0015) << "seed " << seed;
  }
  EXPECT_LE(ended, 1) << "paths that a stop cut short";
}

TEST(GatewayBaseFrame, ATurnedBaseOfTheConsoleGivesTheSamePath) {
  Session plain, turned({}, turned_base());
  ASSERT_TRUE(plain.guide->go_to(kStartTip));
  ASSERT_TRUE(turned.guide->go_to(kStartTip));
  ASSERT_TRUE(plain.follow_circle(100));
  ASSERT_TRUE(turned.follow_circle(100));
  EXPECT_LT((plain.tip() - turned.tip()).norm(), 1e-9);
  EXPECT_GT((plain.port->period().robot.measured_cp.payload.translation -
             turned.port->period().robot.measured_cp.payload.translation)
                .norm(),
            0.1);
}

TEST(GatewayBaseFrame, AnotherBaseThanThatOfTheConsoleIsNeverArmed) {
  Session session;
  session.setup.X_AR = turned_base();
  session.loop =
      std::make_unique<ControlLoop>(session.sides.gateway_link, session.sides, session.setup);
  SteppedPort port(*session.loop, session.sides, session.events);
  for (int k = 0; k < 100; ++k) {
    session.events.arm_ns = session.sides.now_ns();
    const Period& now = port.exchange({.fresh = true, .command = {}});
    ASSERT_NE(now.judgement.memory.phase, SafetyPhase::kActive);
  }
  EXPECT_EQ(port.period().judgement.finding.reason, StopReason::kBaseFrame);
  EXPECT_TRUE(session.sides.gateway_link.sent.empty());
}

}  // namespace
}  // namespace omentum
