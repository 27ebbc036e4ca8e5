// The program `omentum` against real learners and workers.
#include <fmt/core.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/monitor/tool_programs.h"

namespace omentum {
namespace {

using test::Programs;
using test::tool;
using test::operator+;
using testing::HasSubstr;

/// A process as it stands in a table, between blanks.
std::string cell_of(const test::Process& process) { return fmt::format(" {} ", process.pid()); }

TEST(Top, WithoutATerminalPrintsOneTableOfALiveRun) {
  Programs programs;
  test::Process learner = programs.learner("seen", test::endless_task());
  test::Process worker = programs.worker("seen", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("seen", 2));
  const test::Finished top = programs.finish(tool(programs, "top", "seen"));
  EXPECT_EQ(top.code, 0) << top.err;
  EXPECT_THAT(top.out, HasSubstr("run        seen"));
  EXPECT_THAT(top.out, HasSubstr("balance    ok"));
  EXPECT_THAT(top.out, HasSubstr(cell_of(worker)));
}

TEST(Top, ARunThatNobodyServesIsAnAlarmAndCodeOne) {
  Programs programs;
  const test::Finished top =
      programs.finish(tool(programs, "top", "nobody", {"--once", "--patience", "1"}));
  EXPECT_EQ(top.code, 1);
  EXPECT_THAT(top.out, HasSubstr("no learner of this run has spoken yet"));
}

TEST(Control, PrintsTheReplyAndEndsByIt) {
  Programs programs;
  test::Process learner = programs.learner("asked", test::endless_task());
  const test::Finished done = programs.finish(tool(programs, "control", "asked", {"pause"}));
  EXPECT_EQ(done.code, 0) << done.err;
  EXPECT_EQ(done.out, "done: learner: no grants until resume; what is out comes in\n");
  const test::Finished refused =
      programs.finish(tool(programs, "control", "asked", {"frames", "100", "--hz", "5"}));
  EXPECT_EQ(refused.code, 1);
  EXPECT_EQ(refused.out, "refused: learner: slot 100, allowed 0 ... 5\n");
}

TEST(Control, ARealLearnerPausesAndGoesOnAndAWorkerLeaves) {
  Programs programs;
  test::Process learner = programs.learner("held", test::endless_task());
  test::Process worker = programs.worker("held", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("held", 1));
  const auto control = [&](const test::Strings& words) {
    const test::Finished finished = programs.finish(tool(programs, "control", "held", words));
    EXPECT_EQ(finished.code, 0) << finished.out << finished.err;
    EXPECT_THAT(finished.out, testing::StartsWith("done: "));
  };
  control({"pause"});
  const test::Finished top = programs.finish(tool(programs, "top", "held"));
  EXPECT_THAT(top.out, HasSubstr("paused (alive)"));
  control({"resume"});
  std::string id;
  for (const std::string& line : test::lines_of(top.out)) {
    if (line.find(cell_of(worker)) != std::string::npos)
      id = line.substr(line.find_first_not_of(' '), 10);
  }
  ASSERT_FALSE(id.empty()) << top.out;
  control({"drain", id.substr(0, id.find(' '))});
  EXPECT_EQ(worker.wait(std::chrono::seconds(30)), 0);
  control({"stop"});
  EXPECT_EQ(learner.wait(test::kRunTime), 130);
}

TEST(Control, NoAnswerIsCodeOne) {
  Programs programs;
  const test::Finished none =
      programs.finish(tool(programs, "control", "asked", {"--timeout", "1", "stop"}));
  EXPECT_EQ(none.code, 1);
  EXPECT_THAT(none.err, HasSubstr("nobody of run asked reads commands"));
}

TEST(Doctor, TellsWhoSpeaksInARunAndWhatDoesNot) {
  Programs programs;
  const test::Finished alone =
      programs.finish(tool(programs, "doctor", "sick", {"--patience", "1"}));
  EXPECT_EQ(alone.code, 1);
  EXPECT_THAT(alone.out, HasSubstr("WRONG  learner          none of run sick speaks"));
  EXPECT_THAT(alone.out, HasSubstr("-> start learner --run sick"));
  test::Process learner = programs.learner("sick", test::endless_task());
  test::Process worker = programs.worker("sick", {"--lanes", "6"});
  ASSERT_TRUE(programs.reaches_update("sick", 1));
  const test::Finished both =
      programs.finish(tool(programs, "doctor", "sick", {"--patience", "3"}));
  EXPECT_THAT(both.out, HasSubstr("ok     learner          speaks, epoch "));
  EXPECT_THAT(both.out, HasSubstr(fmt::format(" pid {}: revision ", worker.pid())));
  EXPECT_THAT(both.out, HasSubstr("ok     CPU "));
}

TEST(Doctor, AHubThatDoesNotExistIsToldAtOnce) {
  Programs programs;
  const test::Finished finished = programs.finish(
      tool(programs, "doctor", "sick", {"--discovery", "hub", "--hub", "no-such-host.invalid"}));
  EXPECT_EQ(finished.code, 1);
  EXPECT_THAT(finished.out, HasSubstr("WRONG  name             no-such-host.invalid: "));
  EXPECT_THAT(finished.out, testing::Not(HasSubstr("none of run")));
}

TEST(Tools, WrongInputGetsOneLineAndCodeTwo) {
  Programs programs;
  const test::Strings wrong[] = {
      {OMENTUM_TOOL},
      {OMENTUM_TOOL, "bottom"},
      {OMENTUM_TOOL, "top"},
      {OMENTUM_TOOL, "top", "--run", "a/b"},
      {OMENTUM_TOOL, "top", "--run", "x", "--domain", "231"},
      {OMENTUM_TOOL, "control", "--run", "x"},
      {OMENTUM_TOOL, "control", "--run", "x", "drain"},
      {OMENTUM_TOOL, "control", "--run", "x", "drain", "-1"},
      {OMENTUM_TOOL, "control", "--run", "x", "frames", "1", "--hz", "51"},
      {OMENTUM_TOOL, "control", "--run", "x", "frames", "1", "--hz", "nan"},
      {OMENTUM_TOOL, "control", "--run", "x", "frames", "4294967296"},
  };
  for (const test::Strings& arguments : wrong) {
    const test::Finished finished = programs.finish(arguments);
    EXPECT_EQ(finished.code, 2) << arguments.back();
    EXPECT_EQ(test::lines_of(finished.err).size(), 1u) << finished.err;
  }
}

}  // namespace
}  // namespace omentum
