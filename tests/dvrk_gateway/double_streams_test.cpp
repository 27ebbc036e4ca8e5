// Order and timing of the double's streams, its life cycle and its switches.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/check.h"
#include "dvrk_gateway/dvrk_double/disturbed_link.h"
#include "tests/dvrk_gateway/double_session.h"

namespace omentum {
namespace {

using test::DoubleSession;
using test::jaw_servo_jp;
using test::kClient;
using test::servo_jp;
using testing::ElementsAreArray;
using State = OperatingState::State;

/// Names of the streams of the last period.
std::vector<std::string> last_burst(const DoubleSession& session) {
  std::vector<std::string> names;
  for (const auto& datagram : session.link.sent) {
    if (datagram.time_ns == session.clock.time_ns)
      names.push_back(datagram.text.substr(2, datagram.text.find('"', 2) - 2));
  }
  return names;
}

TEST(DoubleStreams, SpeakFirstInAlphabeticalOrderEvery10Ms) {
  DoubleSession session;
  session.run_for(0.01);
  EXPECT_THAT(last_burst(session), ElementsAreArray(kStreamNames));
  EXPECT_TRUE(std::is_sorted(kStreamNames.begin(), kStreamNames.end()));
  session.run_for(1);
  EXPECT_THAT(last_burst(session), ElementsAreArray(kStreamNames));
  for (std::size_t k = 0; k < session.link.sent.size(); ++k)
    EXPECT_EQ(session.link.sent[k].time_ns, static_cast<std::int64_t>(k / 8) * 10'000'000);
  EXPECT_EQ(session.state.malformed + session.state.unknown_keys, 0u);
}

TEST(DoubleStreams, TimestampsAdvanceByThePeriod) {
  DoubleSession session;
  session.home();
  double before_s = session.state.measured_js.payload.timestamp_s;
  for (int k = 0; k < 100; ++k) {
    session.run_for(0.01);
    const double now_s = session.state.measured_js.payload.timestamp_s;
    EXPECT_NEAR(now_s - before_s, 0.01, 1e-12);
    EXPECT_EQ(session.state.measured_cp.payload.timestamp_s, now_s);
    before_s = now_s;
  }
}

TEST(DoubleStreams, EventsComeBeforeTheStreams) {
  DoubleSession session;
  session.home();
  session.robot.arm().fault();
  session.run_for(0.01);
  std::vector<std::string> expected(4, "operating_state");
  expected.insert(expected.end(), kStreamNames.begin(), kStreamNames.end());
  EXPECT_THAT(last_burst(session), ElementsAreArray(expected));
}

TEST(DoubleLifeCycle, BeforeHomingEverythingIsEmptyAndInvalid) {
  DoubleSession session;
  session.run_for(0.5);
  EXPECT_EQ(session.operating().state, State::kEnabled);
  EXPECT_STREQ(session.operating().sub_state.data(), "ENABLED");
  EXPECT_FALSE(session.operating().is_homed);
  for (const auto* joints : {&session.state.measured_js, &session.state.setpoint_js,
                             &session.state.jaw_measured_js, &session.state.jaw_setpoint_js}) {
    EXPECT_TRUE(joints->seen);
    EXPECT_EQ(joints->payload, JointState{});
  }
  for (const auto* pose :
       {&session.state.measured_cp, &session.state.setpoint_cp, &session.state.local_measured_cp}) {
    EXPECT_TRUE(pose->seen);
    EXPECT_EQ(pose->payload, CartesianPose{});
  }
}

TEST(DoubleLifeCycle, SevenJointsWhileHomingThenSixAndTheJaw) {
  DoubleSession session;
  session.run_for(0.01);
  session.robot.arm().home();
  session.run_for(0.1);
  EXPECT_TRUE(session.operating().is_homed);
  EXPECT_TRUE(session.operating().is_busy);
  EXPECT_STREQ(session.operating().sub_state.data(), "HOMING");
  EXPECT_EQ(session.state.measured_js.payload.count, 7);
  EXPECT_TRUE(session.state.measured_js.payload.valid);
  EXPECT_EQ(session.state.jaw_measured_js.payload.count, 0);
  EXPECT_FALSE(session.state.measured_cp.payload.valid);
  session.run_for(1.4);
  EXPECT_STREQ(session.operating().sub_state.data(), "HOMED");
  EXPECT_FALSE(session.operating().is_busy);
  EXPECT_EQ(session.state.measured_js.payload.count, 6);
  EXPECT_EQ(session.state.jaw_measured_js.payload.count, 1);
  EXPECT_EQ(session.state.jaw_setpoint_js.payload.velocity_count, 0);
  EXPECT_NEAR(session.state.measured_cp.payload.translation.z(), -0.1135, 1e-9);
}

TEST(DoubleLifeCycle, CommandsBeforeTheToolAreIgnored) {
  DoubleSession session;
  session.run_for(0.01);
  session.robot.arm().home();
  session.run_for(0.5);
  session.say(servo_jp({0.1, 0, 0.12, 0, 0, 0}));
  session.run_for(1.5);
  EXPECT_EQ(session.joints()[0], 0);
  EXPECT_EQ(session.refusals(Refusal::kNotReady), 1u);
}

TEST(DoubleLifeCycle, LikeHardwareItStartsDisabledAndHomesInPlace) {
  DoubleOptions options;
  options.hardware_like = true;
  DoubleSession session(options);
  session.run_for(0.05);
  EXPECT_EQ(session.operating().state, State::kDisabled);
  session.robot.arm().home();  // refused while DISABLED
  session.run_for(0.05);
  EXPECT_EQ(session.operating().state, State::kDisabled);
  session.home();
  EXPECT_EQ(session.operating().state, State::kEnabled);
  EXPECT_EQ(session.joints()[2], 0.02);
}

TEST(DoubleLifeCycle, OperatorRecoversFromTheNewSetpoint) {
  DoubleSession session;
  session.home();
  session.say(servo_jp({0.6, 0, 0.12, 0, 0, 0}));
  session.run_for(0.02);
  ASSERT_EQ(session.operating().state, State::kFault);
  session.robot.arm().recover();
  session.run_for(0.01);
  EXPECT_EQ(session.operating().state, State::kEnabled);
  EXPECT_EQ(session.joints()[0], session.state.measured_js.payload.position[0]);
  session.say(servo_jp({0.5, 0, 0.12, 0, 0, 0}));
  session.run_for(0.02);
  EXPECT_EQ(session.joints()[0], 0.5);
}

TEST(DoubleLifeCycle, PausedAndDisabledArmsTakeNoCommands) {
  for (const bool paused : {true, false}) {
    DoubleSession session;
    session.home();
    paused ? session.robot.arm().pause() : session.robot.arm().disable();
    session.run_for(0.01);
    EXPECT_EQ(session.operating().state, paused ? State::kPaused : State::kDisabled);
    session.say(servo_jp({0.1, 0, 0.12, 0, 0, 0}));
    session.run_for(0.02);
    EXPECT_EQ(session.joints()[0], 0);
    paused ? session.robot.arm().recover() : session.robot.arm().power();
    session.run_for(0.01);
    EXPECT_EQ(session.operating().state, State::kEnabled);
  }
}

TEST(DoubleInstruments, PosesAndLimitsAreThoseOfTheInstrument) {
  for (const PsmInstrument& instrument : psm_instruments()) {
    ToolMount mount = test::plain_mount();
    mount.instrument = &instrument;
    DoubleSession session({}, {}, mount);
    session.home();
    session.say(servo_jp({0.1, 0.2, 0.15, 0.3, 0.4, -0.5}));
    session.run_for(0.02);
    PsmJoints q{};
    std::copy_n(session.setpoint().position.begin(), 6, q.begin());
    EXPECT_EQ(q[5], -0.5) << instrument.name;
    const CartesianPose& pose = session.state.local_measured_cp.payload;
    EXPECT_TRUE(check_instrument(q, {pose.rotation, pose.translation}, instrument));
    const bool alike = instrument.tool_length == large_needle_driver().tool_length &&
                       instrument.pitch_to_yaw == large_needle_driver().pitch_to_yaw;
    EXPECT_EQ(
        check_instrument(q, {pose.rotation, pose.translation}, large_needle_driver()).has_value(),
        alike)
        << instrument.name;
    for (int k = 1; k <= 20; ++k) {
      session.say(jaw_servo_jp(-0.05 * k));
      session.run_for(0.02);
    }
    EXPECT_EQ(session.jaw(), instrument.jaw.min) << instrument.name;
  }
}

TEST(DoubleReceiver, LastSetpointOfAPeriodWins) {
  DoubleSession session;
  session.home();
  session.say(servo_jp({0.1, 0, 0.12, 0, 0, 0}));
  session.say(servo_jp({0.2, 0, 0.12, 0, 0, 0}));
  session.run_for(0.02);
  EXPECT_EQ(session.joints()[0], 0.2);
}

TEST(DoubleReceiver, KeysOfOneDatagramRunInAlphabeticalOrder) {
  DoubleSession session;
  session.home();
  // The text has servo_jp first; it runs last, after hold and move_jp, and ends the move.
  session.say(R"({"servo_jp":{"Goal":[0.1,0,0.12,0,0,0]},"move_jp":{"Goal":[0,0,0.2,0,0,0]},)"
              R"("hold":""})");
  session.run_for(0.02);
  EXPECT_FALSE(session.operating().is_busy);
  EXPECT_EQ(session.joints()[0], 0.1);
}

TEST(DoubleReceiver, OfLongDatagramsTheFirst1024BytesAreRun) {
  DoubleSession session;
  session.home();
  std::string text = R"({"servo_jp":{"Goal":[0.1,0,0.12,0,0,0]},"x":")";
  text.append(1100, 'x');
  text += R"("})";
  session.say(text);
  session.run_for(0.02);
  EXPECT_EQ(session.joints()[0], 0.1);
  EXPECT_EQ(session.robot.cut(), 1u);
  EXPECT_EQ(session.refusals(Refusal::kNotJson), 1u);
}

TEST(DoubleReceiver, EmptyDatagramEndsThePeriod) {
  DoubleSession session;
  session.home();
  session.say("");
  session.say(servo_jp({0.1, 0, 0.12, 0, 0, 0}));
  session.run_for(0.02);
  EXPECT_EQ(session.joints()[0], 0);
  session.run_for(0.01);
  EXPECT_EQ(session.joints()[0], 0.1);
}

TEST(DoubleReceiver, GarbageRunsTheCommandBeforeItAgain) {
  DoubleSession session;
  session.home();
  session.say(servo_jp({0.1, 0, 0.12}));  // too short, which is counted each time
  session.say("garbage");
  session.run_for(0.02);
  EXPECT_EQ(session.refusals(Refusal::kGoal), 2u);
  session.say("garbage");  // of another period: nothing is kept
  session.run_for(0.02);
  EXPECT_EQ(session.refusals(Refusal::kGoal), 2u);
  EXPECT_EQ(session.refusals(Refusal::kNotJson), 2u);
}

TEST(DoubleReceiver, LastSenderOwnsTheStream) {
  DoubleSession session;
  session.home();
  const UdpAddress thief{0x7f000001, 50000};
  session.link.deliver(session.clock.time_ns + 1, "{}", thief);
  session.run_for(0.02);
  EXPECT_EQ(session.link.sent.back().address, thief);
  session.say(R"({"hold":""})");
  session.run_for(0.02);
  EXPECT_EQ(session.link.sent.back().address, kClient);
}

TEST(DoubleSwitches, StreamsCanBeMissingInvalidOrNotFinite) {
  for (const std::string_view name : kStreamNames) {
    DoubleOptions options;
    options.missing_stream = name;
    DoubleSession missing(options);
    missing.home();
    EXPECT_THAT(last_burst(missing), testing::Not(testing::Contains(std::string(name))));
    EXPECT_EQ(last_burst(missing).size(), 7u);
  }
  DoubleOptions options;
  options.invalid_stream = "measured_cp";
  DoubleSession invalid(options);
  invalid.home();
  EXPECT_FALSE(invalid.state.measured_cp.payload.valid);
  EXPECT_TRUE(invalid.state.local_measured_cp.payload.valid);
  options = {};
  options.not_finite_stream = "measured_js";
  DoubleSession not_finite(options);
  not_finite.home();
  EXPECT_FALSE(not_finite.state.measured_js.payload.valid);
  EXPECT_GT(not_finite.state.not_finite, 0u);
  EXPECT_EQ(not_finite.state.malformed, 0u);
  options = {};
  options.missing_stream = "no_such_stream";
  EXPECT_THROW(DoubleSession{options}, Error);
}

TEST(DoubleSwitches, OlderShapesAreUnderstood) {
  DoubleOptions options;
  options.shape = DoubleOptions::Shape::k2019;
  DoubleSession old(options);
  old.home();
  EXPECT_TRUE(old.state.old_shapes_only);
  EXPECT_EQ(old.state.measured_js.payload.position[2], 0.12);
  EXPECT_FALSE(old.state.operating_state.seen);
  EXPECT_EQ(old.state.malformed, 0u);
  options.shape = DoubleOptions::Shape::kAllInOne;
  DoubleSession one(options);
  one.home();
  EXPECT_FALSE(one.state.old_shapes_only);
  EXPECT_EQ(one.state.malformed, 0u);
  EXPECT_STREQ(one.operating().sub_state.data(), "HOMED");
  EXPECT_EQ(one.link.sent.size(), static_cast<std::size_t>(one.next_ns / 10'000'000));
}

TEST(DoubleSwitches, SilenceAndNewTimestampsAreSeen) {
  DoubleSession session;
  session.home();
  session.robot.set_silent(true);
  const std::size_t sent = session.link.sent.size();
  session.run_for(0.1);
  EXPECT_EQ(session.link.sent.size(), sent);
  session.robot.set_silent(false);
  session.robot.restart_timestamps();
  session.run_for(0.01);
  EXPECT_GT(session.state.restarts, 0u);
  EXPECT_LT(session.state.measured_js.payload.timestamp_s, 0.02);
}

/// Sends numbers every 10 ms for 10 s through a network, returns what arrived.
std::vector<int> pass(const Disturbance& out, std::uint64_t seed, double* latest_s = nullptr) {
  test::ScriptClock clock;
  test::ScriptLink under(clock);
  DisturbedLink network(under, clock, out, {}, seed);
  for (int k = 0; k < 11'000; ++k) {
    clock.time_ns = k * 1'000'000LL;
    if (k < 10'000 && k % 10 == 0) network.send(std::to_string(k / 10), kClient);
    network.flush();
  }
  std::vector<int> arrived;
  for (const auto& datagram : under.sent) {
    arrived.push_back(std::stoi(datagram.text));
    const double late_s =
        1e-9 * static_cast<double>(datagram.time_ns - arrived.back() * 10'000'000LL);
    if (latest_s != nullptr) *latest_s = std::max(*latest_s, late_s);
  }
  return arrived;
}

TEST(DisturbedLink, WithoutDisturbanceEverythingPassesAtOnce) {
  double latest_s = 0;
  const std::vector<int> arrived = pass({}, 1, &latest_s);
  EXPECT_EQ(arrived.size(), 1000u);
  EXPECT_TRUE(std::is_sorted(arrived.begin(), arrived.end()));
  EXPECT_EQ(latest_s, 0);
}

TEST(DisturbedLink, LosesAndRepeatsItsShare) {
  Disturbance some;
  some.loss = 0.1;
  EXPECT_NEAR(static_cast<double>(pass(some, 1).size()), 900, 40);  // 4 standard deviations
  some = {};
  some.duplication = 0.1;
  EXPECT_NEAR(static_cast<double>(pass(some, 1).size()), 1100, 40);
}

TEST(DisturbedLink, DelaysJittersAndReorders) {
  Disturbance some;
  some.delay_s = 0.02;
  some.jitter_s = 0.005;
  double latest_s = 0;
  std::vector<int> arrived = pass(some, 1, &latest_s);
  EXPECT_EQ(arrived.size(), 1000u);
  EXPECT_TRUE(std::is_sorted(arrived.begin(), arrived.end()));
  EXPECT_GT(latest_s, 0.02);
  EXPECT_LE(latest_s, 0.0251 + 0.001);  // flushed every millisecond
  some = {};
  some.reordering = 0.2;
  arrived = pass(some, 1);
  EXPECT_EQ(arrived.size(), 1000u);
  EXPECT_FALSE(std::is_sorted(arrived.begin(), arrived.end()));
}

TEST(DisturbedLink, SameSeedSameFate) {
  Disturbance some;
  some.loss = 0.1;
  some.duplication = 0.1;
  some.reordering = 0.1;
  EXPECT_EQ(pass(some, 7), pass(some, 7));
  EXPECT_NE(pass(some, 7), pass(some, 8));
}

TEST(DisturbedLink, DisturbsWhatIsReceivedToo) {
  test::ScriptClock clock;
  test::ScriptLink under(clock);
  Disturbance in;
  in.delay_s = 0.02;
  DisturbedLink network(under, clock, {}, in, 1);
  under.deliver(0, "late", kClient);
  std::array<char, 3> memory{};
  EXPECT_FALSE(network.receive(memory));
  clock.time_ns = 20'000'000;
  const auto received = network.receive(memory);
  ASSERT_TRUE(received);
  EXPECT_EQ(received->size, 3u);
  EXPECT_TRUE(received->cut);
  EXPECT_EQ(received->source, kClient);
}

}  // namespace
}  // namespace omentum
