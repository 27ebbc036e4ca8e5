#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <ostream>
#include <string>
#include <string_view>

#include "core/episode_recording.h"
#include "core/mcap.h"
#include "core/psm.h"
#include "dvrk_gateway/loop/control_loop.h"
#include "proto/recording_folder.pb.h"
#include "proto/robot_recording.pb.h"

namespace omentum {

/// What does not change while a recording is made. Frames: docs/conventions.md, A as in safety.h.
struct RecordingSetup {
  pb::RecordingInfo info;
  ToolMount mount;                                         ///< X_WR, tip offset, instrument
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();  ///< base frame, as on the console
  std::int64_t start_ns = 0;  ///< of the clock that all times here are of: log time 0
};

/// The MCAP file of a robot (docs/formats.md 10): turns what the robot says and what it is told
/// into messages. Measured samples are written once, at their arrival, when their Timestamp moved
/// on; payloads that are not valid are counted. One thread.
class RecordingFile {
 public:
  /// Writes /recording and /frames. The stream must outlive it and start at byte 0. What happened
  /// before setup.start_ns gets log time 0.
  RecordingFile(std::ostream& out, const RecordingSetup& setup);

  /// What is new in it: poses, joints, jaw; operating state and counters on change of the state and
  /// once a second. `now_ns`: of the state.
  void add_robot(const RobotState& robot, std::int64_t now_ns, std::uint64_t cut = 0,
                 std::uint64_t unsent = 0);
  /// A goal that was sent; of kHold nothing is written.
  void add_command(const RobotCommand& command, std::int64_t sent_ns);
  /// A goal of the jaw alone [rad].
  void add_jaw_goal(double jaw_rad, std::int64_t sent_ns);
  /// All of a control period: robot, safety function, times, and the command that was sent; in a
  /// dry run the one that would have been.
  void add_period(const Period& period);
  /// An episode of a policy whose last decision ended at `end_ns`. Fails where the arrays of the
  /// segment do not fit.
  Result<void> add_episode(const RolloutTask& task, const RolloutSegment& segment,
                           const RecordingContext& context, std::int64_t end_ns);

  /// A sample of another sensor; its channel is declared with the first one of a topic.
  void add_sample(const std::string& topic, const google::protobuf::Message& sample,
                  std::int64_t arrival_ns);
  void count_bad_source_line() { ++bad_source_lines_; }

  /// What is there so far is in the stream and survives a kill.
  void flush() { writer_.flush(); }
  /// The file is whole; nothing may be added afterwards. Fails if the stream did at any time.
  Result<void> finish() { return writer_.finish(); }

  std::uint64_t invalid_payloads() const { return invalid_; }
  std::uint64_t unseen_periods() const { return unseen_; }

 private:
  using Channel = McapWriter::ChannelId;
  void write(Channel channel, std::int64_t time_ns, const google::protobuf::Message& message);
  void write_frames();
  void write_pose(Channel channel, std::int64_t time_ns, std::int64_t stamp_ns,
                  const CartesianPose& pose);
  void take_pose(Channel channel, const Stream<CartesianPose>& now, Stream<CartesianPose>& before);
  void take_joints(Channel channel, const Stream<JointState>& now, Stream<JointState>& before);
  void take_jaw(const RobotState& robot);
  void take_state(const RobotState& robot, std::int64_t now_ns, std::uint64_t cut,
                  std::uint64_t unsent);
  void add_safety(const Period& period);
  void add_latency(const Period& period);
  std::uint64_t log_time(std::int64_t time_ns) const;

  McapWriter writer_;
  std::int64_t start_ns_;
  ToolMount mount_;
  Eigen::Isometry3d X_WA_, X_AR_;
  Channel recording_, tool_, tool_commanded_, tool_setpoint_, joints_, joints_commanded_,
      joints_setpoint_, jaw_channel_, frames_, safety_, robot_state_, latency_;
  EpisodeWriter episodes_;
  std::map<std::string, Channel> late_channels_;
  std::map<Channel, std::uint32_t> counts_;

  RobotState before_;  ///< as last recorded
  pb::JawSample jaw_;  ///< newest values
  double roll_ = 0;    ///< of the last goal, towards which an inverse is unwrapped [rad]
  std::int64_t state_written_ns_ = 0;
  bool state_written_ = false, period_seen_ = false;
  std::uint64_t last_period_ = 0;
  SafetyPhase phase_ = SafetyPhase::kListening;
  Finding finding_;
  bool dry_run_;
  std::uint64_t invalid_ = 0, unseen_ = 0, bad_source_lines_ = 0;
};

}  // namespace omentum
