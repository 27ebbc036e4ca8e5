// The program dvrk_double as a process, and the tissue under its jaw.
#include "dvrk_gateway/dvrk_double/double_program.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <fstream>
#include <sstream>
#include <thread>

#include "core/clock.h"
#include "core/config.h"
#include "core/constants.h"
#include "dvrk_gateway/protocol/udp_socket.h"
#include "tests/dvrk_gateway/double_session.h"
#include "tests/support/process.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using testing::HasSubstr;
using State = OperatingState::State;

constexpr double kPatience_s = 60;

std::string content_of(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

/// A client on a real socket.
struct Client {
  /// Listens until the condition holds; false when patience ends.
  template <typename Condition>
  bool listen_until(Condition&& holds) {
    const std::int64_t begin_ns = steady_now_ns();
    std::array<char, 4096> memory{};
    while (!holds()) {
      if (seconds_since(begin_ns) > kPatience_s) return false;
      pollfd waiting{socket.descriptor(), POLLIN, 0};
      poll(&waiting, 1, 1000);
      while (const auto received = socket.receive(memory)) {
        last_source = received->source;
        take_datagram(state, {memory.data(), received->size}, steady_now_ns(), received->source);
      }
    }
    return true;
  }
  bool listen_until_homed() {
    return listen_until([this] {
      const OperatingState& now = state.operating_state.payload;
      return now.is_homed && !now.is_busy && state.measured_cp.payload.valid;
    });
  }
  void say(const std::string& text) { socket.send(text, state.source); }
  std::string port() const { return std::to_string(socket.port()); }

  UdpSocket socket{0};
  RobotState state;
  UdpAddress last_source;
};

TEST(DoubleProgram, HomesByItselfAndTakesCommands) {
  Client client;
  test::Process robot({OMENTUM_DVRK_DOUBLE, "--port", client.port(), "--home-at", "0.1"});
  ASSERT_TRUE(client.listen_until_homed());
  client.say(test::servo_jp({0.1, 0.1, 0.15, 0.1, 0.1, 0.1}));
  EXPECT_TRUE(
      client.listen_until([&] { return client.state.setpoint_js.payload.position[2] == 0.15; }));
  EXPECT_EQ(client.state.foreign + client.state.malformed, 0u);
  robot.kill(SIGTERM);
  EXPECT_EQ(robot.wait(std::chrono::seconds(60)), 0);
}

TEST(DoubleProgram, ScriptOfTheOperatorIsFollowed) {
  Client client;
  test::Process robot({OMENTUM_DVRK_DOUBLE, "--port", client.port(), "--home-at", "0.1", "--at",
                       "2 fault", "--at", "2.5 recover", "--at", "3 foreign", "--seconds", "600"});
  const auto state = [&] { return client.state.operating_state.payload.state; };
  EXPECT_TRUE(client.listen_until([&] { return state() == State::kFault; }));
  EXPECT_TRUE(client.listen_until([&] { return state() == State::kEnabled; }));
  EXPECT_TRUE(client.listen_until([&] { return client.state.foreign > 0; }));
  EXPECT_NE(client.state.foreign_source, client.state.source);
}

TEST(DoubleProgram, SecondSenderStealsTheStreamUntilTheClientSpeaks) {
  Client client;
  test::Process robot(
      {OMENTUM_DVRK_DOUBLE, "--port", client.port(), "--home-at", "0.1", "--at", "2 steal"});
  ASSERT_TRUE(client.listen_until_homed());
  // Silence for longer than 50 periods; the process has not ended.
  const auto silent = [&] {
    return steady_now_ns() - client.state.measured_js.arrival_ns > 500'000'000;
  };
  ASSERT_TRUE(client.listen_until(silent));
  client.say(R"({"hold":""})");
  EXPECT_TRUE(client.listen_until([&] { return !silent(); }));
}

TEST(DoubleProgram, RestartIsAnotherProcess) {
  Client client;
  test::Process robot(
      {OMENTUM_DVRK_DOUBLE, "--port", client.port(), "--home-at", "0.1", "--at", "2 restart"});
  ASSERT_TRUE(client.listen_until_homed());
  EXPECT_TRUE(client.listen_until([&] { return client.state.foreign > 0; }));
}

TEST(DoubleProgram, AToolIsCarriedInItsOwnOrientation) {
  Client client;
  DoubleProgramOptions options;
  options.port = client.socket.port();
  options.robot.home_at_s = 0.1;
  options.mount = make_sim_setup(load_config("omentum", {}))->mount;
  std::array<int, 2> typed{};
  ASSERT_EQ(pipe(typed.data()), 0);
  const volatile std::sig_atomic_t stop = 0;
  DoubleProgram program(options);
  std::thread robot([&] { program.run(stop, typed[0]); });
  const Eigen::Vector3d middle = 0.5 * (options.mount.workspace_min + options.mount.workspace_max);
  const Eigen::Vector3d p_RT = options.mount.X_WR.inverse() * middle;
  const auto stands = [&](const std::array<double, 3>& tool) {
    const auto& q = client.state.setpoint_js.payload.position;
    return std::abs(q[3] - tool[0]) + std::abs(q[4] - tool[1]) + std::abs(q[5] - tool[2]) < 1e-5;
  };
  const auto is_there = [&] {
    const CartesianPose& pose = client.state.local_measured_cp.payload;
    const Eigen::Vector3d tip = pose.translation + options.mount.tip_offset * pose.rotation.col(2);
    return pose.valid && (tip - p_RT).norm() < 1e-5;
  };
  EXPECT_TRUE(client.listen_until_homed());
  client.say(R"({"move_jp":{"Goal":[0.3,0.1,0.1,0.8,0.5,-0.4]}})");
  EXPECT_TRUE(client.listen_until([&] { return stands({0.8, 0.5, -0.4}); }));
  EXPECT_FALSE(is_there());
  EXPECT_EQ(write(typed[1], "carry\n", 6), 6);
  EXPECT_TRUE(client.listen_until(is_there));
  EXPECT_TRUE(stands({0.8, 0.5, -0.4})) << "roll and wrist are as they were";
  EXPECT_EQ(write(typed[1], "carry 90\n", 9), 9);
  EXPECT_TRUE(client.listen_until([&] { return stands({kDegree * 90, 0, 0}) && is_there(); }));
  EXPECT_EQ(write(typed[1], "quit\n", 5), 5);
  robot.join();
  for (const int end : typed) close(end);
}

TEST(DoubleProgram, WrongInputIsOneLineAndCode2) {
  const test::TempDir folder;
  const struct {
    std::vector<std::string> arguments;
    const char* told;
  } cases[] = {
      {{}, "--port"},
      {{"--port", "70000"}, "70000"},
      {{"--port", "48051", "--loss", "1.5"}, "1.5"},
      {{"--port", "48051", "--missing", "nothing"}, "measured_js"},
      {{"--port", "48051", "--at", "5"}, "SECONDS COMMAND"},
      {{"--port", "48051", "--at", "5 dance"}, "dance"},
      {{"--port", "48051", "--at", "5 carry 400"}, "allowed -260 ... 260"},
      {{"--port", "48051", "--scene", "nowhere.txtpb"}, "nowhere.txtpb"},
      {{"--port", "48051", "--set", "scene.arm.payload_kg=7"}, "payload_kg"},
      {{"--port", "48051", "--to", "256.0.0.1"}, "256.0.0.1"},
      {{"--port", "48051", "--base-frame", "1,2,3"}, "x,y,z,qw,qx,qy,qz"},
  };
  for (const auto& one : cases) {
    std::vector<std::string> arguments = {OMENTUM_DVRK_DOUBLE};
    arguments.insert(arguments.end(), one.arguments.begin(), one.arguments.end());
    test::Process robot(arguments, "", folder / "err");
    EXPECT_EQ(robot.wait(std::chrono::seconds(60)), 2) << one.told;
    const std::string err = content_of(folder / "err");
    EXPECT_THAT(err, HasSubstr(one.told));
    EXPECT_EQ(std::count(err.begin(), err.end(), '\n'), 1) << err;
  }
}

TEST(DoubleProgram, ShippedStreamerFileOffersWhatTheDoubleSpeaks) {
  const std::string file = content_of(OMENTUM_SOURCE_DIR "/deploy/dvrk/psm1-streamer.json");
  for (const std::string_view name : kStreamNames)
    EXPECT_THAT(file, HasSubstr(fmt::format("{{\"name\": \"{}\",", name)));
  for (const char* name :
       {"servo_cp", "move_cp", "servo_jp", "move_jp", "jaw/servo_jp", "jaw/move_jp"})
    EXPECT_THAT(file, HasSubstr(fmt::format("{{\"name\": \"{}\",", name)));
  EXPECT_THAT(file, HasSubstr(R"("void-commands": ["hold"])"));
  EXPECT_THAT(file, HasSubstr(R"("write-events": ["operating_state"])"));
}

// ---- tissue ----------------------------------------------------------------------------------

struct TissueUnderTheJaw : testing::Test {
  static std::shared_ptr<const SimSetup> setup_with(std::vector<std::string> overrides) {
    return make_sim_setup(load_config("omentum", overrides));
  }
  /// Jaw open above the free edge, down to the tissue, closed, up by 20 mm. Largest force [N].
  static double lift(AttachedTissue& tissue, const Eigen::Vector3d& p_WT) {
    constexpr double kOpen = 0.7;
    tissue.step(p_WT + Eigen::Vector3d(0, 0, 0.01), kOpen);
    for (int k = 9; k >= 0; --k) tissue.step(p_WT + Eigen::Vector3d(0, 0, 0.001 * k), kOpen);
    for (int k = 0; k < 5; ++k) tissue.step(p_WT, 0);
    double largest = 0;
    for (int k = 1; k <= 40; ++k)
      largest = std::max(largest, tissue.step(p_WT + Eigen::Vector3d(0, 0, 0.0005 * k), 0).norm());
    return largest;
  }
  /// A particle near the middle of the free edge.
  static Eigen::Vector3d edge(AttachedTissue& tissue) {
    Eigen::Vector3d best(0, -1, 0);
    for (int k = 0; k < tissue.tissue().particles(); ++k) {
      const Eigen::Vector3d p = tissue.tissue().position(0, k);
      if (p.y() - std::fabs(p.x()) > best.y() - std::fabs(best.x())) best = p;
    }
    return best;
  }
};

TEST_F(TissueUnderTheJaw, IsTakenByTheClosingJawAndPullsDown) {
  AttachedTissue tissue(setup_with({}));
  const Eigen::Vector3d p_WT = edge(tissue);
  const double force = lift(tissue, p_WT);
  EXPECT_TRUE(tissue.holds());
  EXPECT_EQ(tissue.grasps(), 1u);
  EXPECT_GT(force, 0.01);
  const Eigen::Vector3d tip = p_WT + Eigen::Vector3d(0, 0, 0.02);
  EXPECT_LT(tissue.step(tip, 0).z(), 0);
  EXPECT_EQ(tissue.step(tip, 0.7).norm(), 0);
  EXPECT_FALSE(tissue.holds());
}

TEST_F(TissueUnderTheJaw, IsMissedBesideIt) {
  AttachedTissue tissue(setup_with({}));
  EXPECT_EQ(lift(tissue, edge(tissue) + Eigen::Vector3d(0, 0, 0.02)), 0);
  EXPECT_FALSE(tissue.holds());
  EXPECT_EQ(tissue.pinches(), 1u);
  EXPECT_EQ(tissue.grasps(), 0u);
}

TEST_F(TissueUnderTheJaw, SlipsOutOfAWeakGrasp) {
  AttachedTissue tissue(setup_with(
      {"grasp.slip_force_n=0.001", "grasp.slip_rate_m_per_s_n=10", "grasp.loss_slip_m=0.001"}));
  lift(tissue, edge(tissue));
  EXPECT_FALSE(tissue.holds());
  EXPECT_EQ(tissue.losses(), 1u);
}

}  // namespace
}  // namespace omentum
