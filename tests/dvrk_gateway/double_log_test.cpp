// The double against the recorded session of a robot.
#include <gtest/gtest.h>

#include <tuple>

#include "tests/dvrk_gateway/double_session.h"
#include "tests/support/wire_log.h"

namespace omentum {
namespace {

using test::DoubleSession;

/// State, sub-state, busy, homed.
using Condition = std::tuple<OperatingState::State, std::string, bool, bool>;

Condition condition_of(const OperatingState& state) {
  return {state.state, state.sub_state.data(), state.is_busy, state.is_homed};
}

/// What a client has heard so far, and the changes of the operating state with their Timestamps.
struct Heard {
  RobotState state;
  std::vector<Condition> conditions;
  std::vector<double> since_s;

  void hear(const std::string& text) {
    const auto said = decode_robot(text);
    ASSERT_TRUE(said) << text;
    take_datagram(state, text, 0, test::kRobot);
    if (!said->operating_state) return;
    const Condition now = condition_of(*said->operating_state);
    if (!conditions.empty() && conditions.back() == now) return;
    conditions.push_back(now);
    since_s.push_back(said->operating_state->timestamp_s);
  }
  std::vector<double> busy_s() const {
    std::vector<double> durations;
    for (std::size_t k = 0; k + 1 < conditions.size(); ++k) {
      if (std::get<2>(conditions[k]) && std::get<1>(conditions[k]) == "HOMED")
        durations.push_back(since_s[k + 1] - since_s[k]);
    }
    return durations;
  }
};

TEST(DoubleAgainstTheLog, AnswersTheRecordedClientAsTheRobotDid) {
  const auto lines = test::read_wire_log();
  if (lines.empty()) GTEST_SKIP() << "no dvrk_wire in OMENTUM_REAL_DATA";
  DoubleOptions options;
  options.home_at_s = 0.895;
  DoubleSession session(options);
  Heard robot;
  Heard twin;
  std::size_t heard = 0;
  const auto run_to = [&](double time_s) {
    session.run_to(time_s);
    for (; heard < session.link.sent.size(); ++heard) twin.hear(session.link.sent[heard].text);
  };

  int commands = 0;
  int compared = 0;
  bool moved = false;
  for (const test::WireLine& line : lines) {
    if (!line.sent) {
      robot.hear(line.datagram);
      continue;
    }
    ++commands;
    run_to(line.time_s);
    session.link.deliver(static_cast<std::int64_t>(line.time_s * 1e9), line.datagram,
                         test::kClient);
    const bool busy = robot.state.operating_state.payload.is_busy;
    EXPECT_EQ(condition_of(twin.state.operating_state.payload),
              condition_of(robot.state.operating_state.payload))
        << line.number;
    if (!busy) {
      ++compared;
      // Ends of moves come from the robot's iterative inverse.
      const double tolerance = moved ? 1e-6 : 1e-9;
      for (std::size_t j = 0; j < 6; ++j) {
        EXPECT_NEAR(twin.state.setpoint_js.payload.position[j],
                    robot.state.setpoint_js.payload.position[j], tolerance)
            << line.number << " joint " << j;
      }
      EXPECT_LT(
          (twin.state.setpoint_cp.payload.translation - robot.state.setpoint_cp.payload.translation)
              .norm(),
          tolerance)
          << line.number;
      EXPECT_LT((twin.state.setpoint_cp.payload.rotation - robot.state.setpoint_cp.payload.rotation)
                    .cwiseAbs()
                    .maxCoeff(),
                tolerance)
          << line.number;
      // After the fault the jaw of the robot reads what no command asked for.
      if (robot.state.operating_state.payload.state != OperatingState::State::kFault) {
        EXPECT_NEAR(twin.state.jaw_setpoint_js.payload.position[0],
                    robot.state.jaw_setpoint_js.payload.position[0], tolerance)
            << line.number;
      }
    }
    if (line.datagram.find("\"move_") != std::string::npos) moved = true;
    if (line.datagram.find("\"servo_") != std::string::npos) moved = false;
  }
  run_to(lines.back().time_s);
  EXPECT_EQ(commands, 57);
  EXPECT_EQ(compared, 56);

  EXPECT_EQ(twin.conditions, robot.conditions);
  const std::vector<double> expected = robot.busy_s();
  const std::vector<double> found = twin.busy_s();
  ASSERT_EQ(found.size(), expected.size());
  ASSERT_EQ(found.size(), 3u);
  for (std::size_t k = 0; k < 2; ++k) EXPECT_NEAR(found[k], expected[k], 0.02);
  for (const auto& datagram : session.link.sent) EXPECT_LE(datagram.text.size(), 640u);
}

TEST(DoubleAgainstTheLog, SendsTheRecordedNumberOfEvents) {
  DoubleSession session;
  session.run_for(0.01);
  session.robot.arm().home();
  std::vector<std::size_t> events;
  for (int k = 0; k < 160; ++k) {
    const std::size_t before = session.link.sent.size();
    session.run_for(0.01);
    if (session.link.sent.size() - before > 8)
      events.push_back(session.link.sent.size() - before - 8);
  }
  EXPECT_EQ(events, (std::vector<std::size_t>{8, 12}));
}

}  // namespace
}  // namespace omentum
