// Simulations over loopback DDS between the real asker and real workers, whose simulation is only a
// function of bytes. Run with `--worker DOMAIN` it is a worker of these tests.
#include "granting/simulation_asker.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <future>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "core/clock.h"
#include "core/hash.h"
#include "learner/bus.h"
#include "sim_worker/bus/bus_worker.h"
#include "tests/learner/fake_rollout.h"
#include "tests/learner/fake_worker.h"
#include "tests/support/domain.h"
#include "tests/support/process.h"
#include "tests/support/stranger.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using test::PrivateDomain;

constexpr std::uint64_t kBuild = test::kFakeBuild;
constexpr std::size_t kResultBytes = 3 * kPartBytes + 5;

Bytes task_of(int number) {
  Bytes task(64);
  std::memcpy(task.data(), &number, sizeof number);
  return task;
}

/// What the pretended simulation makes of a task.
Bytes result_of(std::span<const std::byte> task) {
  Bytes result(kResultBytes);
  const std::uint64_t hash = hash_state(task);
  for (std::size_t i = 0; i < result.size(); ++i)
    result[i] = static_cast<std::byte>(hash >> (i % 57));
  return result;
}

/// A worker on a thread of this process.
class SimulatingWorker {
 public:
  struct Does {
    std::uint64_t build = kBuild;
    std::function<void(const std::function<bool()>& stop)> pretend;  ///< to simulate
  };
  SimulatingWorker(std::uint32_t domain, Does does)
      : thread_([this, domain, does] {
          test::FakeWorker fake;
          fake.run = "recordings";
          fake.domain = domain;
          fake.build = does.build;
          BusWorkerOptions options = test::fake_options(fake);
          options.simulate = [this, does](std::span<const std::byte> task,
                                          const std::function<bool()>& stop) {
            ++begun;
            if (does.pretend) does.pretend(stop);
            return result_of(task);
          };
          BusWorker worker(std::move(options));
          worker.run([this] { return stop_.load(); });
          last = worker.status();
        }) {}
  ~SimulatingWorker() { join(); }
  void join() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
  }
  std::atomic<int> begun{0};
  WorkerStatus last;  ///< after join()

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

class Asker : public testing::Test {
 protected:
  std::unique_ptr<SimulationAsker> make_asker() {
    return std::make_unique<SimulationAsker>(
        SimulationAskerOptions{.run = "recordings",
                               .domain = domain_.id(),
                               .profile = test::loopback_profile(),
                               .program = "test",
                               .build_id = kBuild,
                               .tell = [this](const std::string& line) {
                                 const std::lock_guard lock(mutex_);
                                 told_ += line + "\n";
                               }});
  }
  std::string told() {
    const std::lock_guard lock(mutex_);
    return told_;
  }
  static void expect_right(SimulationAsker& asker, int from, int to) {
    std::vector<std::future<bool>> right;
    for (int k = from; k < to; ++k) {
      right.push_back(std::async(std::launch::async, [&asker, k] {
        const Result<Bytes> answer = asker.ask(task_of(k), 1);
        return answer && answer.value() == result_of(task_of(k));
      }));
    }
    for (int k = from; k < to; ++k)
      EXPECT_TRUE(right[static_cast<std::size_t>(k - from)].get()) << k;
  }
  static bool eventually(const std::function<bool()>& condition) {
    const std::int64_t end = steady_now_ns() + 60'000'000'000;
    while (!condition() && steady_now_ns() < end)
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    return condition();
  }

  PrivateDomain domain_;
  std::mutex mutex_;
  std::string told_;
};

TEST_F(Asker, GetsTheResultsOfTheFunctionFromAsManyWorkersAsThereAre) {
  const auto asker = make_asker();
  SimulatingWorker one(domain_.id(), {});
  expect_right(*asker, 0, 8);
  SimulatingWorker two(domain_.id(), {});
  ASSERT_TRUE(eventually([&] { return asker->state().workers == 2; }));
  expect_right(*asker, 8, 40);
  EXPECT_GT(two.begun, 0);
  const AskerState state = asker->state();
  EXPECT_EQ(state.done, 40u);
  EXPECT_EQ(state.ledger.audit_mismatch, 0u);
  one.join();
  const WorkerStatus& w = one.last;
  EXPECT_EQ(w.tasks_received, w.segments_published + w.tasks_declined_config + w.tasks_abandoned);
}

TEST_F(Asker, GivesWhatAWorkerLeavesToAnother) {
  const auto asker = make_asker();
  std::atomic<bool> hang{true};
  auto slow = std::make_unique<SimulatingWorker>(
      domain_.id(), SimulatingWorker::Does{.pretend = [&](const std::function<bool()>& stop) {
        while (hang && !stop()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }});
  auto answers = std::async(std::launch::async, [&] { Asker::expect_right(*asker, 0, 3); });
  ASSERT_TRUE(eventually([&] { return slow->begun > 0; }));
  slow.reset();  // leaves with one task half done and one that waits
  SimulatingWorker other(domain_.id(), {});
  answers.get();
  EXPECT_EQ(asker->state().done, 3u);
}

TEST_F(Asker, AWorkerOfAnotherBuildDeclinesInWords) {
  const auto asker = make_asker();
  SimulatingWorker stranger(domain_.id(), {.build = kBuild + 1, .pretend = {}});
  auto answers = std::async(std::launch::async, [&] { Asker::expect_right(*asker, 0, 1); });
  ASSERT_TRUE(eventually([&] { return told().find("declines: build") != std::string::npos; }));
  EXPECT_EQ(stranger.begun, 0);
  SimulatingWorker friendly(domain_.id(), {});
  answers.get();
}

TEST_F(Asker, AWorkerStopsForALearnerAndTheTaskGoesElsewhere) {
  const auto asker = make_asker();
  SimulatingWorker first(domain_.id(), {.pretend = [](const std::function<bool()>& stop) {
                           while (!stop())
                             std::this_thread::sleep_for(std::chrono::milliseconds(1));
                         }});
  auto answers = std::async(std::launch::async, [&] { Asker::expect_right(*asker, 0, 1); });
  ASSERT_TRUE(eventually([&] { return first.begun > 0; }));
  LearnerBusOptions options;
  options.run = "recordings";
  options.domain = domain_.id();
  options.profile = test::loopback_profile();
  auto learner = std::make_unique<LearnerBus>(options);
  RunManifest manifest;
  manifest.config_text = "fake";
  manifest.config_hash = test::kFakeConfigHash;
  manifest.layout_hash = test::fake_shape().layout_hash();
  manifest.build_id = kBuild;
  manifest.state_format = test::kFakeStateFormat;
  ASSERT_TRUE(learner->publish_manifest(manifest));
  EXPECT_TRUE(
      eventually([&] { return told().find("works for the learner") != std::string::npos; }));
  // Alone, it would do what it declined when the learner is gone and its bar is over; a worker that
  // hears no learner does it now.
  learner.reset();
  SimulatingWorker second(domain_.id(), {});
  answers.get();
}

TEST_F(Asker, TwoAskersOfARunDoNotGetEachOthersResults) {
  const auto one = make_asker();
  const auto two = make_asker();
  SimulatingWorker worker(domain_.id(), {});
  auto answers = std::async(std::launch::async, [&] { Asker::expect_right(*one, 0, 10); });
  expect_right(*two, 100, 110);
  answers.get();
  EXPECT_EQ(one->state().ledger.received, 10u);
  EXPECT_EQ(two->state().ledger.received, 10u);
}

TEST_F(Asker, ForgedTasksAndResultsChangeNothing) {
  const test::Stranger stranger(domain_.id(), "recordings");
  const auto asker = make_asker();
  SimulatingWorker worker(domain_.id(),
                          {.build = kBuild, .pretend = [](const auto&) {
                             std::this_thread::sleep_for(std::chrono::milliseconds(2));
                           }});
  for (int k = 0; k < 20 && asker->state().ledger.foreign == 0; ++k)
    expect_right(*asker, 10 * k, 10 * k + 10);
  EXPECT_GT(asker->state().ledger.foreign, 0u);
  EXPECT_GT(stranger.sent(), 10);
}

// The protocol below DDS is forged by somebody on the machine (tests/hostile/forger.py).
TEST_F(Asker, FindsWorkersAgainFromWhomItWasParted) {
  if (std::system("python3 -c pass") != 0) GTEST_SKIP() << "python3 is not installed";
  const test::TempDir folder;
  auto asker = make_asker();
  const std::string domain = std::to_string(domain_.id());
  const test::Process one({test::this_executable(), "--worker", domain});
  const test::Process two({test::this_executable(), "--worker", domain});
  ASSERT_TRUE(eventually([&] { return asker->state().workers == 2; }));
  expect_right(*asker, 0, 10);
  test::Process forger(
      {"/usr/bin/env", "python3", OMENTUM_TESTS_DIR "/hostile/forger.py", domain, "3"},
      folder / "forger");
  ASSERT_EQ(forger.wait(std::chrono::seconds(60)), 0) << "it found nobody";
  const std::int64_t ended_ns = steady_now_ns();
  auto answers = std::async(std::launch::async, [&] { Asker::expect_right(*asker, 10, 30); });
  EXPECT_TRUE(eventually([&] { return asker->state().done == 30; })) << told();
  const std::int64_t again_ms = (steady_now_ns() - ended_ns) / 1'000'000;
  RecordProperty("again_ms", static_cast<int>(again_ms));
  EXPECT_LT(again_ms, 30'000);
  asker.reset();  // who waits still has no answer
  answers.get();
}

TEST_F(Asker, SaysWhatToStartWhileThereIsNoWorkerAndEndsWithoutOne) {
  auto asker = make_asker();
  auto answer =
      std::async(std::launch::async, [&] { return asker->ask(task_of(1), 1).has_value(); });
  EXPECT_TRUE(eventually(
      [&] { return told().find("start sim_worker --run recordings") != std::string::npos; }));
  asker.reset();
  EXPECT_FALSE(answer.get());
}

/// For ever.
int work(std::uint32_t domain) {
  test::FakeWorker fake;
  fake.run = "recordings";
  fake.domain = domain;
  BusWorkerOptions options = test::fake_options(fake);
  options.simulate = [](std::span<const std::byte> task, const auto&) { return result_of(task); };
  return BusWorker(std::move(options)).run([] { return false; });
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  if (argc == 3 && std::strcmp(argv[1], "--worker") == 0)
    return omentum::work(static_cast<std::uint32_t>(std::stoul(argv[2])));
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
