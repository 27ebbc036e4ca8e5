// What the page and /metrics are made of, without a bus.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <thread>

#include "core/clock.h"
#include "monitor/frame_desk.h"
#include "monitor/metrics.h"
#include "monitor/web_connections.h"
#include "monitor/web_page.h"
#include "monitor/web_server.h"
#include "tests/monitor/run_fixture.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using test::arrived;
using test::some_learner;
using test::some_worker;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr std::int64_t kPageNow = 100'000'000'000;

RunState busy_state() {
  RunState state("fixture");
  state.apply(arrived(some_learner()), kPageNow);
  WorkerStatus worker = some_worker(3);
  worker.host = "a\"b\\c\nd<script>";
  worker.warnings = {"<b>hot</b>"};
  state.apply(arrived(worker), kPageNow);
  state.apply(arrived(some_worker(4)), kPageNow);
  RobotStatus robot = test::some_robot();
  robot.reason_text = "<i>step</i>";
  state.apply(arrived(robot), kPageNow);
  return state;
}

TEST(Metrics, HoldTheFiguresWithEscapedLabels) {
  const std::string text = make_metrics(busy_state(), kPageNow);
  EXPECT_THAT(text, HasSubstr("omentum_learner_up{run=\"fixture\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("omentum_learner_steps{run=\"fixture\"} 250000\n"));
  EXPECT_THAT(text, HasSubstr("omentum_ledger_granted_total{run=\"fixture\"} 110\n"));
  EXPECT_THAT(text, HasSubstr("worker=\"3\",host=\"a\\\"b\\\\c\\nd<script>\"} 1\n"));
  EXPECT_THAT(
      text,
      HasSubstr("omentum_worker_version_lag{run=\"fixture\",worker=\"4\",host=\"node4\"} 1\n"));
  EXPECT_THAT(
      text,
      HasSubstr("omentum_robot_stops_total{run=\"fixture\",robot=\"PSM1\",host=\"console\"} 2\n"));
}

TEST(Metrics, OfARunThatNobodyServesSayThatItIsDown) {
  const std::string text = make_metrics(RunState("fixture"), kPageNow);
  EXPECT_THAT(text, HasSubstr("omentum_learner_up{run=\"fixture\"} 0\n"));
  EXPECT_THAT(text, Not(HasSubstr("omentum_learner_steps")));
}

TEST(Metrics, PromtoolAcceptsThem) {
  if (std::system("command -v promtool > /dev/null") != 0) GTEST_SKIP() << "no promtool";
  RunState state = busy_state();
  LearnerStatus learner = some_learner();
  learner.mean_return = std::numeric_limits<double>::quiet_NaN();
  learner.entropy = -std::numeric_limits<double>::infinity();
  state.apply(arrived(learner), kPageNow);
  const test::TempDir folder;
  std::ofstream(folder / "metrics") << make_metrics(state, kPageNow);
  const std::string command = "promtool check metrics < '" + (folder / "metrics") + "'";
  EXPECT_EQ(std::system(command.c_str()), 0);
}

TEST(MonitorPage, TextOfOthersIsNoMarkup) {
  const std::string json = make_state_json(busy_state(), {}, kPageNow);
  EXPECT_THAT(json, Not(HasSubstr("<script>")));
  EXPECT_THAT(json, Not(HasSubstr("<b>hot")));
  EXPECT_THAT(json, HasSubstr("&lt;b&gt;hot"));
  EXPECT_THAT(json, Not(HasSubstr("<i>step")));
  EXPECT_THAT(json, HasSubstr("STEP: &lt;i&gt;step"));
}

TEST(MonitorPage, LoadsNothingFromOutside) {
  const std::string page = make_monitor_page("fixture", {});
  EXPECT_THAT(page, Not(HasSubstr("http://")));
  EXPECT_THAT(page, Not(HasSubstr("https://")));
}

TEST(MonitorPage, AManifestThatIsNoConfigurationIsTold) {
  RunManifest manifest;
  manifest.config_text = "no such knob: 1";
  const LiveScene scene = make_live_scene(manifest);
  EXPECT_EQ(scene.skin, nullptr);
  EXPECT_THAT(scene.problem, HasSubstr("No 3-D view: "));
  EXPECT_THAT(make_monitor_page("fixture", scene), HasSubstr("No 3-D view: "));
}

TEST(MonitorRequest, ParametersAreDigitsWithinTheirRange) {
  EXPECT_EQ(parse_parameter("slot", "0", 63).value(), 0u);
  EXPECT_EQ(parse_parameter("slot", "63", 63).value(), 63u);
  for (const char* wrong :
       {"", "64", "-1", "+1", " 1", "1 ", "0x1", "1.0", "nan", "99999999999999999999999", "1\n"}) {
    const auto parsed = parse_parameter("slot", wrong, 63);
    ASSERT_FALSE(parsed) << wrong;
    EXPECT_EQ(parsed.error(), "slot: not a number of 0 ... 63");
  }
}

SimFrame frame_of(std::uint32_t slot) {
  SimFrame frame;
  frame.slot = slot;
  return frame;
}

TEST(FrameDesk, AsksOnceWhileFramesComeAndAgainWhenTheyStop) {
  FrameDesk desk;
  ASSERT_TRUE(desk.look(5, 10, kPageNow));
  auto due = desk.due(kPageNow);
  ASSERT_EQ(due.size(), 1u);
  EXPECT_EQ(due[0].action, ControlAction::kFramesOn);
  EXPECT_EQ(due[0].slot, 5u);
  EXPECT_EQ(due[0].frames_hz, 10);
  std::int64_t now = kPageNow;
  for (int k = 0; k < 100; ++k) {
    now += 100'000'000;
    desk.put(frame_of(5), now);
    ASSERT_TRUE(desk.look(5, 10, now));
    EXPECT_THAT(desk.due(now), IsEmpty());
  }
  EXPECT_EQ(desk.newest(5)->number, 100u);
  now += FrameDesk::kMissingNs + 1;
  ASSERT_TRUE(desk.look(5, 10, now));
  EXPECT_EQ(desk.due(now).size(), 1u);
}

TEST(FrameDesk, TurnsOffWhatNobodyLooksAt) {
  FrameDesk desk;
  ASSERT_TRUE(desk.look(5, 10, kPageNow));
  EXPECT_EQ(desk.due(kPageNow).size(), 1u);
  const auto due = desk.due(kPageNow + FrameDesk::kIdleNs + 1);
  ASSERT_EQ(due.size(), 1u);
  EXPECT_EQ(due[0].action, ControlAction::kFramesOff);
  desk.put(frame_of(5), kPageNow);
  EXPECT_EQ(desk.newest(5), nullptr);
  EXPECT_THAT(desk.all_off(), IsEmpty());
}

TEST(FrameDesk, RefusesTooManySlots) {
  FrameDesk desk;
  for (std::uint32_t slot = 0; slot < FrameDesk::kMaxSlots; ++slot)
    EXPECT_TRUE(desk.look(slot, 10, kPageNow));
  EXPECT_FALSE(desk.look(99, 10, kPageNow));
  EXPECT_TRUE(desk.look(0, 20, kPageNow));
  EXPECT_EQ(desk.due(kPageNow).size(), FrameDesk::kMaxSlots);
  EXPECT_EQ(desk.all_off().size(), FrameDesk::kMaxSlots);
}

/// A page of one word behind small limits.
class SmallServer {
 public:
  SmallServer() : server_({.connections = 2, .request_ms = 300, .idle_ms = 300, .requests = 3}) {
    server_.Get("/", [](const httplib::Request&, httplib::Response& response) {
      response.set_content("word", "text/plain");
    });
    port_ = server_.bind_to_any_port("::1");
    thread_ = std::jthread([this] { server_.listen_after_bind(); });
    while (!server_.is_running()) std::this_thread::yield();
  }
  ~SmallServer() { server_.stop(); }

  /// A connection that has sent so much; -1 where it was not accepted.
  int connection(const std::string& text) const {
    const int socket = ::socket(AF_INET6, SOCK_STREAM, 0);
    sockaddr_in6 address{};
    address.sin6_family = AF_INET6;
    address.sin6_addr = in6addr_loopback;
    address.sin6_port = htons(static_cast<std::uint16_t>(port_));
    EXPECT_EQ(::connect(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    EXPECT_EQ(::send(socket, text.data(), text.size(), 0), static_cast<ssize_t>(text.size()));
    return socket;
  }
  /// All that comes until the other side closes.
  static std::string answer(int socket) {
    std::string text;
    std::array<char, 4096> bytes{};
    for (ssize_t got = 0; (got = ::recv(socket, bytes.data(), bytes.size(), 0)) > 0;)
      text.append(bytes.data(), static_cast<std::size_t>(got));
    ::close(socket);
    return text;
  }

 private:
  BoundedServer server_;
  int port_ = 0;
  std::jthread thread_;
};

TEST(WebConnections, ARequestThatComesByteByByteIsCutOffInTime) {
  const SmallServer server;
  const int slow = server.connection("GET / HTTP/1.1\r\n");
  const std::int64_t began = steady_now_ns();
  // Each byte is in time for the next read, and the request has an end all the same.
  while (::send(slow, "a", 1, MSG_NOSIGNAL) == 1 && steady_now_ns() - began < 10'000'000'000)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_LT(steady_now_ns() - began, 5'000'000'000);
  ::close(slow);
}

TEST(WebConnections, OneTooManyIsClosedAndTheNextIsServed) {
  const SmallServer server;
  const int first = server.connection(""), second = server.connection("");
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_EQ(SmallServer::answer(server.connection("GET / HTTP/1.1\r\n\r\n")), "");
  EXPECT_EQ(SmallServer::answer(first), "");  // idle for too long
  EXPECT_EQ(SmallServer::answer(second), "");
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_THAT(SmallServer::answer(server.connection("GET / HTTP/1.1\r\n\r\n")), HasSubstr("word"));
}

TEST(WebConnections, AnAddressOfVersionSixMayStandInBrackets) {
  EXPECT_EQ(plain_address("[::1]"), "::1");
  EXPECT_EQ(plain_address("127.0.0.1"), "127.0.0.1");
  EXPECT_EQ(address_in_url("::1"), "[::1]");
  EXPECT_EQ(address_in_url("[::1]"), "[::1]");
  EXPECT_EQ(address_in_url("0.0.0.0"), "0.0.0.0");
}

}  // namespace
}  // namespace omentum
