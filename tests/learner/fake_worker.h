#pragma once

#include <atomic>
#include <chrono>
#include <thread>

#include "benchmarks/lanes_only.h"
#include "sim_worker/bus/bus_worker.h"
#include "tests/learner/fake_rollout.h"
#include "tests/support/domain.h"

namespace omentum::test {

inline constexpr std::uint64_t kFakeConfigHash = 99;
inline constexpr std::uint64_t kFakeBuild = 5;
inline constexpr std::uint32_t kFakeStateFormat = 4;

inline PolicyWeights fake_weights(std::uint64_t version) {
  PolicyWeights weights;
  weights.policy_version = version;
  weights.parameters.assign(fake_shape().parameter_count(),
                            0.01f * static_cast<float>(version + 1));
  weights.weights_hash = hash_weights(weights.parameters, {}, {});
  weights.layout_hash = fake_shape().layout_hash();
  weights.config_hash = kFakeConfigHash;
  return weights;
}

struct FakeWorker {
  std::string run = "loop";
  std::uint32_t domain = 0;
  int lanes = 4;
  std::int64_t group_ms = 0;  ///< pretended duration of one group
  std::int64_t setup_ms = 0;  ///< and of making the scene
  std::size_t state_bytes = 16;
  std::uint64_t config_hash = kFakeConfigHash;
  std::uint64_t build = kFakeBuild;
  int garbage = 0;  ///< every n-th segment is spoilt; 0 = none
};

inline BusWorkerOptions fake_options(const FakeWorker& fake) {
  BusWorkerOptions options;
  options.run = fake.run;
  options.domain = fake.domain;
  options.profile = loopback_profile();
  options.build_id = fake.build;
  options.program_version = "test";
  options.make_setup = [fake](const RunManifest&) {
    std::this_thread::sleep_for(std::chrono::milliseconds(fake.setup_ms));
    WorkerSetup setup;
    setup.backend = std::make_unique<LanesOnly>(fake.lanes, kFakeObservation, kFakeStateFormat);
    setup.shape = fake_shape();
    setup.config_hash = fake.config_hash;
    return setup;
  };
  auto count = std::make_shared<int>(0);
  options.rollout = [fake, count](Backend&, Policy&, std::span<const RolloutTask> tasks,
                                  const std::function<bool()>& stop) {
    std::vector<RolloutSegment> segments;
    const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(fake.group_ms);
    while (std::chrono::steady_clock::now() < end) {  // pretends to simulate, asks like a step does
      if (stop()) return segments;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    for (const RolloutTask& task : tasks) {
      segments.push_back(fake_rollout(task, 50, fake.state_bytes));
      if (fake.garbage > 0 && ++*count % fake.garbage == 0) segments.back().rewards[0] += 1;
    }
    return segments;
  };
  return options;
}

/// A worker on its own thread of this process.
class WorkerThread {
 public:
  explicit WorkerThread(const FakeWorker& fake)
      : thread_([this, fake] {
          BusWorker worker(fake_options(fake));
          id = worker.worker_id();
          code = worker.run([this] { return stop_.load(); });
          last = worker.status();
          finished = true;
        }) {}
  ~WorkerThread() { join(); }
  void join() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
  }
  std::atomic<std::uint32_t> id{0};
  std::atomic<int> code{-1};
  std::atomic<bool> finished{false};
  WorkerStatus last;  ///< after finished

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace omentum::test
