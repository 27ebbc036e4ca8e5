// One run, one owner; nobody waits in silence; strangers change nothing (docs/trust.md).
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "tests/integration/programs.h"
#include "tests/support/stranger.h"

namespace omentum {
namespace {

using test::Programs;
using test::operator+;
using testing::HasSubstr;
namespace fs = std::filesystem;

TEST(Ownership, ASecondLearnerOfARunIsToldHostAndPid) {
  Programs programs;
  test::Process first = programs.learner("owned", test::endless_task());
  test::Process worker = programs.worker("owned", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("owned", 1));
  for (const char* option : {"--restart", "--quiet"}) {
    const test::Finished second = programs.finish(
        {OMENTUM_LEARNER, "--run", "owned", option, "--set",
         "run.runs_dir=" + (programs.folder() / "runs"), "--set", "run.domain=229"});
    EXPECT_EQ(second.code, 2) << option;
    EXPECT_THAT(second.err, HasSubstr("in use by the learner of host ")) << option;
    EXPECT_THAT(second.err, HasSubstr("pid " + std::to_string(first.pid()))) << option;
  }
  first.kill(SIGTERM);
  EXPECT_EQ(first.wait(test::kRunTime), 130);
}

TEST(Ownership, ARunWhoseFolderIsDeletedSavesAgain) {
  Programs programs;
  const test::Strings task = test::tiny_task() + test::Strings{"run.checkpoint_interval_s=0"};
  const std::string undisturbed = programs.train("calm", task);
  test::Process learner = programs.learner("gone", task);
  test::Process worker = programs.worker("gone", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("gone", 3));
  fs::rename(programs.run_dir("gone"), programs.folder() / "aside");  // at once, while it writes
  fs::remove_all(programs.folder() / "aside");
  EXPECT_EQ(learner.wait(test::kRunTime), 0) << test::read_text(programs.err("gone"));
  EXPECT_EQ(programs.hash("gone"), undisturbed);
  EXPECT_TRUE(fs::exists(programs.run_dir("gone") + "/checkpoints/checkpoint-00000012.pb"));
  EXPECT_TRUE(fs::exists(programs.run_dir("gone") + "/policy.onnx"));
  EXPECT_TRUE(fs::exists(programs.run_dir("gone") + "/config.txtpb"));
  EXPECT_THAT(test::read_text(programs.run_dir("gone") + "/metrics.csv"),
              testing::StartsWith("update,wall_time_s,"));
}

TEST(Ownership, ARunThatCannotSavePausesAndGoesOnWhenItCan) {
  Programs programs;
  const test::Strings task = test::tiny_task() + test::Strings{"run.checkpoint_interval_s=0"};
  const std::string undisturbed = programs.train("calm", task);
  test::Process learner = programs.learner("full", task, {"--unsaved-limit", "0"});
  test::Process worker = programs.worker("full", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("full", 2));
  const std::string folder = programs.run_dir("full") + "/checkpoints";
  fs::rename(folder, folder + ".away");
  std::ofstream(folder) << "no folder";
  const auto says = [&](const std::string& text) {
    return test::eventually(
        [&] { return test::read_text(programs.err("full")).find(text) != std::string::npos; });
  };
  ASSERT_TRUE(says("event=checkpoint_not_saved")) << test::read_text(programs.err("full"));
  ASSERT_TRUE(says("event=paused"));
  fs::remove(folder);
  ASSERT_TRUE(says("event=goes_on"));
  EXPECT_EQ(learner.wait(test::kRunTime), 0);
  EXPECT_EQ(programs.hash("full"), undisturbed);
}

TEST(Ownership, AnEvaluationThatCannotBeWrittenWaitsAndGoesOn) {
  Programs programs;
  test::Process learner = programs.learner(
      "tables", test::tiny_task() + test::Strings{"evaluation.enabled=true", "task.hold_s=0.1",
                                                  "evaluation.lattice_stride=10"});
  test::Process worker = programs.worker("tables", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("tables", 1));
  const std::string folder = programs.run_dir("tables") + "/evaluation";
  std::ofstream(folder) << "no folder";
  ASSERT_TRUE(test::eventually([&] {
    return test::read_text(programs.err("tables")).find("event=not_written") != std::string::npos;
  })) << test::read_text(programs.err("tables"));
  EXPECT_TRUE(programs.summary("tables").empty());
  fs::remove(folder);
  EXPECT_EQ(learner.wait(test::kRunTime), 0);
  EXPECT_TRUE(fs::exists(folder + "/grasp_lattice.csv"));
  EXPECT_EQ(programs.hash("tables").size(), 64u);
}

TEST(Ownership, AStopThatCouldNotSaveSaysSoAndIsNoSuccess) {
  Programs programs;
  test::Process learner = programs.learner(
      "lost", test::endless_task() + test::Strings{"run.checkpoint_interval_s=86400"});
  test::Process worker = programs.worker("lost", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("lost", 2));
  const std::string folder = programs.run_dir("lost") + "/checkpoints";
  fs::remove_all(folder);
  std::ofstream(folder) << "no folder";
  learner.kill(SIGTERM);
  EXPECT_EQ(learner.wait(test::kRunTime), 1);
  const std::string err = test::read_text(programs.err("lost"));
  EXPECT_THAT(err, HasSubstr("NOT SAVED"));
  EXPECT_THAT(err, HasSubstr("there is no checkpoint"));
  EXPECT_THAT(err, testing::Not(HasSubstr("resume with")));
}

TEST(Waiting, ALearnerAloneSaysWhatToStartAndStopsAfterMaxWait) {
  Programs programs;
  test::Process learner = programs.learner("alone", test::tiny_task(), {"--max-wait", "4"});
  EXPECT_EQ(learner.wait(test::kRunTime), 1);
  const std::string err = test::read_text(programs.err("alone"));
  EXPECT_THAT(err, HasSubstr("waiting for workers: start sim_worker --run alone --domain " +
                             std::to_string(programs.domain())));
  EXPECT_THAT(err, HasSubstr("domain=" + std::to_string(programs.domain())));
}

TEST(Waiting, AWorkerAloneSaysWhatToStartAndStopsAfterMaxWait) {
  Programs programs;
  test::Process worker = programs.worker("alone", {"--max-wait", "4"});
  EXPECT_EQ(worker.wait(test::kRunTime), 1);
  EXPECT_THAT(test::read_text(programs.folder() / "alone.worker0.err"),
              HasSubstr("waiting for a learner: start learner --run alone --set run.domain=" +
                        std::to_string(programs.domain())));
}

TEST(Waiting, AWorkerOfAnOlderSessionFollowsARestartWithAnotherConfiguration) {
  Programs programs;
  test::Process first = programs.learner("again", test::endless_task());
  test::Process worker = programs.worker("again", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("again", 1));
  first.kill(SIGKILL);
  ASSERT_TRUE(first.wait(test::kRunTime).has_value());
  fs::remove_all(programs.run_dir("again"));  // and with it the counter of sessions
  test::Process second =
      programs.learner("again", test::tiny_task() + test::Strings{"ppo.hidden=24"}, {"--restart"});
  EXPECT_EQ(second.wait(test::kRunTime), 0) << test::read_text(programs.err("again"));
}

TEST(Strangers, ForgedSegmentsWeightsAndTasksChangeNothing) {
  Programs programs;
  const std::string undisturbed = programs.train("calm", test::tiny_task());
  test::Process worker = programs.worker("forged", {"--lanes", "6"});
  test::Stranger stranger(programs.domain(), "forged");
  test::Process learner = programs.learner("forged", test::tiny_task());
  EXPECT_EQ(learner.wait(test::kRunTime), 0) << test::read_text(programs.err("forged"));
  EXPECT_GT(stranger.sent(), 100);
  EXPECT_EQ(programs.hash("forged"), undisturbed);
  const std::string err = test::read_text(programs.err("forged"));
  EXPECT_THAT(err, HasSubstr("event=segment_of_stranger"));
  EXPECT_THAT(err, testing::Not(HasSubstr(" foreign=0 ")));
  EXPECT_LT(test::lines_of(err).size(), 60u) << err;  // told, not poured out
}

}  // namespace
}  // namespace omentum
