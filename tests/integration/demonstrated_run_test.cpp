// The programs from the scripted expert to a run that begins with it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::Finished;
using test::operator+;
using test::Process;
using test::Programs;
using test::read_text;
using test::Strings;
using testing::HasSubstr;

/// Preset omentum in steps of 2 mm: two episodes and 12 updates of it are seconds.
Strings short_task() {
  return {"task.increment_m=0.002",  "task.episode_steps=150",
          "rollout.slots=6",         "rollout.steps_per_segment=32",
          "rollout.max_steps=2304",  "ppo.hidden=16",
          "ppo.minibatch=64",        "ppo.epochs=2",
          "cloning.epochs=5",        "cloning.critic_updates=2",
          "evaluation.enabled=false"};
}

Strings options_of(const Strings& sets) {
  Strings options;
  for (const std::string& set : sets) options = options + Strings{"--set", set};
  return options;
}

/// Trains with these options of the learner to the end; what it said.
std::string train(Programs& programs, const std::string& run, const Strings& more,
                  const Strings& sets = short_task()) {
  Process worker = programs.worker(run, {"--lanes", "6"});
  Process learner = programs.learner(run, sets, more);
  EXPECT_EQ(learner.wait(test::kRunTime), 0) << read_text(programs.err(run));
  return read_text(programs.err(run));
}

TEST(DemonstratedRun, BeginsWithTheExpertAndIsTheSameTwice) {
  Programs programs;
  const std::string shown = programs.folder() / "shown";
  const Finished made = programs.finish(
      Strings{OMENTUM_SIM_WORKER, "--demonstrate", "2", "-o", shown} + options_of(short_task()));
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_THAT(made.out, HasSubstr("episodes=2 reached=2 steps=150"));

  const Strings clone = {"--initialise-from-recordings", shown};
  EXPECT_THAT(train(programs, "first", clone), HasSubstr("cloned episodes=2 steps=150"));
  train(programs, "second", clone);
  EXPECT_EQ(programs.hash("first"), programs.hash("second"));
  train(programs, "fresh", {});
  EXPECT_NE(programs.hash("first"), programs.hash("fresh"));

  const std::string again =
      train(programs, "first", clone, short_task() + Strings{"run.checkpoint_interval_s=4"});
  EXPECT_THAT(again, HasSubstr("initialise_from_recordings_skipped"));
}

TEST(DemonstratedRun, BadInputIsOneLineAndLeavesNothing) {
  Programs programs;
  const std::string empty = programs.folder() / "empty";
  std::filesystem::create_directories(empty);
  const auto refused = [&](const Strings& arguments, const Strings& parts) {
    const Finished finished = programs.finish(arguments);
    EXPECT_EQ(finished.code, 2) << finished.err;
    EXPECT_EQ(test::lines_of(finished.err).size(), 1u) << finished.err;
    for (const std::string& part : parts) EXPECT_THAT(finished.err, HasSubstr(part));
  };
  const Strings learner = {OMENTUM_LEARNER, "--run", "bad", "--set",
                           "run.runs_dir=" + (programs.folder() / "runs")};
  refused(learner + Strings{"--initialise-from-recordings", empty},
          {"--initialise-from-recordings", empty, "without recordings"});
  refused(learner + Strings{"--initialise-from-recordings", empty + "/none"},
          {"--initialise-from-recordings", "none", "cannot be opened"});
  refused(learner + Strings{"--initialise-from-recordings", empty, "--initialise-from", "x.pb"},
          {"--initialise-from and --initialise-from-recordings"});
  EXPECT_FALSE(std::filesystem::exists(programs.folder() / "runs"));

  const Strings worker = {OMENTUM_SIM_WORKER, "--demonstrate"};
  refused(worker + Strings{"1"}, {"--demonstrate", "-o"});
  refused(worker + Strings{"0", "-o", empty + "/a"}, {"--demonstrate", "0"});
  refused(worker + Strings{"1", "-o", empty + "/a", "--preset", "nowhere"}, {"nowhere", "omentum"});
  refused(worker + Strings{"1", "-o", empty + "/a", "--set", "task.nonsense=1"}, {"task.nonsense"});
  std::ofstream(empty + "/file") << "x";
  refused(worker + Strings{"1", "-o", empty}, {empty});
  EXPECT_FALSE(std::filesystem::exists(empty + "/a"));
}

}  // namespace
}  // namespace omentum
