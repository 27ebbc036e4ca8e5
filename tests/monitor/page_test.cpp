// `omentum monitor` on a live run: over HTTP, and in a real browser.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <httplib.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cstdio>
#include <regex>

#include "core/types.h"
#include "tests/monitor/tool_programs.h"

namespace omentum {
namespace {

using test::eventually;
using test::Programs;
using test::tool;
using test::operator+;
using testing::HasSubstr;

/// A run that goes on and on, and a monitor of it.
class Page : public testing::Test {
 protected:
  void SetUp() override {
    learner_ = programs_.learner("page", test::endless_task());
    worker_ = programs_.worker("page", {"--lanes", "6"});
    ASSERT_TRUE(programs_.reaches_update("page", 2));
    const std::string out = programs_.folder() / "monitor.out";
    monitor_ = test::Process(tool(programs_, "monitor", "page", {"--port", "0"}), out,
                             programs_.folder() / "monitor.err");
    std::smatch found;
    std::string text;
    ASSERT_TRUE(eventually([&] {
      text = test::read_text(out);
      return std::regex_search(text, found, std::regex("http://127\\.0\\.0\\.1:(\\d+)/"));
    })) << test::read_text(programs_.folder() / "monitor.err");
    port_ = std::stoi(found[1]);
  }
  httplib::Client client() const {
    httplib::Client made("127.0.0.1", port_);
    made.set_read_timeout(30, 0);
    return made;
  }
  std::string body(const std::string& path) const {
    const auto result = client().Get(path.c_str());
    return result && result->status == 200 ? result->body : "";
  }
  /// How often the learner was told to begin or to end frames, by its log.
  int commands(ControlAction action) const {
    const std::string wanted =
        "event=command action=" + std::to_string(static_cast<std::uint32_t>(action)) + " ";
    int found = 0;
    for (const std::string& line : test::lines_of(test::read_text(programs_.err("page"))))
      found += line.find(wanted) != std::string::npos ? 1 : 0;
    return found;
  }
  std::string address() const { return "http://127.0.0.1:" + std::to_string(port_) + "/"; }

  Programs programs_;
  test::Process learner_{{"/bin/true"}}, worker_{{"/bin/true"}}, monitor_{{"/bin/true"}};
  int port_ = 0;
};

TEST_F(Page, ServesPageStateCurvesMetricsAndFrames) {
  EXPECT_THAT(body("/"), HasSubstr("Run page"));
  EXPECT_TRUE(eventually(
      [&] { return body("/state").find(std::to_string(worker_.pid())) != std::string::npos; }));
  EXPECT_TRUE(eventually([&] { return body("/curves").find("<svg") != std::string::npos; }));
  EXPECT_THAT(body("/metrics"), HasSubstr("omentum_learner_up{run=\"page\"} 1\n"));
  EXPECT_TRUE(eventually(
      [&] { return body("/frame?slot=3&hz=20").find("\"positions\"") != std::string::npos; }));
  EXPECT_GE(commands(ControlAction::kFramesOn), 1);
  // Nobody looks any more: the learner is told so.
  EXPECT_TRUE(eventually([&] { return commands(ControlAction::kFramesOff) > 0; }));
  EXPECT_TRUE(eventually([&] { return !body("/frame?slot=3").empty(); }));
  const int told_off = commands(ControlAction::kFramesOff);
  monitor_.kill(SIGTERM);
  EXPECT_EQ(monitor_.wait(std::chrono::seconds(20)), 0);
  EXPECT_TRUE(eventually([&] { return commands(ControlAction::kFramesOff) > told_off; }));
}

TEST_F(Page, WrongRequestsAreRefusedAndTheNextIsServed) {
  httplib::Client to = client();
  const std::vector<std::pair<std::string, int>> wrong = {
      {"/nothing", 404},
      {"/../etc/passwd", 404},
      {"/state?x=1", 400},
      {"/frame", 400},
      {"/frame?slot=6", 400},
      {"/frame?slot=-1", 400},
      {"/frame?slot=a", 400},
      {"/frame?slot=1&slot=2", 400},
      {"/frame?slot=1&hz=0", 400},
      {"/frame?slot=1&hz=51", 400},
      {"/frame?slot=1&other=1", 400},
      {"/frame?slot=" + std::string(5000, '9'), 400}};
  for (const auto& [path, status] : wrong) {
    const auto result = to.Get(path.c_str());
    ASSERT_TRUE(result) << path.substr(0, 40);
    EXPECT_EQ(result->status, status) << path.substr(0, 40);
  }
  const auto long_path = to.Get(("/" + std::string(100'000, 'a')).c_str());
  if (long_path) {
    EXPECT_EQ(long_path->status / 100, 4);
  }
  for (const char* path : {"/", "/state", "/frame?slot=1"}) {
    const auto posted = to.Post(path, "x", "text/plain");
    ASSERT_TRUE(posted);
    EXPECT_EQ(posted->status, 405) << path;
    const auto deleted = to.Delete(path);
    ASSERT_TRUE(deleted);
    EXPECT_EQ(deleted->status, 405) << path;
  }
  EXPECT_THAT(body("/metrics"), HasSubstr("omentum_learner_up"));
}

TEST_F(Page, ATakenPortIsOneLineAndCodeTwo) {
  const test::Finished second =
      programs_.finish(tool(programs_, "monitor", "page", {"--port", std::to_string(port_)}));
  EXPECT_EQ(second.code, 2);
  EXPECT_EQ(test::lines_of(second.err).size(), 1u) << second.err;
}

/// Whether something listens there, though it may not answer yet.
bool can_connect(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const bool connected =
      connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  close(fd);
  return connected;
}

TEST_F(Page, EndsWhenToldToWhileItStarts) {
  for (int start = 0; start < 8; ++start) {
    monitor_.kill(SIGTERM);
    ASSERT_EQ(monitor_.wait(std::chrono::seconds(20)), 0) << "start " << start;
    monitor_ = test::Process(tool(programs_, "monitor", "page", {"--port", std::to_string(port_)}),
                             "/dev/null");
    // The port is taken before the run is joined, and the signal comes in between.
    ASSERT_TRUE(eventually([&] { return can_connect(port_); }));
  }
}

std::string output_of(const std::string& command) {
  std::string text;
  FILE* pipe = ::popen(command.c_str(), "r");
  if (pipe == nullptr) return text;
  std::array<char, 65536> buffer{};
  for (std::size_t got = 0; (got = std::fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
    text.append(buffer.data(), got);
  ::pclose(pipe);
  return text;
}

TEST_F(Page, InABrowserCurvesGrowAnAlarmShowsAndTheViewMoves) {
  if (output_of("command -v chromium").empty()) GTEST_SKIP() << "chromium is not installed";
  // A worker that is stopped: it stays in the table and becomes an alarm.
  test::Process second = programs_.worker("page", {"--lanes", "6"});
  ASSERT_TRUE(eventually(
      [&] { return body("/state").find(std::to_string(second.pid())) != std::string::npos; }));
  second.kill(SIGKILL);
  ASSERT_TRUE(eventually([&] { return body("/state").find("lost") != std::string::npos; }));
  const std::string dom =
      output_of("timeout 100 chromium --headless=new --no-sandbox --disable-gpu --user-data-dir='" +
                (programs_.folder() / "profile") +
                "' --virtual-time-budget=12000 --window-size=1280,2400 --dump-dom '" + address() +
                "#slot=3' 2>/dev/null");
  const auto seen = [&dom](const std::string& name) {
    std::smatch found;
    return std::regex_search(dom, found, std::regex("data-" + name + "=\"([^\"]*)\""))
               ? found[1].str()
               : std::string();
  };
  ASSERT_FALSE(seen("updates").empty()) << "page of " << dom.size() << " bytes";
  EXPECT_GT(std::stol("0" + seen("steps")), std::stol("0" + seen("first-steps")));
  EXPECT_GT(std::stol("0" + seen("frames")), 5) << dom.substr(0, 300);
  EXPECT_EQ(seen("moved"), "true");
  EXPECT_THAT(dom, HasSubstr(": lost</li>"));
  EXPECT_THAT(dom, HasSubstr("slot 3 "));
}

}  // namespace
}  // namespace omentum
