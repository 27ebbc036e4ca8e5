// The page of a recording of a robot.
#include "report/recording_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "tests/dvrk_gateway/recorded_session.h"
#include "tests/support/episode_fixture.h"

namespace omentum {
namespace {

using testing::HasSubstr;
using testing::Not;

std::string recorded(RecordingSetup setup, std::vector<Period> periods) {
  std::ostringstream out;
  RecordingFile file(out, setup);
  for (const Period& period : periods) file.add_period(period);
  const EpisodeRecording episode = test::make_episode(20, 0);
  EXPECT_TRUE(
      file.add_episode(episode.task, episode.segment, episode.context, periods.back().began_ns));
  EXPECT_TRUE(file.finish().has_value());
  return out.str();
}

TEST(RecordingPage, ShowsPathsTimesStopsAndEpisodes) {
  test::RecordedSession session;
  std::vector<Period> periods = session.take(100);
  Judgement& last = periods.back().judgement;
  last.memory.phase = SafetyPhase::kStopped;
  last.finding = {StopReason::kOutsideBox, 0.07, 0.05, 2};
  last.stopped_now = true;
  RecordingSetup setup = test::recording_setup(session.mount);
  setup.info.set_program("<script>alert(1)</script>");
  const auto recording = read_robot_recording("a/b.mcap", recorded(setup, periods));
  ASSERT_TRUE(recording) << recording.error();
  EXPECT_EQ(recording.value().name, "b.mcap");
  EXPECT_EQ(recording.value().measured.t_s.size(), 100U);
  EXPECT_EQ(recording.value().commanded.t_s.size(), 100U);
  EXPECT_EQ(recording.value().latency_ms.size(), 100U);
  EXPECT_NEAR(recording.value().latency_ms[3], 1, 1e-6);
  ASSERT_EQ(recording.value().episodes.size(), 1U);
  EXPECT_EQ(recording.value().episodes[0].steps, 20U);
  const std::string page = make_recording_page({recording.value()});
  for (const char* text : {"OUTSIDE_BOX", "Path of the tip, from above", "Measured tip", "p99.9",
                           "set-point", "commanded"})
    EXPECT_THAT(page, HasSubstr(text));
  EXPECT_THAT(page, Not(HasSubstr("<script>alert")));
}

TEST(RecordingPage, OfACutFileSaysSo) {
  test::RecordedSession session;
  std::ostringstream out;
  RecordingFile file(out, test::recording_setup(session.mount));
  for (const Period& period : session.take(50)) file.add_period(period);
  file.flush();
  const std::string whole = out.str();
  for (const Period& period : session.take(50)) file.add_period(period);
  file.flush();
  const auto recording = read_robot_recording("cut.mcap", out.str().substr(0, whole.size() + 100));
  ASSERT_TRUE(recording) << recording.error();
  EXPECT_FALSE(recording.value().complete);
  EXPECT_EQ(recording.value().measured.t_s.size(), 50U);
  EXPECT_THAT(make_recording_page({recording.value()}), HasSubstr("file ends inside"));
}

TEST(RecordingPage, OfSomethingElseIsRefusedInOneLine) {
  const auto recording = read_robot_recording("x.mcap", "no recording");
  ASSERT_FALSE(recording.has_value());
  EXPECT_THAT(recording.error(), HasSubstr("x.mcap: no pose of the tool"));
}

}  // namespace
}  // namespace omentum
