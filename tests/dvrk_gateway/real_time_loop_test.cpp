// The thread that keeps the period, on sockets and the machine's clock: what it takes from the
// thread that asks, and that it takes no memory. No time is asserted: figures are those of
// benchmarks/run.sh gateway.
#include "dvrk_gateway/loop/real_time_loop.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <thread>

#include "dvrk_gateway/backend/arm_guide.h"
#include "dvrk_gateway/protocol/udp_socket.h"
#include "tests/dvrk_gateway/ideal_robot.h"
#include "tests/dvrk_gateway/two_sides.h"
#include "tests/support/allocation_count.h"
#include "tests/support/script_link.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

const Vector3d kStart(-0.02, 0.055, 0.09);  // p_WT
constexpr std::int64_t kPatience_ns = 60'000'000'000;

/// The machine's clock, which notes what the thread that sleeps by it has allocated so far.
class CountingClock final : public Clock {
 public:
  std::int64_t now_ns() noexcept override { return clock_.now_ns(); }
  void sleep_until(std::int64_t time_ns) noexcept override {
    if (!began_.exchange(true)) first_ = test::allocation_count();
    allocations = test::allocation_count() - first_;
    clock_.sleep_until(time_ns);
  }
  std::atomic<std::uint64_t> allocations{0};  ///< since its first period

 private:
  SteadyClock clock_;
  std::atomic<bool> began_{false};
  std::uint64_t first_ = 0;
};

/// A robot on a socket and a thread of its own, homed and in place.
class LiveRobot {
 public:
  LiveRobot(std::uint16_t client_port, const ToolMount& mount)
      : robot_({}, {}, mount, {test::kClient.ipv4, client_port}) {
    test::TwoSides console({}, {}, mount);
    console.bring_to(joints_for_tip(mount, kStart).value());
    robot_ = console.robot();
    robot_.steal({test::kClient.ipv4, client_port});
    begin_ns_ = clock_.now_ns() - console.now_ns();
    thread_ = std::jthread([this](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        robot_.period(clock_.now_ns() - begin_ns_, socket_);
        clock_.sleep_until(clock_.now_ns() + DvrkDouble::kPeriod_ns);
      }
    });
  }

 private:
  SteadyClock clock_;
  UdpSocket socket_{0};
  DvrkDouble robot_;
  std::int64_t begin_ns_ = 0;
  std::jthread thread_;  // last: uses everything above
};

struct LiveGateway {
  LiveGateway()
      : setup(make_safety_setup({}, test::paper_mount(), Eigen::Isometry3d::Identity(), true)),
        robot(socket.port(), setup.mount),
        control(socket, clock, setup),
        loop(control, clock, events),
        guide(loop, setup, {}, [this](const Period& now) { operate(now); }) {
    loop.start();  // what the system did not grant does not matter here
  }
  /// The operator, who arms and acknowledges; gives up in the end.
  void operate(const Period& now) {
    const SafetyPhase phase = now.judgement.memory.phase;
    if (phase == SafetyPhase::kReady) events.arm_ns = clock.now_ns();
    if (phase == SafetyPhase::kStopped) events.acknowledge_ns = clock.now_ns();
    if (clock.now_ns() > give_up_ns) throw_error("{}", describe(now.judgement.finding));
  }
  /// Number of the first period in which this goal went out; 0 for none.
  std::uint64_t sent_in(const Vector3d& p_WT) {
    const Vector3d p_RC = setup.mount.X_WR.inverse() * setup.mount.control_point(p_WT);
    for (const auto& [number, goal] : sent) {
      if ((goal - p_RC).norm() < 1e-9) return number;
    }
    return 0;
  }
  void watch() {
    for (Period period; loop.watch(period);) {
      if (period.sent_ns != 0 && period.judgement.command.kind == RobotCommand::Kind::kServoCp)
        sent.emplace_back(period.number, period.judgement.command.translation);
    }
  }

  SafetySetup setup;
  CountingClock clock;
  UdpSocket socket{0};
  LiveRobot robot;
  ControlLoop control;
  OperatorEvents events;
  RealTimeLoop loop;
  ArmGuide guide;
  std::int64_t give_up_ns = clock.now_ns() + kPatience_ns;
  std::vector<std::pair<std::uint64_t, Vector3d>> sent;
};

TEST(RealTimeLoop, ItsThreadAllocatesNothing) {
  LiveGateway gateway;
  Vector3d tip = kStart;
  std::size_t goals = 0;
  // A busy machine may stop the arm: so long until a hundred goals went out.
  while (goals < 100) {
    if (!gateway.guide.go_to(tip)) continue;
    while (goals < 100) {
      tip.x() += goals % 20 < 10 ? 0.0004 : -0.0004;
      if (!gateway.guide.follow(tip, goals % 30 < 15 ? -0.2 : 0.7)) break;
      ++goals;
    }
  }
  gateway.loop.stop();
  EXPECT_EQ(gateway.clock.allocations, 0U);
  EXPECT_GE(gateway.loop.times().latency.count(), 100U);
}

TEST(RealTimeLoop, ALateRequestIsTakenInTheNextPeriodAndTheOneBehindItOnTime) {
  LiveGateway gateway;
  const Vector3d step(0.0004, 0, 0);
  bool seen = false;
  // Of a few tries: the machine may delay this thread elsewhere, too.
  for (int attempt = 0; attempt < 50 && !seen; ++attempt) {
    Vector3d tip = kStart;
    if (!gateway.guide.go_to(tip)) continue;
    gateway.watch();
    gateway.sent.clear();
    const std::uint64_t late_in = gateway.loop.period().number;
    std::this_thread::sleep_for(std::chrono::milliseconds(14));  // the policy thinks
    if (!gateway.guide.follow(tip + step)) continue;
    const std::uint64_t next_in = gateway.loop.period().number;
    if (!gateway.guide.follow(tip + 2 * step)) continue;
    if (!gateway.guide.follow(tip + 3 * step)) continue;
    gateway.watch();
    seen = gateway.sent_in(tip + step) == late_in + 1 &&
           gateway.sent_in(tip + 2 * step) == next_in && next_in == late_in + 2;
  }
  EXPECT_TRUE(seen);
}

/// Its periods last some microseconds: the thread sleeps just long enough to let others run.
class HastyClock final : public Clock {
 public:
  explicit HastyClock(std::int64_t period_ns) : period_ns_(period_ns) {}
  std::int64_t now_ns() noexcept override { return now_ns_; }
  void sleep_until(std::int64_t time_ns) noexcept override {
    now_ns_ = std::max(now_ns_.load(), time_ns);
    if (time_ns % period_ns_ == 0) std::this_thread::sleep_for(std::chrono::nanoseconds(1));
  }

 private:
  std::int64_t period_ns_;
  std::atomic<std::int64_t> now_ns_{0};
};

// Who had asked waited for ever where the request came between the end of the wait for it and the
// clearing of the semaphore behind that: within 30 of these requests.
TEST(RealTimeLoop, EveryRequestIsTakenWheneverItComes) {
  const SafetySetup setup =
      make_safety_setup({}, test::paper_mount(), Eigen::Isometry3d::Identity(), true);
  HastyClock clock(setup.period_ns);
  test::ScriptLink nobody(clock);
  ControlLoop control(nobody, clock, setup);
  OperatorEvents events;
  RealTimeLoop loop(control, clock, events);
  loop.start();
  std::uint64_t before = 0;
  for (int k = 0; k < 5'000; ++k) {
    const std::uint64_t number = loop.exchange({}).number;
    ASSERT_GT(number, before);
    before = number;
  }
}

/// May lock memory and raise threads no more.
void give_up_privileges() {
  const rlimit none{0, 0};
  setrlimit(RLIMIT_MEMLOCK, &none);
  setrlimit(RLIMIT_RTPRIO, &none);
  if (geteuid() == 0 && setresuid(65534, 65534, 65534) != 0) _exit(3);
}

TEST(RealTimeLoop, WhatTheSystemRefusesIsALineEachWithWhatToDoAndItRunsAllTheSame) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    give_up_privileges();
    const SafetySetup setup =
        make_safety_setup({}, test::paper_mount(), Eigen::Isometry3d::Identity(), true);
    SteadyClock clock;
    test::ScriptLink nobody(clock);
    ControlLoop control(nobody, clock, setup);
    OperatorEvents events;
    RealTimeLoop loop(control, clock, events);
    std::string told;
    for (const std::string& warning : loop.start()) told += warning + "\n";
    const std::uint64_t number = loop.exchange({}).number;
    const bool runs = loop.exchange({}).number > number;
    const bool whole =
        write(ends[1], told.data(), told.size()) == static_cast<ssize_t>(told.size());
    loop.stop();
    _exit(runs && whole ? 0 : 1);
  }
  close(ends[1]);
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
  std::array<char, 4096> memory{};
  const ssize_t size = read(ends[0], memory.data(), memory.size());
  close(ends[0]);
  const std::string told(memory.data(), static_cast<std::size_t>(std::max<ssize_t>(size, 0)));
  EXPECT_EQ(std::count(told.begin(), told.end(), '\n'), 2) << told;
  EXPECT_THAT(told, testing::HasSubstr("memory is not locked"));
  EXPECT_THAT(told, testing::HasSubstr("raise `ulimit -l`"));
  EXPECT_THAT(told, testing::HasSubstr("SCHED_FIFO was refused"));
  EXPECT_THAT(told, testing::HasSubstr("raise `ulimit -r` to 80"));
}

TEST(RealTimeLoop, StopWakesTheThreadThatAsksAndEveryLaterCallReturns) {
  LiveGateway gateway;
  std::jthread stopper([&] { gateway.loop.stop(); });
  while (!gateway.loop.ended()) gateway.loop.exchange({});
  EXPECT_FALSE(gateway.guide.hold());
}

}  // namespace
}  // namespace omentum
