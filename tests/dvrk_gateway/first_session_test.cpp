// What a first session on a robot meets: velocities of other clients, a network that loses
// commands, a robot that is started anew, a tool that was carried in as it was homed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "dvrk_gateway/operator_screen.h"
#include "dvrk_gateway/protocol/base_frame.h"
#include "dvrk_gateway/robot_report.h"
#include "tests/dvrk_gateway/gateway_session.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::kStartTip;
using test::Session;
using test::TwoSides;
using testing::HasSubstr;

double setpoint_speed(const Session& session) {
  const JointState joints = session.sides.robot().arm().setpoint_js();
  double most = 0;
  for (const double v : joints.velocity) most = std::max(most, std::abs(v));
  return most;
}

/// Says where the robot's set-point is, with a velocity, and is never heard of again.
void leave_a_velocity(Session& session) {
  const CartesianPose at = session.sides.robot().arm().setpoint_cp();
  std::string text = test::cartesian("servo_cp", at.translation, at.rotation);
  text.insert(text.size() - 2, R"(,"Velocity":[0.05,0,0])");
  session.sides.say(text);
  session.sides.sleep_until(session.sides.now_ns() + 30 * TwoSides::kMs);
}

TEST(FirstSession, AVelocityThatWasLeftBehindIsToldBeforeArmingAndNeverDrivesAGoal) {
  Session session;
  leave_a_velocity(session);
  ASSERT_GT(setpoint_speed(session), 0.05) << "the robot keeps it";
  for (int k = 0; k < 50; ++k) session.port->exchange({});
  EXPECT_EQ(session.port->period().judgement.finding.reason, StopReason::kSetpointVelocity);
  // A hold takes it from the set-point; the streamer has it still, and the next goal would too.
  session.sides.say(R"({"hold":""})");
  ASSERT_TRUE(session.guide->go_to(kStartTip));
  double most = 0;
  session.sides.after_period = [&](DvrkDouble&) { most = std::max(most, setpoint_speed(session)); };
  ASSERT_TRUE(session.follow_circle(200));
  EXPECT_EQ(most, 0);
}

TEST(FirstSession, AFieldThatIsLeftOutKeepsItsValueInTheDoubleAsInTheStreamer) {
  test::DoubleSession session;
  session.run_for(0.01);
  // Also of a command that the arm did not take.
  session.say(R"({"servo_jp":{"Goal":[0.1,0,0.12,0,0,0],"Velocity":[0.1,0,0,0,0,0]}})");
  session.home();
  session.say(test::servo_jp({0.1, 0, 0.12, 0, 0, 0}));
  session.run_for(0.03);
  EXPECT_EQ(session.setpoint().velocity[0], 0.1);
  session.say(R"({"servo_jp":{"Goal":[0.1,0,0.12,0,0,0],"Velocity":[0,0,0,0,0,0]}})");
  session.run_for(0.03);
  EXPECT_EQ(session.setpoint().velocity[0], 0);
}

struct Episode {
  double longest_step = 0;  ///< of the set-point, per axis of W, while armed [m]
  StopReason stop = StopReason::kNone;
  std::string told;
  bool armed = false;
  int goals = 0;
};

/// To a start, then a circle: 14 s of goals where nothing stops them.
Episode run_episode(double loss, std::uint64_t seed) {
  Disturbance network;
  network.loss = loss;
  Session session(network, Eigen::Isometry3d::Identity(), seed);
  Episode episode;
  Vector3d before = Vector3d::Zero();
  bool armed = false;
  session.sides.after_period = [&](DvrkDouble& robot) {
    const Vector3d at = session.setup.mount.X_WR * robot.arm().setpoint_cp().translation;
    if (armed)
      episode.longest_step = std::max(episode.longest_step, (at - before).cwiseAbs().maxCoeff());
    armed = session.port->period().judgement.memory.phase == SafetyPhase::kActive;
    before = at;
  };
  session.patience_ns = session.sides.now_ns() + 8 * TwoSides::kS;
  Result<void> went;
  try {
    went = session.guide->go_to(kStartTip + Vector3d(0.02, -0.02, 0));
    episode.armed = true;
  } catch (const Error&) {  // the network is too bad to become ready
    return episode;
  }
  if (went) went = session.guide->go_to(kStartTip);
  if (went) went = session.follow_circle(500);
  episode.stop = session.port->period().judgement.memory.stop.reason;
  if (!went) episode.told = went.error();
  episode.goals = static_cast<int>(session.sides.gateway_link.sent.size());
  return episode;
}

TEST(FirstSession, LostCommandsAreNeverJumps) {
  const Episode healthy = run_episode(0, 1);
  EXPECT_EQ(healthy.told, "");
  EXPECT_LE(healthy.longest_step, 0.0005 + 1e-9);
  EXPECT_GT(healthy.goals, 550);
  double longest = 0;
  int whole = 0;
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    const Episode lossy = run_episode(0.1, seed);
    longest = std::max(longest, lossy.longest_step);
    whole += lossy.told.empty() ? 1 : 0;
    EXPECT_THAT(lossy.told, testing::AnyOf(testing::IsEmpty(), HasSubstr("lost"))) << seed;
  }
  EXPECT_GE(whole, 4);
  EXPECT_LE(longest, 0.001 + 1e-9);
  EXPECT_GT(longest, 0.0006) << "or nothing was lost";
  RecordProperty("longest_step_um_at_10_percent", static_cast<int>(1e6 * longest));
  longest = 0;
  int armed = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    const Episode lossy = run_episode(0.4, seed);
    longest = std::max(longest, lossy.longest_step);
    if (!lossy.armed) continue;
    ++armed;
    EXPECT_THAT(lossy.told, testing::AnyOf(HasSubstr("lost"), HasSubstr("loses"))) << seed;
    EXPECT_NE(lossy.stop, StopReason::kJump) << seed;
  }
  EXPECT_GE(armed, 10);
  EXPECT_LE(longest, 0.001 + 1e-9);
  RecordProperty("longest_step_um_at_40_percent", static_cast<int>(1e6 * longest));
  RecordProperty("armed_of_40_at_40_percent", armed);
}

TEST(FirstSession, ARobotThatNoLongerListensIsToldAsLostCommands) {
  Session session;
  ASSERT_TRUE(session.guide->go_to(kStartTip));
  ASSERT_TRUE(session.follow_circle(20));
  session.sides.deaf = true;
  const std::int64_t since_ns = session.sides.now_ns();
  const Result<void> went = session.follow_circle(100);
  ASSERT_FALSE(went);
  EXPECT_EQ(session.port->period().judgement.memory.stop.reason, StopReason::kCommandsLost);
  EXPECT_LE(session.sides.now_ns() - since_ns, 260 * TwoSides::kMs);
}

TEST(FirstSession, ARobotThatWasStartedAnewIsFollowedAfterTheOperatorsKey) {
  Session session;
  ASSERT_TRUE(session.guide->go_to(kStartTip));
  session.sides.restart();
  ASSERT_FALSE(session.follow_circle(100));
  session.sides.bring_to(joints_for_tip(session.setup.mount, kStartTip).value());
  for (int k = 0; k < 10; ++k) session.port->exchange({});
  const Period& stopped = session.port->period();
  ASSERT_EQ(stopped.judgement.memory.phase, SafetyPhase::kStopped);
  EXPECT_EQ(stopped.robot.source.port, 40000) << "not without being asked";
  const std::string told = describe({StopReason::kForeignSource, 1, 0, -1}, stopped.robot);
  EXPECT_THAT(told, HasSubstr("127.0.0.1:40001"));
  EXPECT_THAT(told, HasSubstr("press k"));
  session.events.acknowledge_ns = session.sides.now_ns();
  const Result<void> went = session.guide->go_to(kStartTip);
  ASSERT_TRUE(went) << went.error();
  EXPECT_EQ(session.port->period().robot.source.port, 40001);
  session.step = 0;
  EXPECT_TRUE(session.follow_circle(50));
}

/// Joints of an arm that somebody carried, its wrist straight and its roll as it was left, whose
/// tip is at p_WT.
PsmJoints carried_to(const ToolMount& mount, const Vector3d& p_WT, double roll) {
  const Vector3d p_RT = mount.X_WR.inverse() * p_WT;
  const PsmInstrument& instrument = *mount.instrument;
  const double insertion =
      p_RT.norm() - mount.tip_offset - instrument.pitch_to_yaw + 0.4318 - instrument.tool_length;
  return {
      std::atan2(p_RT.x(), -p_RT.z()), -std::asin(p_RT.y() / p_RT.norm()), insertion, roll, 0, 0};
}

TEST(FirstSession, AToolThatWasCarriedInAsItWasHomedReachesTheStartOrIsToldBeforeArming) {
  int reached = 0, told = 0;
  const Vector3d box_middle(-0.0112, 0.0165, 0.06);
  for (const Vector3d& from :
       {box_middle, Vector3d(0.03, -0.04, 0.03), Vector3d(-0.05, 0.06, 0.05)}) {
    for (const double roll : {-2.6, -1.57, -0.5, 0.0, 1.57, 2.6}) {
      Session session;
      session.sides.console_servo(carried_to(session.setup.mount, from, roll));
      session.patience_ns = session.sides.now_ns() + 2 * TwoSides::kS;
      try {
        const Result<void> went = session.guide->go_to(kStartTip);
        ASSERT_TRUE(went) << "roll " << roll << ": " << went.error();
        EXPECT_LT((session.tip() - kStartTip).norm(), 1e-3);
        ++reached;
      } catch (const Error& error) {
        EXPECT_THAT(error.what(), HasSubstr("at the console turn")) << roll;
        EXPECT_TRUE(session.sides.gateway_link.sent.empty());
        ++told;
      }
    }
  }
  EXPECT_EQ(reached + told, 18);
  RecordProperty("reached_of_18", reached);
  EXPECT_GE(reached, 12);
}

/// What keeps a gateway from being armed whose tool was carried there.
std::string told_before_arming(const PsmJoints& carried, const Vector3d& start) {
  Session session;
  session.sides.console_servo(carried);
  session.patience_ns = session.sides.now_ns() + TwoSides::kS;
  try {
    (void)session.guide->go_to(start);
  } catch (const Error& error) {
    EXPECT_TRUE(session.sides.gateway_link.sent.empty());
    return error.what();
  }
  return "armed";
}

TEST(FirstSession, NoWayToTheStartIsToldBeforeArmingWithTheJointToTurn) {
  const ToolMount mount = test::paper_mount();
  // A roll that is nearly at its limit cannot be turned on to the orientation of the scene.
  const Vector3d middle(-0.0112, 0.0165, 0.06);
  for (const double roll : {-4.4, 4.4}) {
    EXPECT_THAT(told_before_arming(carried_to(mount, middle, roll), kStartTip),
                HasSubstr("at the console turn roll from"));
  }
  // A start that no tool reaches is none.
  EXPECT_THAT(told_before_arming(joints_for_tip(mount, kStartTip).value(), {-0.0914, 0.11, 0.002}),
              HasSubstr("joint"));
}

TEST(FirstSession, ADryRunRehearsesTheWholeEpisodeAndSendsNothing) {
  Session session({}, Eigen::Isometry3d::Identity(), 1, true);
  const Vector3d stood = session.tip();
  Result<void> went = session.guide->go_to(kStartTip + Vector3d(0.01, -0.01, 0));
  if (went) went = session.guide->go_to(kStartTip);
  if (went) went = session.follow_circle(100);
  ASSERT_TRUE(went) << went.error();
  EXPECT_TRUE(session.port->period().dry_run);
  EXPECT_TRUE(session.sides.gateway_link.sent.empty());
  EXPECT_EQ(session.tip(), stood);
  EXPECT_GT((session.guide->measured_tip() - stood).norm(), 0.005) << "the model moves";
}

// ---------------------------------------------------------------------------------------------
// What the operator reads

/// What the screen prints of these periods.
std::string shown(OperatorScreen& screen, const std::vector<Period>& periods) {
  testing::internal::CaptureStdout();
  for (const Period& period : periods) screen.on_period(period);
  return testing::internal::GetCapturedStdout();
}

Period of_phase(SafetyPhase phase, const Finding& finding = {}) {
  Period period;
  period.judgement.memory.phase = phase;
  period.judgement.memory.stop = period.judgement.finding = finding;
  return period;
}

TEST(OperatorScreenLines, ADryRunSaysThatNothingIsSent) {
  OperatorScreen screen(false);
  std::vector<Period> periods = {of_phase(SafetyPhase::kReady), of_phase(SafetyPhase::kActive)};
  for (Period& period : periods) period.dry_run = true;
  EXPECT_THAT(shown(screen, periods), HasSubstr("dry run, nothing is sent to the robot: press a"));
  OperatorScreen other(false);
  for (Period& period : periods) period.dry_run = false;
  EXPECT_THAT(shown(other, periods), testing::Not(HasSubstr("dry run")));
}

TEST(OperatorScreenLines, ANormalEndIsNoStop) {
  const Finding asked{StopReason::kOperatorStop, 0, 0, -1};
  OperatorScreen stopped(false), ended(false);
  const std::vector<Period> periods = {of_phase(SafetyPhase::kStopped, asked)};
  EXPECT_THAT(shown(stopped, periods), HasSubstr("stopped: the operator stopped"));
  ended.end_follows();
  EXPECT_EQ(shown(ended, periods), "");
  // Of whatever else the operator reads.
  OperatorScreen fault(false);
  fault.end_follows();
  EXPECT_THAT(shown(fault, {of_phase(SafetyPhase::kStopped, {StopReason::kFault, 0, 0, -1})}),
              HasSubstr("FAULT"));
}

TEST(OperatorScreenLines, ARestartOnAnotherPortIsToldOnceWithTheKey) {
  OperatorScreen screen(false);
  Period silent = of_phase(SafetyPhase::kStopped, {StopReason::kStale, 0.05, 0.02, -1});
  silent.robot.has_source = true;
  silent.robot.source = {0x7f000001, 40000};
  silent.robot.source_ns = 1;
  EXPECT_THAT(shown(screen, {silent}), HasSubstr("nothing came from the robot"));
  Period moved = silent;
  moved.judgement.finding = {};
  moved.robot.foreign = 10;
  moved.robot.foreign_source = {0x7f000001, 40001};
  moved.robot.foreign_ns = 600'000'000;
  EXPECT_THAT(shown(screen, {moved, moved}), HasSubstr("press k to follow it"));
  EXPECT_EQ(shown(screen, {moved}), "");
}

TEST(CheckReport, TellsABusyComputerOfTheRobotFromALateNetwork) {
  RobotState robot;
  StreamRates rates;
  robot.measured_js.seen = robot.measured_cp.seen = true;
  const auto arrive = [&](std::int64_t joints_ms, std::int64_t pose_ms, double pose_stamp_s) {
    Period period;
    robot.measured_js.arrival_ns = joints_ms * 1'000'000;
    robot.measured_js.payload.timestamp_s = 1e-3 * static_cast<double>(joints_ms);
    robot.measured_cp.arrival_ns = pose_ms * 1'000'000;
    robot.measured_cp.payload.timestamp_s = pose_stamp_s;
    period.robot = robot;
    rates.add(period);
  };
  arrive(1000, 1000, 1.0);
  arrive(1010, 1010, 1.01);
  arrive(1110, 1110, 1.02);  // joints stamped late, too; the pose was only late on its way
  const std::string table = rates.table(robot);
  EXPECT_THAT(table, HasSubstr("longest gap 100.0 ms (100.0 ms on the robot's clock: the robot's "
                               "computer was busy)"));
  EXPECT_THAT(table, HasSubstr("longest gap 100.0 ms (10.0 ms on the robot's clock: late on the "
                               "network, or this computer was busy)"));
}

TEST(CheckReport, NamesTheBaseFrameThatFitsAndOneInstrumentWhateverTheTimestamps) {
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();
  X_AR.linear() = Eigen::AngleAxisd(0.8, Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  X_AR.translation() = Vector3d(0.3, -0.2, 0.1);
  const SafetySetup setup =
      make_safety_setup({}, test::paper_mount(), Eigen::Isometry3d::Identity(), false);
  test::IdealRobot robot(large_needle_driver(), X_AR,
                         joints_for_tip(setup.mount, kStartTip).value());
  RobotReport report(setup, nullptr);
  Period period;
  robot.report(1, 1.0);
  period.robot = robot.state;
  report.on_period(period);
  // Joints of another moment: they say nothing of the instrument.
  period.robot.measured_js.payload.timestamp_s += 0.001;
  period.robot.measured_js.payload.position[2] += 0.01;
  report.on_period(period);
  const std::string text = report.text();
  EXPECT_THAT(text, HasSubstr("large_needle_driver, kinematics agree"));
  const std::size_t at = text.find("--base-frame ") + 13;
  const Eigen::Isometry3d fits = parse_base_frame(text.substr(at, text.find(' ', at) - at));
  EXPECT_TRUE(fits.isApprox(X_AR, 1e-7)) << text;
}

}  // namespace
}  // namespace omentum
