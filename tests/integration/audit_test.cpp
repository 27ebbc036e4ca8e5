// What decides results is in the hash, and results of two workers are compared (docs/trust.md 3).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "core/build_id.h"
#include "core/config.h"
#include "core/rollout.h"
#include "core/segment_fields.h"
#include "sim_worker/backend/image_source.h"
#include "sim_worker/backend/sim_backend.h"
#include "sim_worker/bus/bus_worker.h"
#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::operator+;
using test::Programs;
using test::Strings;
using testing::HasSubstr;
namespace fs = std::filesystem;

const std::string kFixtures = std::string(OMENTUM_TESTS_DIR) + "/fixtures/";

/// A worker of the right build whose first reward of every segment is a little off.
BusWorkerOptions wrong_worker(const Programs& programs, const std::string& run) {
  BusWorkerOptions options;
  options.run = run;
  options.domain = programs.domain();
  options.profile = test::loopback_profile();
  options.build_id = build_id();
  options.program_version = "test";
  options.rollout = [](Backend& backend, Policy& policy, std::span<const RolloutTask> tasks,
                       const std::function<bool()>& stop) {
    std::vector<RolloutSegment> segments = run_rollout(backend, policy, tasks, stop);
    for (RolloutSegment& segment : segments) {
      segment.rewards[0] += 0.5F;
      segment.payload_crc32c = segment_crc(segment);
    }
    return segments;
  };
  options.make_setup = [](const RunManifest& manifest) {
    const pb::Config config = parse_config("manifest", manifest.config_text);
    const auto setup = make_sim_setup(config);
    WorkerSetup made;
    made.backend = std::make_unique<SimBackend>(setup, 6, 1, make_image_source(*setup));
    made.shape = policy_shape(config);
    made.config_hash = config_hash(config);
    return made;
  };
  return options;
}

TEST(Audit, AWorkerWithOtherResultsStopsTheRunByDefaultAndIsNamed) {
  Programs programs;
  std::atomic<bool> stop{false};
  std::jthread wrong(
      [&] { BusWorker(wrong_worker(programs, "off")).run([&] { return stop.load(); }); });
  test::Process right = programs.worker("off", {"--lanes", "6"});
  test::Process learner = programs.learner("off", test::endless_task());
  EXPECT_EQ(learner.wait(test::kRunTime), 1);
  stop = true;
  const std::string err = test::read_text(programs.err("off"));
  EXPECT_THAT(err, HasSubstr("event=audit_mismatch two results of slot "));
  for (const int pid : {getpid(), right.pid()}) {
    EXPECT_THAT(err, testing::ContainsRegex("event=audit_mismatch.* host=[^ ]+ pid=" +
                                            std::to_string(pid) + " build=[0-9a-f]{16}"));
  }
  const std::string summary = programs.summary("off");
  EXPECT_THAT(summary, HasSubstr("\"audit_mismatch\": \"two results of slot "));
  EXPECT_GT(std::stoi(Programs::value(summary, "results_compared")), 0);
  EXPECT_EQ(right.wait(test::kRunTime), 0);  // sent home
}

TEST(Audit, ResultsOfEqualWorkersAreComparedByDefaultAndAgree) {
  Programs programs;
  const test::Process one = programs.worker("two", {"--lanes", "3"});
  const test::Process two = programs.worker("two", {"--lanes", "3"});
  test::Process learner = programs.learner("two", test::endless_task());
  const std::string metrics = programs.run_dir("two") + "/metrics.csv";
  EXPECT_TRUE(test::eventually([&] {
    const std::vector<double> compared = test::metric(test::read_text(metrics), "ledger/duplicate");
    return !compared.empty() && compared.back() > 0;
  }));
  learner.kill(SIGTERM);
  EXPECT_EQ(learner.wait(test::kRunTime), 130);
  EXPECT_THAT(test::read_text(programs.err("two")), testing::Not(HasSubstr("audit_mismatch two")));
}

/// A scene with an obstacle from a file.
struct MeshRun {
  Programs programs;
  std::string organ = programs.folder() / "organ.stl";
  Strings sets =
      test::tiny_task() +
      Strings{R"(scene.rigid_body={ name: "spleen" role: ROLE_OBSTACLE mesh { path: ")" + organ +
              R"(" unit_m: 0.0005 } pose { translation_m { x: -0.05 y: 0.03 z: 0.01 } } })"};

  MeshRun() { restore(); }
  void restore() const {
    fs::copy(kFixtures + "organ.stl", organ, fs::copy_options::overwrite_existing);
  }
  /// Another header of a binary STL: the same shape, and yet another file.
  void change() const {
    std::fstream file(organ, std::ios::binary | std::ios::in | std::ios::out);
    file.put('#');
  }
};

TEST(Meshes, AChangedFileIsRefusedWhereTheRunGoesOn) {
  MeshRun run;
  test::Process learner =
      run.programs.learner("mesh", run.sets + Strings{"rollout.max_steps=2000000"});
  {
    test::Process worker = run.programs.worker("mesh", {"--lanes", "6"});
    ASSERT_TRUE(run.programs.reaches_update("mesh", 1));
    worker.kill(SIGTERM);
    EXPECT_EQ(worker.wait(test::kRunTime), 0);
  }
  run.change();
  // Between two workers: the second says so, gets nothing, and serves once the file is as it was.
  test::Process worker = run.programs.worker("mesh", {"--lanes", "6"});
  const std::string log = run.programs.folder() / "mesh.worker1.err";
  const auto says = [](const std::string& path, const std::string& text) {
    return test::eventually([&] { return test::read_text(path).find(text) != std::string::npos; });
  };
  EXPECT_TRUE(says(log, "organ.stl: not the file that the run was begun with"));
  EXPECT_TRUE(says(run.programs.err("mesh"), "refuses: "));
  run.restore();
  EXPECT_TRUE(says(run.programs.err("mesh"), "pid=" + std::to_string(worker.pid()) + " lanes=6"));
  learner.kill(SIGTERM);
  EXPECT_EQ(learner.wait(test::kRunTime), 130);
  // Between stop and resume.
  run.change();
  test::Process again =
      run.programs.learner("mesh", run.sets + Strings{"rollout.max_steps=2000000"});
  EXPECT_EQ(again.wait(test::kRunTime), 2);
  EXPECT_THAT(test::read_text(run.programs.err("mesh")),
              testing::AllOf(HasSubstr("another configuration"),
                             testing::ContainsRegex("scene.rigid_body.*mesh.sha256: ")));
}

TEST(Meshes, ARecordingIsNotRunAgainWithAChangedFile) {
  MeshRun run;
  run.programs.train("mesh",
                     run.sets + Strings{"evaluation.enabled=true", "evaluation.lattice_stride=10",
                                        "scene.start_grid.rows=1", "scene.start_grid.columns=1",
                                        "scene.robot_grid.rows=1", "scene.robot_grid.columns=1",
                                        "task.hold_s=0.1"});
  const Strings replay = {OMENTUM_SIM_WORKER, "--replay",
                          run.programs.run_dir("mesh") + "/recordings/grid1_greedy_0.mcap"};
  EXPECT_EQ(run.programs.finish(replay).code, 0);
  run.change();
  const test::Finished refused = run.programs.finish(replay);
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.err, HasSubstr("not the file that the run was begun with"));
}

}  // namespace
}  // namespace omentum
