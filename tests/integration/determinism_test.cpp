// Same seed, same weights: whatever the number of workers, the lanes, the machine's work and the
// interruptions (docs/wire.md 9). Real programs over loopback DDS.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::operator+;
using test::Process;
using test::Programs;
using test::Strings;
using test::tiny_task;

const Strings kLead0 = {"rollout.lead=LEAD_0"};
const Strings kLead1 = {"rollout.lead=LEAD_1"};
// A run long enough to be interrupted, with a checkpoint after every update.
const Strings kLong = {"rollout.max_steps=9216", "run.checkpoint_interval_s=0"};

bool has_sixteen_lanes() {
  return __builtin_cpu_supports("avx512f") != 0 && __builtin_cpu_supports("avx512dq") != 0 &&
         __builtin_cpu_supports("avx512vl") != 0;
}

Strings lanes(const std::string& count, const std::string& width) {
  return {"--lanes", count, "--lane-width", width};
}

TEST(SameWeights, ForAnyWorkersAndLanesInBothLeads) {
  Programs programs;
  const std::string wide = has_sixteen_lanes() ? "16" : "8";
  std::vector<std::string> of_lead;
  for (const Strings& lead : {kLead0, kLead1}) {
    const Strings sets = tiny_task() + lead;
    const std::string name = lead == kLead0 ? "lead0_" : "lead1_";
    const std::string hash = programs.train(name + "a", sets, {lanes("6", "1")});
    EXPECT_EQ(programs.train(name + "b", sets, {lanes("1", "1"), lanes("1", "8")}), hash);
    EXPECT_EQ(programs.train(name + "c", sets, {lanes("8", "8")}), hash);
    EXPECT_EQ(programs.train(name + "d", sets, {lanes("16", wide), lanes("3", "1")}), hash);
    of_lead.push_back(hash);
  }
  EXPECT_NE(of_lead[0], of_lead[1]);
}

TEST(SameWeights, WhateverIsExcludedFromTheConfigurationHash) {
  Programs programs;
  const std::string hash = programs.train("plain", tiny_task());
  EXPECT_EQ(programs.train("workers", tiny_task() + Strings{"run.workers=7"}), hash);
  EXPECT_EQ(programs.train("interval", tiny_task() + Strings{"run.checkpoint_interval_s=0"}), hash);
  EXPECT_EQ(programs.train("audit", tiny_task() + Strings{"run.audit_rate=0.5"}, {{}, {}}), hash);
  EXPECT_EQ(programs.train("threads", tiny_task() + Strings{"run.learner_threads=3"}), hash);
  EXPECT_NE(programs.train("seed", tiny_task() + Strings{"rollout.run_seed=2"}), hash);
}

TEST(SameWeights, WithDomainRandomisationForOneAndTwoWorkers) {
  Programs programs;
  const Strings sets =
      tiny_task() +
      Strings{R"(randomise={ parameter: "tissue.stiffness_scale" min: 0.5 max: 2 })",
              R"(randomise={ parameter: "tissue.gravity_scale" min: 0.5 max: 1.5 })",
              R"(randomise={ parameter: "tissue.offset_x_m" min: -0.002 max: 0.002 })",
              // At the sheet with a wide grasp, so that the drawn parameters reach observation and
              // reward.
              "scene.start_grid.centre_m={ x: -0.0172 y: 0.0536 z: 0.042 }",
              "scene.start_grid.row_pitch_m=0.001", "scene.start_grid.column_pitch_m=0.001",
              "task.start_height_range_m=0.002", "task.increment_m=0.002", "grasp.radius_m=0.01",
              "grasp.patch_radius_m=0.01", "grasp.jaw_open_deg=0", "grasp.max_approach_deg=0",
              "grasp.min_pinch_m=0"};
  const std::string hash = programs.train("one", sets, {{}});
  EXPECT_EQ(programs.train("two", sets, {lanes("2", "1"), lanes("3", "8")}), hash);
  Strings plain = sets;
  std::erase_if(plain, [](const std::string& set) { return set.starts_with("randomise="); });
  EXPECT_NE(programs.train("plain", plain), hash) << "the draws reach nothing";
}

TEST(Resume, EqualsTheUninterruptedRunAfterInterruptKillAndATornCheckpoint) {
  Programs programs;
  for (const Strings& lead : {kLead0, kLead1}) {
    const Strings sets = tiny_task() + kLong + lead;
    const std::string name = lead == kLead0 ? "lead0_" : "lead1_";
    const std::string hash = programs.train(name + "whole", sets);

    {  // SIGINT: exit code 130, the workers leave, and the same name goes on.
      const std::string run = name + "interrupted";
      Process worker = programs.worker(run, {"--lanes", "6"});
      Process learner = programs.learner(run, sets);
      ASSERT_TRUE(programs.reaches_update(run, 5));
      learner.kill(SIGINT);
      ASSERT_EQ(learner.wait(test::kRunTime), 130);
      EXPECT_TRUE(programs.summary(run).empty());
      EXPECT_EQ(worker.wait(std::chrono::seconds(20)), 0);
      EXPECT_EQ(programs.train(run, sets), hash);
    }
    {  // SIGKILL: nobody says good-bye; the worker waits for the next learner and serves it.
      const std::string run = name + "killed";
      Process worker = programs.worker(run, {"--lanes", "6"});
      {
        Process learner = programs.learner(run, sets);
        ASSERT_TRUE(programs.reaches_update(run, 7));
        learner.kill(SIGKILL);
        ASSERT_EQ(learner.wait(test::kRunTime), 128 + SIGKILL);
      }
      // The newest checkpoint is torn: the one before it is used.
      std::vector<std::string> checkpoints;
      for (const auto& entry :
           std::filesystem::directory_iterator(programs.run_dir(run) + "/checkpoints")) {
        const std::string name_of = entry.path().filename().string();
        if (name_of.starts_with("checkpoint-") && name_of.ends_with(".pb"))
          checkpoints.push_back(entry.path().string());
      }
      ASSERT_GE(checkpoints.size(), 2u);  // a third when it died between write and removal
      const std::string newest = *std::max_element(checkpoints.begin(), checkpoints.end());
      if (lead == kLead1) {
        std::filesystem::resize_file(newest, std::filesystem::file_size(newest) / 2);
      }
      Process learner = programs.learner(run, sets);
      ASSERT_EQ(learner.wait(test::kRunTime), 0) << test::read_text(programs.err(run));
      EXPECT_EQ(programs.hash(run), hash);
      EXPECT_EQ(worker.wait(std::chrono::seconds(20)), 0);
      const std::string err = test::read_text(programs.err(run));
      EXPECT_NE(err.find("resumed="), std::string::npos) << err;
      EXPECT_EQ(err.find("truncated") != std::string::npos, lead == kLead1) << err;
    }
  }
}

TEST(KilledWorker, CostsNothingButTime) {
  Programs programs;
  const Strings sets = tiny_task() + kLong;
  const std::string hash = programs.train("whole", sets);
  Process survivor = programs.worker("killed", {"--lanes", "3"});
  Process victim = programs.worker("killed", {"--lanes", "3"});
  Process learner = programs.learner("killed", sets);
  ASSERT_TRUE(programs.reaches_update("killed", 4));
  victim.kill(SIGKILL);
  ASSERT_EQ(learner.wait(test::kRunTime), 0) << test::read_text(programs.err("killed"));
  EXPECT_EQ(programs.hash("killed"), hash);
  EXPECT_EQ(survivor.wait(std::chrono::seconds(20)), 0);
}

TEST(LateWorker, JoinsARunThatWaitsForIt) {
  Programs programs;
  const std::string hash = programs.train("early", tiny_task());
  Process learner = programs.learner("late", tiny_task());
  ASSERT_TRUE(test::eventually(
      [&] { return test::read_text(programs.err("late")).find("run=late") != std::string::npos; }));
  Process worker = programs.worker("late");
  ASSERT_EQ(learner.wait(test::kRunTime), 0);
  EXPECT_EQ(programs.hash("late"), hash);
  EXPECT_EQ(worker.wait(std::chrono::seconds(20)), 0);
}

}  // namespace
}  // namespace omentum
