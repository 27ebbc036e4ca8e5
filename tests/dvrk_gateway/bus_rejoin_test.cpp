// The gateway's place on the bus, made anew. Run with `--learner DOMAIN` it is a learner of these
// tests, which publishes another version twice a second.
#include <gtest/gtest.h>
#include <pthread.h>
#include <sched.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <string>
#include <thread>

#include "core/clock.h"
#include "dvrk_gateway/bus/bus_policy_source.h"
#include "dvrk_gateway/bus/robot_bus.h"
#include "dvrk_gateway/bus/ros_topics.h"
#include "tests/dvrk_gateway/ideal_robot.h"
#include "tests/dvrk_gateway/small_learner.h"
#include "tests/support/process.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;

SafetySetup some_setup() {
  return make_safety_setup({}, test::paper_mount(), Eigen::Isometry3d::Identity(), true);
}

/// A period of a robot that stands still, `number` tenths of a second after the first.
Period period_at(std::int64_t number, SafetyPhase phase = SafetyPhase::kWaiting) {
  Period period;
  period.number = static_cast<std::uint64_t>(number);
  period.began_ns = number * kS / 10;
  period.judgement.memory.phase = phase;
  return period;
}

/// The number of periods that were told last; 0 where nothing is new.
std::uint64_t last_told(BusReader<RobotStatus>& reader) {
  std::uint64_t periods = 0;
  EXPECT_TRUE(reader.take(64, [&](Arrival<RobotStatus>&& arrival) {
    if (arrival.info.valid) periods = arrival.record.periods;
  }));
  return periods;
}

class GatewayOnBus : public testing::Test {
 protected:
  static RobotBusOptions robot_options() {
    RobotBusOptions options;
    options.run = "r";
    return options;
  }
  test::Process learner() const {
    return test::Process({test::this_executable(), "--learner", std::to_string(domain_.id())});
  }
  /// Forges for three seconds; true when it found the participants.
  bool forge() const {
    test::Process forger({"/usr/bin/env", "python3", OMENTUM_TESTS_DIR "/hostile/forger.py",
                          std::to_string(domain_.id()), "3"},
                         folder_ / "forger");
    return forger.wait(std::chrono::seconds(60)) == 0;
  }

  test::PrivateDomain domain_;
  test::TempDir folder_;
  SafetySetup setup_ = some_setup();
};

// The protocol below DDS is forged by somebody on the machine (tests/hostile/forger.py).
TEST_F(GatewayOnBus, WaitingForAPolicyFindsALearnerFromWhomItWasParted) {
  if (std::system("python3 -c pass") != 0) GTEST_SKIP() << "python3 is not installed";
  const test::Process process = learner();
  GatewayBus bus(domain_.id(), test::loopback_profile());
  ASSERT_TRUE(forge()) << "it found nobody";
  const std::int64_t ended_ns = steady_now_ns();
  const auto source =
      BusPolicySource::wait(bus, "r", [&] { return steady_now_ns() - ended_ns > 60 * kS; });
  EXPECT_TRUE(source) << "no policy";
  RecordProperty("again_ms", static_cast<int>((steady_now_ns() - ended_ns) / 1'000'000));
}

TEST_F(GatewayOnBus, BetweenEpisodesItFindsALearnerFromWhomItWasParted) {
  if (std::system("python3 -c pass") != 0) GTEST_SKIP() << "python3 is not installed";
  const test::Process process = learner();
  GatewayBus bus(domain_.id(), test::loopback_profile());
  const std::int64_t began_ns = steady_now_ns();
  const auto source =
      BusPolicySource::wait(bus, "r", [&] { return steady_now_ns() - began_ns > 60 * kS; });
  ASSERT_TRUE(source);
  RobotBus robot(bus.participant(), robot_options(), setup_);
  RosTopics ros(bus.participant(), "PSM1");
  const std::uint32_t id = robot.gateway_id();
  ASSERT_TRUE(forge()) << "it found nobody";
  const std::uint64_t before = source->for_next_episode().weights().policy_version;
  const std::int64_t ended_ns = steady_now_ns();
  std::int64_t number = 0;
  while (source->for_next_episode().weights().policy_version <= before + 3 &&
         steady_now_ns() - ended_ns < 60 * kS) {
    robot.on_period(period_at(++number));
    ros.on_period(period_at(number));
    if (bus.is_deaf(source->heard_ns(), false, steady_now_ns())) {
      const std::array<BusMember*, 3> members = {&robot, &ros, source.get()};
      ASSERT_TRUE(bus.join_anew(members));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  EXPECT_GT(source->for_next_episode().weights().policy_version, before + 3);
  RecordProperty("again_ms", static_cast<int>((steady_now_ns() - ended_ns) / 1'000'000));
  EXPECT_EQ(robot.gateway_id(), id);
}

TEST_F(GatewayOnBus, WhatIsMadeAnewGoesOnUnderItsIdWithItsCounts) {
  const dds::Participant watcher(domain_.id(), test::loopback_profile().uri, "watcher");
  BusReader<RobotStatus> reader(watcher, run_partition("r"), "states");
  GatewayBus bus(domain_.id(), test::loopback_profile());
  RobotBus robot(bus.participant(), robot_options(), setup_);
  robot.on_period(period_at(1));
  EXPECT_EQ(last_told(reader), 1U);
  robot.leave();
  robot.on_period(period_at(2));
  EXPECT_EQ(last_told(reader), 0U) << "it is not on the bus";
  robot.join(bus.participant());
  BusMember* const member = &robot;
  ASSERT_TRUE(bus.join_anew({&member, 1}));
  robot.on_period(period_at(3));
  EXPECT_EQ(last_told(reader), 3U) << "those that nobody heard of are counted";
}

TEST_F(GatewayOnBus, WhereTheDomainCannotBeJoinedNobodyIsOnItUntilItCan) {
  GatewayBus bus(domain_.id(), test::loopback_profile());
  RobotBus robot(bus.participant(), robot_options(), setup_);
  struct Broken final : BusMember {
    void leave() override {}
    void join(const dds::Participant&) override {
      if (broken) throw Error("no more sockets");
    }
    bool broken = true;
  } broken;
  const std::array<BusMember*, 2> members = {&robot, &broken};
  const Result<void> failed = bus.join_anew(members);
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error(), "no more sockets");
  robot.on_period(period_at(1));  // is told to nobody
  EXPECT_TRUE(bus.is_deaf(steady_now_ns(), false, steady_now_ns()));
  broken.broken = false;
  ASSERT_TRUE(bus.join_anew(members));
  EXPECT_FALSE(bus.is_deaf(steady_now_ns(), false, steady_now_ns()));
}

TEST_F(GatewayOnBus, RobotIsArmedOrNotAsTheLastPeriodSays) {
  GatewayBus bus(domain_.id(), test::loopback_profile());
  RobotBus robot(bus.participant(), robot_options(), setup_);
  EXPECT_FALSE(robot.is_armed());
  robot.on_period(period_at(1, SafetyPhase::kActive));
  EXPECT_TRUE(robot.is_armed());
  robot.on_period(period_at(2, SafetyPhase::kStopped));
  EXPECT_FALSE(robot.is_armed());
}

int policy_of_thread(const std::filesystem::path& thread) {
  return sched_getscheduler(static_cast<pid_t>(std::stol(thread.filename().string())));
}

// The thread that leads the arm is a real-time thread; what it makes inherits that.
TEST_F(GatewayOnBus, ThreadsOfTheBusAreNeverRealTimeThreads) {
  GatewayBus bus(domain_.id(), test::loopback_profile());
  const pid_t self = gettid();
  sched_param urgent{};
  urgent.sched_priority = 1;
  if (pthread_setschedparam(pthread_self(), SCHED_FIFO, &urgent) != 0)
    GTEST_SKIP() << "real-time threads are refused";
  const Result<void> joined = bus.join_anew({});
  int others = 0, real_time = 0;
  for (const auto& thread : std::filesystem::directory_iterator("/proc/self/task")) {
    if (thread.path().filename() == std::to_string(self)) continue;
    ++others;
    real_time += policy_of_thread(thread.path()) == SCHED_OTHER ? 0 : 1;
  }
  const sched_param none{};
  pthread_setschedparam(pthread_self(), SCHED_OTHER, &none);
  EXPECT_TRUE(joined);
  EXPECT_GT(others, 0);
  EXPECT_EQ(real_time, 0);
}

/// For ever.
void learn(std::uint32_t domain) {
  test::SmallLearner learner(domain);
  for (std::uint64_t version = 1;; ++version) {
    learner.offer();
    learner.publish(learner.weights(version));
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
  }
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  if (argc == 3 && std::strcmp(argv[1], "--learner") == 0)
    omentum::learn(static_cast<std::uint32_t>(std::stoul(argv[2])));
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
