// What operators ask of a running training, and what tools see of it in a hub.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>
#include <utility>

#include "core/dds_options.h"
#include "core/wire.h"
#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::Programs;
using test::operator+;
using testing::HasSubstr;

/// Sends commands and waits for their replies.
class Operator {
 public:
  Operator(std::uint32_t domain, std::string run)
      : run_(std::move(run)),
        participant_(domain, dds_config_xml({}), "operator"),
        commands_(participant_, run_partition(run_), "commands"),
        replies_(participant_, run_partition(run_), "replies"),
        frames_(participant_, run_partition(run_), "frames"),
        learners_(participant_, run_partition(run_), "learners"),
        workers_(participant_, run_partition(run_), "workers") {}

  /// Waits until the run's programs can hear; a command is not kept for who comes later.
  bool heard_by(int programs) {
    return test::eventually(
        [&] { return commands_.matched() >= programs && replies_.raw().matched() >= programs; });
  }

  std::optional<ControlReply> ask(ControlAction action, std::uint32_t worker = 0,
                                  std::uint32_t slot = 0, float hz = 0) {
    command_.run_id = run_;
    ++command_.request;
    command_.issuer = "test";
    command_.action = action;
    command_.worker_id = worker;
    command_.slot = slot;
    command_.frames_hz = hz;
    return ask_again();
  }

  /// The last command under the same number, once a second until it is answered.
  std::optional<ControlReply> ask_again() {
    std::optional<ControlReply> answer;
    const auto answered = [&] {
      (void)replies_.take(64, [&](Arrival<ControlReply>&& arrival) {
        if (arrival.info.valid && arrival.record.request == command_.request)
          answer = arrival.record;
      });
      return answer.has_value();
    };
    for (int tries = 0; tries < 60 && !answer; ++tries) {
      EXPECT_TRUE(commands_.write(command_));
      test::eventually(answered, std::chrono::seconds(1));
    }
    return answer;
  }

  /// Last status of the learner; waits for one.
  LearnerStatus learner() {
    std::optional<LearnerStatus> last;
    test::eventually([&] {
      (void)learners_.take(64, [&](Arrival<LearnerStatus>&& arrival) {
        if (arrival.info.valid) last = arrival.record;
      });
      return last.has_value();
    });
    return last.value_or(LearnerStatus{});
  }
  std::uint32_t some_worker() {
    std::uint32_t id = 0;
    test::eventually([&] {
      (void)workers_.take(64, [&](Arrival<WorkerStatus>&& arrival) {
        if (arrival.info.valid) id = arrival.record.worker_id;
      });
      return id != 0;
    });
    return id;
  }
  std::optional<SimFrame> frame_of(std::uint32_t slot) {
    std::optional<SimFrame> frame;
    test::eventually([&] {
      (void)frames_.take(64, [&](Arrival<SimFrame>&& arrival) {
        if (arrival.info.valid && arrival.record.slot == slot) frame = arrival.record;
      });
      return frame.has_value();
    });
    return frame;
  }

 private:
  std::string run_;
  dds::Participant participant_;
  BusWriter<ControlCommand> commands_;
  BusReader<ControlReply> replies_;
  BusReader<SimFrame> frames_;
  BusReader<LearnerStatus> learners_;
  BusReader<WorkerStatus> workers_;
  ControlCommand command_;  ///< the last one
};

TEST(Control, PausesResumesSavesEvaluatesAndStops) {
  Programs programs;
  test::Process learner = programs.learner(
      "steered", test::endless_task() + test::Strings{"run.checkpoint_interval_s=3600"});
  test::Process worker = programs.worker("steered", {"--lanes", "6"});
  Operator op(programs.domain(), "steered");
  ASSERT_TRUE(programs.reaches_update("steered", 2));
  ASSERT_TRUE(op.heard_by(2));

  ASSERT_TRUE(op.ask(ControlAction::kPause).value().done);
  // The first status of a phase goes out before its ledger is counted anew.
  std::uint64_t granted = 0;
  ASSERT_TRUE(test::eventually([&] {
    const LearnerStatus status = op.learner();
    const bool same = std::exchange(granted, status.granted) == status.granted;
    return same && granted > 0 && status.phase == LearnerPhase::kPaused && status.outstanding == 0;
  }));
  const std::optional<ControlReply> saved = op.ask(ControlAction::kCheckpoint);
  EXPECT_TRUE(saved.value().done);
  EXPECT_THAT(saved.value().text, HasSubstr("saved at "));
  EXPECT_FALSE(std::filesystem::is_empty(programs.run_dir("steered") + "/checkpoints"));
  EXPECT_EQ(op.learner().granted, granted);

  EXPECT_TRUE(op.ask(ControlAction::kEvaluate).value().done);
  ASSERT_TRUE(op.ask(ControlAction::kResume).value().done);
  EXPECT_TRUE(test::eventually([&] { return op.learner().granted > granted; }));
  EXPECT_TRUE(test::eventually([&] {
    for (const auto& entry : std::filesystem::directory_iterator(programs.run_dir("steered")))
      if (entry.path().filename() == "evaluation") return true;
    return false;
  })) << test::read_text(programs.out("steered"));

  ASSERT_TRUE(op.ask(ControlAction::kStop).value().done);
  EXPECT_EQ(learner.wait(test::kRunTime), 130);
  EXPECT_THAT(test::read_text(programs.err("steered")), HasSubstr("resume with the same run name"));
}

TEST(Control, ARepeatedCommandIsObeyedOnceAndAnsweredInTheSameWords) {
  Programs programs;
  test::Process learner = programs.learner(
      "asked", test::endless_task() + test::Strings{"run.checkpoint_interval_s=3600"});
  test::Process worker = programs.worker("asked", {"--lanes", "6"});
  Operator op(programs.domain(), "asked");
  ASSERT_TRUE(programs.reaches_update("asked", 1));
  ASSERT_TRUE(op.heard_by(2));
  const std::string first = op.ask(ControlAction::kCheckpoint).value().text;
  EXPECT_THAT(first, HasSubstr("saved at "));
  ASSERT_TRUE(programs.reaches_update("asked", 4));
  EXPECT_EQ(op.ask_again().value().text, first);  // not saved anew at more steps
  EXPECT_NE(op.ask(ControlAction::kCheckpoint).value().text, first);
}

TEST(Control, ADrainedWorkerHandsItsWorkBackAndLeaves) {
  Programs programs;
  test::Process learner = programs.learner("drained", test::endless_task());
  test::Process first = programs.worker("drained", {"--lanes", "6"});
  Operator op(programs.domain(), "drained");
  const std::uint32_t id = op.some_worker();
  ASSERT_TRUE(op.heard_by(2));
  const ControlReply reply = op.ask(ControlAction::kDrain, id).value();
  EXPECT_TRUE(reply.done);
  EXPECT_EQ(reply.worker_id, id);
  EXPECT_EQ(first.wait(std::chrono::seconds(10)), 0);
  EXPECT_TRUE(test::eventually([&] { return !op.ask(ControlAction::kDrain, id).value().done; }));
  test::Process second = programs.worker("drained", {"--lanes", "6"});
  programs.expect_goes_on_undisturbed("drained", learner);
}

TEST(Control, FramesOfASlotComeWhileItIsWatchedAndChangeNothing) {
  Programs programs;
  test::Process learner = programs.learner("watched", test::endless_task());
  test::Process worker = programs.worker("watched", {"--lanes", "6"});
  Operator op(programs.domain(), "watched");
  ASSERT_TRUE(op.heard_by(2));
  EXPECT_TRUE(op.ask(ControlAction::kFramesOn, 0, 3, 50).value().done);
  const std::optional<SimFrame> frame = op.frame_of(3);
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->particle_positions_in_world_m.size(), 3u * 144);
  EXPECT_EQ(frame->run_id, "watched");
  const ControlReply wrong = op.ask(ControlAction::kFramesOn, 0, 6, 50).value();
  EXPECT_FALSE(wrong.done);
  EXPECT_EQ(wrong.text, "slot 6, allowed 0 ... 5");
  EXPECT_TRUE(op.ask(ControlAction::kFramesOff, 0, 3).value().done);
  programs.expect_goes_on_undisturbed("watched", learner);
}

// A tool of a hub peers with the learner's host alone.
TEST(Hub, ToolsSeeEveryTopicOfEveryProcessAndTheWeightsStayTheSame) {
  Programs programs;
  const test::Strings hub = {"--discovery", "hub", "--hub", "127.0.0.1"};
  test::Process learner = programs.learner("hub", test::endless_task(), hub);
  test::Process worker = programs.worker("hub", test::Strings{"--lanes", "6"} + hub);

  DdsOptions options;
  options.discovery = "hub";
  options.hub = "127.0.0.1";
  const DdsProfile profile =
      find_dds_profile(options, DdsRole::kOther, programs.domain(), 0).value();
  const dds::Participant tool(programs.domain(), profile.uri, "tool");
  // As generic tools do: the default partition.
  BusReader<RunManifest> manifests(tool, {""}, "t1");
  BusReader<PolicyWeights> weights(tool, {""}, "t2");
  BusReader<LearnerStatus> learners(tool, {""}, "t3");
  BusReader<WorkerStatus> workers(tool, {""}, "t4");
  BusReader<RolloutSegment> segments(tool, {""}, "t5");
  BusReader<EpisodeSummary> summaries(tool, {""}, "t6");
  BusReader<SimFrame> frames(tool, {""}, "t7");
  BusWriter<ControlCommand> commands(tool, run_partition("hub"), "t8");
  BusReader<RobotStatus> robots(tool, {""}, "t9");
  // A gateway, whom the learner hears in the partition of the run.
  BusWriter<RobotStatus> robot_writer(tool, run_partition("hub"), "g1");
  BusWriter<RolloutSegment> robot_segments(tool, run_partition("hub"), "g2", 16);
  RobotStatus robot;
  robot.gateway_id = 77;
  RolloutSegment of_robot;
  of_robot.source = Source::kDvrk;
  int seen[9] = {};
  std::uint32_t host_of_worker = 0;
  ControlCommand watch;
  watch.run_id = "hub";
  watch.action = ControlAction::kFramesOn;
  watch.frames_hz = 50;
  const auto count = [&seen](int i) {
    return [&seen, i](auto&& arrival) { seen[i] += arrival.info.valid ? 1 : 0; };
  };
  EXPECT_TRUE(test::eventually([&] {
    if (seen[6] == 0 && commands.matched() > 0) (void)commands.write(watch);
    (void)manifests.take(64, count(0));
    (void)weights.take(64, count(1));
    (void)learners.take(64, count(2));
    (void)workers.take(64, [&](Arrival<WorkerStatus>&& arrival) {
      seen[3] += arrival.info.valid ? 1 : 0;
      host_of_worker = arrival.record.pid;
    });
    (void)segments.take(64, [&](Arrival<RolloutSegment>&& arrival) {
      if (arrival.info.valid) ++seen[arrival.record.source == Source::kDvrk ? 8 : 4];
    });
    if (seen[7] == 0) (void)robot_writer.write(robot);
    if (seen[8] == 0) (void)robot_segments.write(of_robot);
    (void)robots.take(64, count(7));
    (void)summaries.take(64, count(5));
    (void)frames.take(64, count(6));
    return std::ranges::all_of(seen, [](int n) { return n > 0; });
  })) << testing::PrintToString(seen);
  EXPECT_EQ(host_of_worker, static_cast<std::uint32_t>(worker.pid()));
  programs.expect_goes_on_undisturbed("hub", learner);
}

}  // namespace
}  // namespace omentum
