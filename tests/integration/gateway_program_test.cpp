// What the program dvrk_gateway says to a user who gives it something wrong, or whose robot is not
// as it should be.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "core/clock.h"
#include "core/utc_time.h"
#include "dvrk_gateway/protocol/codec.h"
#include "dvrk_gateway/protocol/udp_socket.h"
#include "tests/integration/programs.h"
#include "tests/integration/robot_touches.h"

namespace omentum {
namespace {

using test::Programs;
using test::Strings;
using test::operator+;
using testing::HasSubstr;

/// One trained policy and a registration for all of these tests.
class GatewayProgram : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    programs_ = new Programs;
    programs_->train("done", test::tiny_task());
  }
  static void TearDownTestSuite() { delete std::exchange(programs_, nullptr); }

  static std::string file(const std::string& name, const std::string& text) {
    const std::string path = programs_->folder() / name;
    std::ofstream(path) << text;
    return path;
  }
  /// Registers by touches of which one is off by that [m]; what the program printed.
  static test::Finished register_robot(const std::string& registration, double error = 0) {
    return programs_->finish(policy() + Strings{"--registration", registration, "register",
                                                "--touches",
                                                file("touches.csv", test::robot_touches(error))});
  }
  static Strings policy() { return {OMENTUM_DVRK_GATEWAY, "--policy", programs_->run_dir("done")}; }
  static std::string free_port() { return "127.0.0.1:" + std::to_string(UdpSocket(0).port()); }
  static std::string refused(Strings options) {
    const auto add = [&](const std::string& option, const std::string& value) {
      if (std::find(options.begin(), options.end(), option) == options.end())
        options = options + Strings{option, value};
    };
    add("--robot", free_port());
    add("--record", "none");
    const test::Finished finished = programs_->finish(policy() + options);
    EXPECT_EQ(finished.code, 2);
    EXPECT_EQ(test::lines_of(finished.err).size(), 1U) << finished.err;
    return finished.err;
  }

  static Programs* programs_;
};
Programs* GatewayProgram::programs_ = nullptr;

TEST_F(GatewayProgram, WhatCannotStartIsOneLineWithWhatToDoAndCode2) {
  const UdpSocket taken(0);
  const std::string port = std::to_string(taken.port());
  EXPECT_THAT(refused({"--robot", "127.0.0.1:" + port}),
              HasSubstr("UDP port " + port + " cannot be used"));
  EXPECT_THAT(refused({"--robot", "127.0.0.1"}), HasSubstr("--robot 127.0.0.1: HOST:PORT"));
  EXPECT_THAT(refused({"--robot", "127.0.0.1:70000"}), HasSubstr("the port 1 ... 65535"));
  EXPECT_THAT(refused({"--instrument", "scissors"}), HasSubstr("large_needle_driver"));
  EXPECT_THAT(refused({"--base-frame", "1,2"}), HasSubstr("--base-frame"));
  EXPECT_THAT(refused({"--limits", file("limits.txtpb", "step_m: 1\n")}), HasSubstr("step_m"));
  EXPECT_THAT(refused({"--limits", file("limits.txtpb", "period_s: 0.05\n")}),
              HasSubstr("the policy's control period is 0.02 s"));
  EXPECT_THAT(refused({"--record", "/dev/full"}), HasSubstr("/dev/full cannot be made"));
}

TEST_F(GatewayProgram, AModeNamesWhatItNeeds) {
  EXPECT_THAT(refused({"--mode", "teach"}), HasSubstr("see `register`"));
  EXPECT_THAT(refused({"--mode", "replay"}), HasSubstr("--motion: mode replay needs a recording"));
  const std::string fast = file("tool.csv",
                                "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m\n"
                                "0,0,0,0.05\n0.02,0,0.002,0.05\n");
  EXPECT_THAT(refused({"--mode", "replay", "--motion", fast}), HasSubstr("--slow 4.0 or more"));
}

TEST_F(GatewayProgram, ARegistrationThatDoesNotFitIsRefusedOrWarnedOf) {
  EXPECT_THAT(refused({"--registration", "nowhere.txtpb"}), HasSubstr("nowhere.txtpb"));
  const std::string good = programs_->folder() / "good.txtpb";
  EXPECT_EQ(register_robot(good).code, 0);
  EXPECT_THAT(refused({"--registration", good, "--instrument", "prograsp"}),
              HasSubstr("made with large_needle_driver, and --instrument is prograsp"));

  // Nobody sends: a check that hears nothing says what it thinks of the file all the same.
  const auto warned = [&](const std::string& registration) {
    return programs_->finish(policy() + Strings{"--robot", free_port(), "--registration",
                                                registration, "check", "--seconds", "0.5"});
  };
  EXPECT_THAT(warned(good).err, testing::Not(HasSubstr("registration: ")));
  const std::string poor = programs_->folder() / "poor.txtpb";
  EXPECT_EQ(register_robot(poor, 0.003).code, 0);
  EXPECT_THAT(warned(poor).err, HasSubstr("mm off and left out: touch it again"));
  std::string text = test::read_text(good);
  const std::size_t date = text.find("date: \"") + 7;
  const std::string two_days_ago = utc_text(wall_now_ns() - 48LL * 3600 * 1'000'000'000);
  text.replace(date, text.find('"', date) - date, two_days_ago);
  EXPECT_THAT(warned(file("old.txtpb", text)).err,
              HasSubstr("registration is 48.0 h old, allowed 24 h"));
}

/// A robot on a port of this machine, from when it speaks, or has homed, on.
class Speaking {
 public:
  Speaking(const Strings& options, bool homed) {
    UdpSocket socket(0);
    port_ = std::to_string(socket.port());
    robot_.emplace(Strings{OMENTUM_DVRK_DOUBLE, "--port", port_} + options);
    RobotState state;
    std::array<char, 65536> memory{};
    const bool spoke = test::eventually([&] {
      while (const auto got = socket.receive(memory))
        take_datagram(state, {memory.data(), got->size}, steady_now_ns(), got->source);
      const OperatingState& now = state.operating_state.payload;
      return homed ? now.is_homed && !now.is_busy && state.measured_cp.payload.valid
                   : state.has_source;
    });
    EXPECT_TRUE(spoke);
  }
  const std::string& port() const { return port_; }

 private:
  std::string port_;
  std::optional<test::Process> robot_;
};

TEST_F(GatewayProgram, CheckNamesWhatKeepsTheRobotFromBeingArmed) {
  const std::string registration = programs_->folder() / "check.txtpb";
  ASSERT_EQ(register_robot(registration).code, 0);
  struct Case {
    Strings robot;
    bool homed;
    const char* told;
  };
  const Case cases[] = {
      {{"--missing", "jaw/measured_js"},
       false,
       "stream jaw/measured_js was never received: add it"},
      {{"--shape", "2019"}, false, "install the streamer file of deploy/dvrk"},
      {{"--home-at", "-1"}, false, "the robot is not homed: home it at its console"},
      {{"--home-at", "0.1", "--hardware-like"}, true, "insert the instrument past the cannula"},
      {{"--home-at", "0.1", "--instrument", "prograsp"}, true, "another instrument or arm"},
  };
  for (const Case& c : cases) {
    const Speaking robot(c.robot, c.homed);
    const test::Finished finished = programs_->finish(
        policy() + Strings{"--robot", "127.0.0.1:" + robot.port(), "--registration", registration,
                           "check", "--seconds", "1"});
    EXPECT_EQ(finished.code, 1) << c.told;
    EXPECT_THAT(test::lines_of(finished.out).back(),
                testing::AllOf(testing::StartsWith("no go: "), HasSubstr(c.told)));
  }
  const Speaking robot({"--home-at", "0.1"}, true);
  const auto check = [&](const Strings& options) {
    return programs_->finish(policy() + Strings{"--robot", "127.0.0.1:" + robot.port()} + options +
                             Strings{"check", "--seconds", "1"});
  };
  EXPECT_THAT(check({}).out, HasSubstr("no go: no registration"));
  // A busy machine may keep the gateway from being ready in a second, but not for ever.
  test::Finished last;
  EXPECT_TRUE(test::eventually([&] {
    last = check({"--registration", registration});
    return last.code == 0 && test::lines_of(last.out).back() == "go";
  })) << last.out;
}

TEST_F(GatewayProgram, CheckOfAWrongPortSaysThatNothingCame) {
  const Speaking robot({"--home-at", "0.1"}, false);
  const std::uint16_t other = UdpSocket(0).port();
  const test::Finished finished =
      programs_->finish(policy() + Strings{"--robot", "127.0.0.1:" + std::to_string(other), "check",
                                           "--seconds", "0.5"});
  EXPECT_EQ(finished.code, 1);
  EXPECT_THAT(finished.out,
              HasSubstr("nothing was received\nno go: no datagram of a robot yet: does "
                        "its streamer send to this port?"));
}

}  // namespace
}  // namespace omentum
