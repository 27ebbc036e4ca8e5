// What the gateway records, and what is left of it when something goes wrong.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <thread>

#include "core/read_file.h"
#include "core/segment_fields.h"
#include "dvrk_gateway/recording/motion.h"
#include "dvrk_gateway/recording/robot_recorder.h"
#include "proto/foxglove.pb.h"
#include "tests/dvrk_gateway/recorded_session.h"
#include "tests/support/episode_fixture.h"
#include "tests/support/small_disk.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::messages_of;
using test::RecordedSession;
using testing::HasSubstr;

Vector3d position(const foxglove::PoseInFrame& pose) {
  const foxglove::Vector3& p = pose.pose().position();
  return {p.x(), p.y(), p.z()};
}

/// The file of these periods.
std::string record(const RecordingSetup& setup, const std::vector<Period>& periods) {
  std::ostringstream out;
  RecordingFile file(out, setup);
  for (const Period& period : periods) file.add_period(period);
  EXPECT_TRUE(file.finish().has_value());
  return out.str();
}

TEST(Recording, HoldsWhatTheRobotSaidAndWhatItWasTold) {
  RecordedSession session;
  const std::vector<Period> periods = session.take(100);
  const std::string bytes = record(test::recording_setup(session.mount), periods);
  const McapContent content = read_mcap(bytes);
  ASSERT_TRUE(content.complete);
  ASSERT_THAT(content.problems, testing::IsEmpty());
  EXPECT_EQ(content.channels.at(content.messages.front().channel).topic, "/recording");
  for (const char* topic : {"/tool", "/tool_commanded", "/tool_setpoint", "/joints",
                            "/joints_commanded", "/joints_setpoint", "/latency"})
    EXPECT_EQ(content.of_topic(topic).size(), 100U) << topic;
  EXPECT_EQ(content.of_topic("/frames").size(), 1U);
  EXPECT_EQ(content.of_topic("/jaw").size(), 200U) << "commanded and measured";

  const auto poses = messages_of<foxglove::PoseInFrame>(content, "/tool");
  const auto commanded = messages_of<foxglove::PoseInFrame>(content, "/tool_commanded");
  const auto joints = messages_of<foxglove::JointStates>(content, "/joints_commanded");
  for (std::size_t k = 0; k < periods.size(); ++k) {
    const CartesianPose& said = periods[k].robot.measured_cp.payload;
    EXPECT_LT((position(poses[k]) - session.tip(said.rotation, said.translation)).norm(), 1e-15);
    EXPECT_EQ(poses[k].frame_id(), "W");
    EXPECT_NEAR(
        static_cast<double>(poses[k].timestamp().seconds()) + 1e-9 * poses[k].timestamp().nanos(),
        said.timestamp_s, 1e-9)
        << "the robot's own clock";
    PsmJoints q{};
    for (std::size_t j = 0; j < 6; ++j) q[j] = joints[k].joints(static_cast<int>(j)).position();
    const PsmPose by_joints = psm_forward(q);
    EXPECT_LT((position(commanded[k]) - session.tip(by_joints.R, by_joints.p)).norm(), 1e-9);
  }
  const McapMessage& last = *content.of_topic("/tool").back();
  EXPECT_EQ(static_cast<std::int64_t>(last.log_time), periods.back().robot.measured_cp.arrival_ns);
  const foxglove::JointState insertion =
      messages_of<foxglove::JointStates>(content, "/joints").back().joints(2);
  EXPECT_EQ(insertion.name(), "insertion");
  EXPECT_TRUE(insertion.has_velocity());
  EXPECT_TRUE(insertion.has_effort());
}

TEST(Recording, IsAMotionForReplay) {
  RecordedSession session;
  const std::string bytes = record(test::recording_setup(session.mount), session.take(50));
  const auto motion = parse_motion("session.mcap", bytes);
  ASSERT_TRUE(motion) << motion.error();
  ASSERT_EQ(motion.value().size(), session.goals.size());
  for (std::size_t k = 0; k < session.goals.size(); ++k) {
    const RobotCommand& goal = session.goals[k];
    const MotionSample& sample = motion.value()[k];
    EXPECT_LT((sample.p_WT - session.tip(goal.rotation, goal.translation)).norm(), 1e-15);
    EXPECT_EQ(sample.jaw_rad, goal.jaw);
  }
}

TEST(Recording, PosesGoThroughTheBaseFrameOfTheConsole) {
  RecordingSetup setup = test::recording_setup(test::turned_mount());
  setup.X_AR.translation() = Vector3d(0.3, 0, 0);
  setup.X_AR.linear() = Eigen::AngleAxisd(0.5, Vector3d::UnitZ()).toRotationMatrix();
  const PsmJoints q = {0.1, 0.1, 0.2, 0.1, 0.1, 0.1};
  const PsmPose pose = psm_forward(q);
  std::ostringstream out;
  RecordingFile file(out, setup);
  RobotState robot;
  robot.measured_cp.seen = true;
  robot.measured_cp.arrival_ns = robot.measured_cp.advanced_ns = 7;
  robot.measured_cp.payload.valid = true;
  robot.measured_cp.payload.rotation = setup.X_AR.linear() * pose.R;
  robot.measured_cp.payload.translation = setup.X_AR * pose.p;
  file.add_robot(robot, 7);
  RobotCommand by_joints;
  by_joints.kind = RobotCommand::Kind::kServoJp;
  std::copy(q.begin(), q.end(), by_joints.joints.begin());
  file.add_command(by_joints, 8);
  RobotCommand by_pose;
  by_pose.kind = RobotCommand::Kind::kServoCp;
  by_pose.rotation = robot.measured_cp.payload.rotation;
  by_pose.translation = robot.measured_cp.payload.translation;
  file.add_command(by_pose, 9);
  ASSERT_TRUE(file.finish().has_value());
  const McapContent content = read_mcap(out.str());
  const Vector3d p_WT =
      setup.mount.X_WR * (pose.p + pose.R * Vector3d(0, 0, setup.mount.tip_offset));
  EXPECT_LT((position(messages_of<foxglove::PoseInFrame>(content, "/tool")[0]) - p_WT).norm(),
            1e-15);
  for (const auto& goal : messages_of<foxglove::PoseInFrame>(content, "/tool_commanded"))
    EXPECT_LT((position(goal) - p_WT).norm(), 1e-15);
  for (const auto& joints : messages_of<foxglove::JointStates>(content, "/joints_commanded")) {
    for (std::size_t j = 0; j < 6; ++j)
      EXPECT_NEAR(joints.joints(static_cast<int>(j)).position(), q[j], 1e-12);
  }
}

TEST(Recording, WritesASampleOnceAndCountsWhatIsNotValid) {
  RecordedSession session;
  Period period = session.next();
  Period again = period;
  again.number = 2;
  again.began_ns += 20'000'000;
  again.judgement.send = false;
  again.sent_ns = 0;
  Period resent = again;  // the same measurement in a later datagram
  resent.number = 3;
  resent.robot.measured_cp.arrival_ns += 20'000'000;
  Period invalid = resent;
  invalid.number = 4;
  invalid.began_ns += 1'100'000'000;
  invalid.robot.measured_cp.arrival_ns += 40'000'000;
  invalid.robot.measured_cp.advanced_ns += 40'000'000;
  invalid.robot.measured_cp.payload.valid = false;
  Period later = invalid;
  later.number = 7;
  later.began_ns += 1'100'000'000;
  const McapContent content = read_mcap(
      record(test::recording_setup(session.mount), {period, again, resent, invalid, later}));
  EXPECT_EQ(content.of_topic("/tool").size(), 1U);
  EXPECT_EQ(content.of_topic("/joints").size(), 1U);
  EXPECT_EQ(content.of_topic("/tool_commanded").size(), 1U);
  const auto states = messages_of<pb::RobotStateSample>(content, "/robot_state");
  ASSERT_EQ(states.size(), 3U) << "the first, and once a second";
  EXPECT_EQ(states[0].state(), "ENABLED");
  EXPECT_EQ(states[1].invalid_payloads(), 1U);
  EXPECT_EQ(states[2].unseen_periods(), 2U) << "5 and 6";
}

TEST(Recording, TellsEveryChangeOfTheSafetyFunction) {
  RecordedSession session;
  std::vector<Period> periods = session.take(6);
  const auto set = [&](std::size_t k, SafetyPhase phase, StopReason reason, int part, bool now) {
    periods[k].judgement.memory.phase = phase;
    periods[k].judgement.finding = {reason, 0.07, 0.05, part};
    periods[k].judgement.stopped_now = now;
  };
  set(0, SafetyPhase::kWaiting, StopReason::kStale, 0, false);
  set(1, SafetyPhase::kWaiting, StopReason::kStale, 0, false);  // no change
  set(2, SafetyPhase::kWaiting, StopReason::kStale, 1, false);  // another stream
  set(3, SafetyPhase::kActive, StopReason::kNone, -1, false);
  set(4, SafetyPhase::kStopped, StopReason::kOutsideBox, 2, true);
  set(5, SafetyPhase::kStopped, StopReason::kOutsideBox, 2, false);
  const McapContent content = read_mcap(record(test::recording_setup(session.mount), periods));
  const auto events = messages_of<pb::SafetyEvent>(content, "/safety");
  ASSERT_EQ(events.size(), 4U);
  EXPECT_EQ(events[0].reason_name(), "STALE");
  EXPECT_EQ(events[0].value(), 0.07);
  EXPECT_EQ(events[1].part(), 1);
  EXPECT_EQ(events[2].reason(), 0);
  EXPECT_FALSE(events[2].has_text());
  EXPECT_TRUE(events[3].stopped());
  EXPECT_EQ(events[3].text(), describe({StopReason::kOutsideBox, 0.07, 0.05, 2}));
  EXPECT_EQ(events[3].period(), 5U);
}

TEST(Recording, CutAnywhereHasItsWholeSeconds) {
  RecordedSession session;
  std::ostringstream out;
  RecordingFile file(out, test::recording_setup(session.mount));
  std::map<std::size_t, std::size_t> messages_at;  // by size of the file after a flush
  for (int second = 0; second < 3; ++second) {
    for (const Period& period : session.take(10)) file.add_period(period);
    file.flush();
    messages_at[out.str().size()] = read_mcap(out.str()).messages.size();
  }
  ASSERT_TRUE(file.finish().has_value());
  const std::string bytes = out.str();
  EXPECT_GE(messages_at.begin()->second, 80U);
  std::set<std::size_t> sizes;  // the ends of the seconds, and every 13th byte
  for (const auto& [size, count] : messages_at) sizes.insert({size, size + 1, size + 2});
  for (std::size_t size = *sizes.begin(); size < bytes.size(); size += 13) sizes.insert(size);
  sizes.erase(sizes.lower_bound(bytes.size()), sizes.end());
  for (const std::size_t size : sizes) {
    const McapContent content = read_mcap(std::string_view(bytes).substr(0, size));
    const auto whole = std::prev(messages_at.upper_bound(size));
    ASSERT_GE(content.messages.size(), whole->second) << "cut at byte " << size;
    ASSERT_FALSE(content.problems.empty()) << "and says so";
  }
}

class Recorder : public testing::Test {
 protected:
  RobotRecorderOptions options(const std::string& name) {
    RobotRecorderOptions options;
    options.path = name.starts_with('/') ? name : folder_ / name;
    options.setup = test::recording_setup(session_.mount);
    options.min_free_bytes = 0;
    options.longest_queue = 100'000;
    return options;
  }
  McapContent read(const std::string& name) {
    const Result<std::string> bytes = read_file(folder_ / name);
    EXPECT_TRUE(bytes) << bytes.error();
    return bytes ? read_mcap(bytes.value()) : McapContent{};
  }
  test::TempDir folder_;
  RecordedSession session_;
};

TEST_F(Recorder, WritesWhatItIsTold) {
  RobotRecorder recorder(options("runs/a.mcap"));
  for (const Period& period : session_.take(60)) recorder.on_period(period);
  const auto force = std::make_shared<pb::ForceSample>();
  force->set_fz_n(0.25);
  recorder.add_sample("/force", force, 5);
  recorder.count_bad_source_line();
  ASSERT_TRUE(recorder.finish().has_value());
  ASSERT_TRUE(recorder.finish().has_value()) << "again";
  const McapContent content = read("runs/a.mcap");
  EXPECT_TRUE(content.complete);
  EXPECT_EQ(content.of_topic("/latency").size(), 60U);
  EXPECT_EQ(messages_of<pb::ForceSample>(content, "/force").at(0).fz_n(), 0.25);
  EXPECT_EQ(recorder.lost(), 0U);
}

TEST_F(Recorder, ASessionThatDidNotBeginLeavesNoFile) {
  {
    RobotRecorder recorder(options("a.mcap"));
    EXPECT_TRUE(std::filesystem::exists(folder_ / "a.mcap"));
  }
  EXPECT_FALSE(std::filesystem::exists(folder_ / "a.mcap"));
}

TEST_F(Recorder, FlushesEverySecondOfTheSession) {
  RobotRecorder recorder(options("a.mcap"));
  for (const Period& period : session_.take(160)) recorder.on_period(period);
  ASSERT_TRUE(recorder.finish().has_value());
  EXPECT_GE(read("a.mcap").chunks, 4U);  // head, 3.2 s
}

TEST_F(Recorder, AKilledProcessLeavesAReadableFile) {
  const std::string path = folder_ / "a.mcap";
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    RobotRecorder recorder(options("a.mcap"));
    // Until three seconds of it can be read by others, but not for ever.
    for (int k = 0; k < 100'000; ++k) {
      recorder.on_period(session_.next());
      if (k % 50 == 49 && k > 200) {
        const Result<std::string> bytes = read_file(path);
        if (bytes && read_mcap(bytes.value()).of_topic("/tool").size() >= 150) break;
      }
    }
    ::kill(::getpid(), SIGKILL);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFSIGNALED(status));
  const McapContent content = read("a.mcap");
  EXPECT_FALSE(content.complete);
  EXPECT_GE(content.of_topic("/tool").size(), 150U);
  EXPECT_TRUE(load_motion(path).has_value());
}

TEST_F(Recorder, AFullDiskStopsTheArmAndIsToldWithWhatWasLost) {
  RobotRecorder recorder(options("a.mcap"));
  int faults = 0;
  recorder.stop_on_failure([&faults] { ++faults; });
  std::uint64_t given = 0;
  {
    const test::SmallDisk disk(100'000);
    for (; faults == 0 && given < 100'000; ++given) recorder.on_period(session_.next());
    ASSERT_EQ(faults, 1);
    recorder.on_period(session_.next());
    EXPECT_EQ(faults, 1);
  }
  const Result<void> finished = recorder.finish();
  ASSERT_FALSE(finished.has_value());
  EXPECT_THAT(finished.error(), HasSubstr("a.mcap: File too large; "));
  EXPECT_GE(recorder.lost(), 1U);
  EXPECT_LE(recorder.lost(), given + 1);
  EXPECT_GE(read("a.mcap").of_topic("/tool").size(), 50U) << "what was there before";
}

TEST_F(Recorder, ADiskThatIsFullAtTheStartIsOneLine) {
  try {
    RobotRecorder recorder(options("/dev/full"));
    FAIL() << "taken";
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "--record /dev/full: No space left on device");
  }
}

TEST_F(Recorder, ADiskThatStandsStillStopsTheArm) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  RobotRecorderOptions stuck = options("/dev/fd/" + std::to_string(ends[1]));
  stuck.longest_queue = 50;
  RobotRecorder recorder(stuck);
  close(ends[1]);
  std::atomic<bool> fault{false};
  recorder.stop_on_failure([&] { fault = true; });
  // Nobody reads: the pipe is full after 64 kB.
  for (int k = 0; !fault && k < 100'000; ++k) recorder.on_period(session_.next());
  EXPECT_TRUE(fault);
  EXPECT_GE(recorder.lost(), 1U);
  std::thread reader([end = ends[0]] {
    std::array<char, 65536> memory{};
    while (::read(end, memory.data(), memory.size()) > 0) {
    }
  });
  const Result<void> finished = recorder.finish();
  reader.join();
  close(ends[0]);
  ASSERT_FALSE(finished.has_value());
  EXPECT_THAT(finished.error(), HasSubstr("the disk takes nothing"));
}

TEST_F(Recorder, ReplacesNothingAndWantsRoom) {
  std::ofstream(folder_ / "there.mcap") << "precious";
  const auto refusal = [](const RobotRecorderOptions& options) -> std::string {
    try {
      RobotRecorder recorder(options);
      return "taken";
    } catch (const Error& error) {
      return error.what();
    }
  };
  EXPECT_THAT(refusal(options("there.mcap")), HasSubstr("there.mcap: exists"));
  EXPECT_EQ(read_file(folder_ / "there.mcap").value(), "precious");
  EXPECT_THAT(refusal(options("there.mcap/a.mcap")), HasSubstr("cannot be made"));
  RobotRecorderOptions large = options("large.mcap");
  large.min_free_bytes = std::uint64_t{1} << 62;
  EXPECT_THAT(refusal(large), HasSubstr("MB free on the disk, needed 4611686018427 MB"));
  EXPECT_FALSE(std::filesystem::exists(large.path));
}

TEST_F(Recorder, HoldsSeveralEpisodesThatOurReadersOpen) {
  const EpisodeRecording first = test::make_episode(20, 0), second = test::make_episode(31, 0);
  RobotRecorderOptions with_context = options("a.mcap");
  with_context.context = first.context;
  {
    RobotRecorder recorder(with_context);
    for (const Period& period : session_.take(100)) recorder.on_period(period);
    recorder.on_episode(first.task, first.segment);
    for (const Period& period : session_.take(100)) recorder.on_period(period);
    recorder.on_episode(second.task, second.segment);
    ASSERT_TRUE(recorder.finish().has_value());
  }
  const auto episodes = parse_episodes("a", read_file(with_context.path).value());
  ASSERT_TRUE(episodes) << episodes.error();
  ASSERT_EQ(episodes.value().size(), 2U);
  EXPECT_EQ(episodes.value()[0].segment.actions, first.segment.actions);
  EXPECT_EQ(episodes.value()[1].segment.actions, second.segment.actions);
  EXPECT_EQ(episodes.value()[1].segment.state_hashes, second.segment.state_hashes);
  for (const EpisodeRecording& episode : episodes.value()) EXPECT_TRUE(episode.problems.empty());
  const auto one = load_episode(with_context.path);
  ASSERT_TRUE(one) << one.error();
  EXPECT_EQ(one.value().segment.steps, 20U);
  EXPECT_THAT(one.value().problems, testing::ElementsAre(HasSubstr("2 episodes are there")));
}

}  // namespace
}  // namespace omentum
