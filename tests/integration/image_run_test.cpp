// Observations with a picture, trained over the bus by the real programs: object ids and shaded.
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

/// Six updates of 4 x 16 steps.
Strings image_task(const std::string& kind, const std::string& size) {
  return tiny_task() + Strings{"task.observation=OBSERVATION_IMAGE",
                               "task.image=" + kind,
                               "task.image_size=" + size,
                               "rollout.slots=4",
                               "rollout.steps_per_segment=16",
                               "rollout.max_steps=384",
                               "ppo.normalise_observations=true",
                               "run.checkpoint_interval_s=0"};
}

TEST(ImageRun, ObjectIdsTrainToTheSameWeightsForAnyWorkersLanesAndThreads) {
  Programs programs;
  const Strings sets = image_task("IMAGE_OBJECT_IDS", "16");
  const std::string hash = programs.train("one", sets, {{"--lanes", "4"}});
  EXPECT_EQ(programs.train("two", sets + Strings{"run.learner_threads=3"},
                           {{"--lanes", "1", "--lane-width", "1"}, {"--lanes", "3"}}),
            hash);
  EXPECT_NE(programs.train("dense", sets + Strings{"ppo.network=NETWORK_DENSE"}), hash);
}

TEST(ImageRun, ShadedPicturesTrainAndAResumeEqualsTheWholeRun) {
  Programs programs;
  const Strings sets = image_task("IMAGE_SHADED", "16");
  const std::string hash = programs.train("whole", sets);
  {
    Process worker = programs.worker("interrupted");
    Process learner = programs.learner("interrupted", sets);
    ASSERT_TRUE(programs.reaches_update("interrupted", 2));
    learner.kill(SIGINT);
    ASSERT_EQ(learner.wait(test::kRunTime), 130) << test::read_text(programs.err("interrupted"));
    EXPECT_EQ(worker.wait(std::chrono::seconds(20)), 0);
  }
  EXPECT_EQ(programs.train("interrupted", sets), hash);
}

TEST(ImageRun, TheLargestPicturesCrossTheBus) {
  Programs programs;
  for (const std::string kind : {"IMAGE_OBJECT_IDS", "IMAGE_SHADED"}) {
    const Strings task = image_task(kind, "64") + Strings{"rollout.max_steps=64"};
    EXPECT_EQ(programs.train(kind, task).size(), 64u) << kind;  // a weights hash: it ended well
  }
}

TEST(ImageRun, EndsWithEvaluationRecordingsAndAReport) {
  Programs programs;
  const Strings sets =
      image_task("IMAGE_OBJECT_IDS", "16") + Strings{"evaluation.enabled=true",
                                                     "evaluation.lattice_stride=10",
                                                     "task.hold_s=0.1",
                                                     "scene.start_grid.rows=1",
                                                     "scene.start_grid.columns=2",
                                                     "task.increment_m=0.004",
                                                     "scene.robot_grid.rows=1",
                                                     "scene.robot_grid.columns=1",
                                                     "task.episode_steps=20",
                                                     "scene.start_grid.row_pitch_m=0.001",
                                                     "task.success_radius_m=0.01"};
  programs.train("seen", sets);
  const std::string recording = programs.run_dir("seen") + "/recordings/grid2_greedy_0.mcap";
  const test::Finished replay = programs.finish({OMENTUM_SIM_WORKER, "--replay", recording});
  EXPECT_EQ(replay.code, 0) << replay.out << replay.err;
  const test::Finished report = programs.finish({OMENTUM_REPORT, programs.run_dir("seen")});
  EXPECT_EQ(report.code, 0) << report.err;
  EXPECT_FALSE(test::read_text(programs.run_dir("seen") + "/report.html").empty());
}

}  // namespace
}  // namespace omentum
