// Physics that always diverges must not keep the learner busy for ever.
#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <thread>

#include "core/build_id.h"
#include "core/config.h"
#include "core/rollout.h"
#include "sim_worker/bus/bus_worker.h"
#include "tests/integration/programs.h"
#include "tests/support/dummy_backend.h"

namespace omentum {
namespace {

/// No lane survives a step.
class DivergingBackend : public test::DummySimulation {
 public:
  using DummySimulation::DummySimulation;
  bool healthy(int) const override { return false; }
};

TEST(DivergingPhysics, StopsTheLearnerWithExitCode1AndTheReason) {
  test::Programs programs;
  test::Process learner =
      programs.learner("diverging", {"rollout.slots=16", "rollout.steps_per_segment=8"},
                       {"--preset", "paper_literal"});
  BusWorkerOptions options;
  options.run = "diverging";
  options.domain = programs.domain();
  options.profile = test::loopback_profile();
  options.build_id = build_id();
  options.program_version = "test";
  options.rollout = [](Backend& backend, Policy& policy, std::span<const RolloutTask> tasks,
                       const std::function<bool()>& stop) {
    return run_rollout(backend, policy, tasks, stop);
  };
  options.make_setup = [](const RunManifest& manifest) {
    const pb::Config config = parse_config("manifest", manifest.config_text);
    WorkerSetup setup;
    setup.backend = std::make_unique<DivergingBackend>(16);
    setup.shape = policy_shape(config);
    setup.config_hash = config_hash(config);
    return setup;
  };
  std::atomic<bool> stop{false};
  std::jthread serving([&] { BusWorker(options).run([&] { return stop.load(); }); });
  EXPECT_EQ(learner.wait(test::kRunTime), 1);
  stop = true;
  const std::string err = test::read_text(programs.err("diverging"));
  EXPECT_NE(err.find("environments diverged, allowed 1000 in one session; the last one: "),
            std::string::npos)
      << err;
  EXPECT_NE(err.find("state not finite at step 0"), std::string::npos) << err;
  EXPECT_TRUE(programs.summary("diverging").empty());
}

}  // namespace
}  // namespace omentum
