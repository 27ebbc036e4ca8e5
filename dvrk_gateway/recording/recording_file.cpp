#include "dvrk_gateway/recording/recording_file.h"

#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <cmath>

#include "dvrk_gateway/safety/tool_point.h"
#include "proto/foxglove.pb.h"

namespace omentum {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::int64_t kStateInterval_ns = 1'000'000'000;
constexpr std::array<const char*, 6> kJoints = {"yaw",  "pitch",       "insertion",
                                                "roll", "wrist_pitch", "wrist_yaw"};
// Seven joints while the robot homes (docs/dvrk.md 4.4).
constexpr std::array<const char*, 7> kHomingJoints = {"yaw",    "pitch",  "insertion", "disc_1",
                                                      "disc_2", "disc_3", "disc_4"};

google::protobuf::Timestamp stamp(std::int64_t time_ns) {
  return google::protobuf::util::TimeUtil::NanosecondsToTimestamp(time_ns);
}
std::int64_t ns_of(double t_s) {
  // A robot's Timestamp is any number; beyond 100 years it is not one to be shown.
  constexpr double kLongest_s = 3e9;
  return std::isfinite(t_s) ? std::llround(1e9 * std::clamp(t_s, 0.0, kLongest_s)) : 0;
}
double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

void put(const Vector3d& p, foxglove::Vector3& out) {
  out.set_x(p.x());
  out.set_y(p.y());
  out.set_z(p.z());
}
void put(const Matrix3d& R, foxglove::Quaternion& out) {
  const Quaterniond q(R);
  out.set_x(q.x());
  out.set_y(q.y());
  out.set_z(q.z());
  out.set_w(q.w());
}

std::string joint_name(int index, int count) {
  const auto k = static_cast<std::size_t>(index);
  if (count == 6) return kJoints[k];
  if (count == 7) return kHomingJoints[k];
  return fmt::format("joint_{}", index + 1);
}

foxglove::JointStates joint_states(const JointState& joints, std::int64_t stamp_ns) {
  foxglove::JointStates states;
  *states.mutable_timestamp() = stamp(stamp_ns);
  for (int k = 0; k < joints.count; ++k) {
    const auto i = static_cast<std::size_t>(k);
    foxglove::JointState& joint = *states.add_joints();
    joint.set_name(joint_name(k, joints.count));
    joint.set_position(joints.position[i]);
    if (k < joints.velocity_count) joint.set_velocity(joints.velocity[i]);
    if (k < joints.effort_count) joint.set_effort(joints.effort[i]);
  }
  return states;
}

const char* command_name(RobotCommand::Kind kind) {
  switch (kind) {
    case RobotCommand::Kind::kHold:
      return "hold";
    case RobotCommand::Kind::kServoCp:
      return "servo_cp";
    case RobotCommand::Kind::kServoJp:
      return "servo_jp";
  }
  return "";
}

/// A robot sends its state again and again; new is what it measured anew. Robots of old do not say
/// when they measured.
template <typename Payload>
bool is_new(const Stream<Payload>& now, const Stream<Payload>& before) {
  if (!now.seen || (before.seen && now.arrival_ns == before.arrival_ns)) return false;
  return !before.seen || now.advanced_ns != before.advanced_ns || now.payload != before.payload;
}

}  // namespace

RecordingFile::RecordingFile(std::ostream& out, const RecordingSetup& setup)
    : writer_(out),
      start_ns_(setup.start_ns),
      mount_(setup.mount),
      X_WA_(setup.mount.X_WR * setup.X_AR.inverse()),
      X_AR_(setup.X_AR),
      recording_(writer_.add_channel("/recording", *pb::RecordingInfo::descriptor())),
      tool_(writer_.add_channel("/tool", *foxglove::PoseInFrame::descriptor())),
      tool_commanded_(writer_.add_channel("/tool_commanded", *foxglove::PoseInFrame::descriptor())),
      tool_setpoint_(writer_.add_channel("/tool_setpoint", *foxglove::PoseInFrame::descriptor())),
      joints_(writer_.add_channel("/joints", *foxglove::JointStates::descriptor())),
      joints_commanded_(
          writer_.add_channel("/joints_commanded", *foxglove::JointStates::descriptor())),
      joints_setpoint_(
          writer_.add_channel("/joints_setpoint", *foxglove::JointStates::descriptor())),
      jaw_channel_(writer_.add_channel("/jaw", *pb::JawSample::descriptor())),
      frames_(writer_.add_channel("/frames", *foxglove::FrameTransforms::descriptor())),
      safety_(writer_.add_channel("/safety", *pb::SafetyEvent::descriptor())),
      robot_state_(writer_.add_channel("/robot_state", *pb::RobotStateSample::descriptor())),
      latency_(writer_.add_channel("/latency", *pb::LatencySample::descriptor())),
      episodes_(writer_, false),
      dry_run_(setup.info.dry_run()) {
  for (const auto set : {&pb::JawSample::set_commanded_rad, &pb::JawSample::set_measured_rad,
                         &pb::JawSample::set_setpoint_rad, &pb::JawSample::set_velocity_rad_per_s,
                         &pb::JawSample::set_effort_nm, &pb::JawSample::set_timestamp_s})
    (jaw_.*set)(kNotKnown);
  write(recording_, start_ns_, setup.info);
  write_frames();
  flush();  // however early the file is cut off, it says what it is of
}

std::uint64_t RecordingFile::log_time(std::int64_t time_ns) const {
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, time_ns - start_ns_));
}

void RecordingFile::write(Channel channel, std::int64_t time_ns,
                          const google::protobuf::Message& message) {
  writer_.write(channel, log_time(time_ns), counts_[channel]++, message);
}

void RecordingFile::add_sample(const std::string& topic, const google::protobuf::Message& sample,
                               std::int64_t arrival_ns) {
  const auto found = late_channels_.find(topic);
  const Channel channel = found != late_channels_.end()
                              ? found->second
                              : writer_.add_channel(topic, *sample.GetDescriptor());
  late_channels_.emplace(topic, channel);
  write(channel, arrival_ns, sample);
}

void RecordingFile::write_frames() {
  foxglove::FrameTransforms frames;
  const auto add = [&frames](const char* parent, const char* child, const Isometry3d& X) {
    foxglove::FrameTransform& frame = *frames.add_transforms();
    *frame.mutable_timestamp() = stamp(0);
    frame.set_parent_frame_id(parent);
    frame.set_child_frame_id(child);
    put(X.translation(), *frame.mutable_translation());
    put(X.linear(), *frame.mutable_rotation());
  };
  Isometry3d X_CT = Isometry3d::Identity();
  X_CT.translation().z() = mount_.tip_offset;
  add("W", "R", mount_.X_WR);
  add("R", "A", X_AR_.inverse());
  add("C", "T", X_CT);
  write(frames_, start_ns_, frames);
}

void RecordingFile::write_pose(Channel channel, std::int64_t time_ns, std::int64_t stamp_ns,
                               const CartesianPose& pose) {
  const Matrix3d R_WC = X_WA_.linear() * pose.rotation;
  foxglove::PoseInFrame message;
  *message.mutable_timestamp() = stamp(stamp_ns);
  message.set_frame_id("W");
  put(tip_of(mount_, R_WC, X_WA_ * pose.translation), *message.mutable_pose()->mutable_position());
  put(R_WC, *message.mutable_pose()->mutable_orientation());
  write(channel, time_ns, message);
}

void RecordingFile::take_pose(Channel channel, const Stream<CartesianPose>& now,
                              Stream<CartesianPose>& before) {
  if (!is_new(now, before)) return;
  before = now;
  if (now.payload.valid)
    write_pose(channel, now.arrival_ns, ns_of(now.payload.timestamp_s), now.payload);
  else
    ++invalid_;
}

void RecordingFile::take_joints(Channel channel, const Stream<JointState>& now,
                                Stream<JointState>& before) {
  if (!is_new(now, before)) return;
  before = now;
  if (now.payload.valid)
    write(channel, now.arrival_ns, joint_states(now.payload, ns_of(now.payload.timestamp_s)));
  else
    ++invalid_;
}

void RecordingFile::take_jaw(const RobotState& robot) {
  if (is_new(robot.jaw_setpoint_js, before_.jaw_setpoint_js)) {
    before_.jaw_setpoint_js = robot.jaw_setpoint_js;
    const JointState& setpoint = robot.jaw_setpoint_js.payload;
    if (setpoint.valid && setpoint.count == 1)
      jaw_.set_setpoint_rad(setpoint.position[0]);
    else
      ++invalid_;
  }
  if (!is_new(robot.jaw_measured_js, before_.jaw_measured_js)) return;
  before_.jaw_measured_js = robot.jaw_measured_js;
  const JointState& measured = robot.jaw_measured_js.payload;
  if (!measured.valid || measured.count != 1) {
    ++invalid_;
    return;
  }
  jaw_.set_measured_rad(measured.position[0]);
  jaw_.set_velocity_rad_per_s(measured.velocity_count == 1 ? measured.velocity[0] : kNotKnown);
  jaw_.set_effort_nm(measured.effort_count == 1 ? measured.effort[0] : kNotKnown);
  jaw_.set_timestamp_s(measured.timestamp_s);
  write(jaw_channel_, robot.jaw_measured_js.arrival_ns, jaw_);
}

void RecordingFile::take_state(const RobotState& robot, std::int64_t now_ns, std::uint64_t cut,
                               std::uint64_t unsent) {
  const bool changed = robot.operating_state.payload != before_.operating_state.payload;
  if (state_written_ && !changed && now_ns - state_written_ns_ < kStateInterval_ns) return;
  before_.operating_state = robot.operating_state;
  state_written_ = true;
  state_written_ns_ = now_ns;
  const OperatingState& state = robot.operating_state.payload;
  pb::RobotStateSample sample;
  sample.set_state(operating_state_word(state.state));
  sample.set_sub_state(state.sub_state.data());
  sample.set_homed(state.is_homed);
  sample.set_busy(state.is_busy);
  sample.set_valid(state.valid);
  sample.set_timestamp_s(state.timestamp_s);
  sample.set_datagrams(robot.datagrams);
  sample.set_malformed(robot.malformed);
  sample.set_foreign(robot.foreign);
  sample.set_unknown_keys(robot.unknown_keys);
  sample.set_not_finite(robot.not_finite);
  sample.set_reordered(robot.reordered);
  sample.set_restarts(robot.restarts);
  sample.set_cut(cut);
  sample.set_unsent(unsent);
  sample.set_invalid_payloads(invalid_);
  sample.set_unseen_periods(unseen_);
  sample.set_bad_source_lines(bad_source_lines_);
  write(robot_state_, now_ns, sample);
}

void RecordingFile::add_robot(const RobotState& robot, std::int64_t now_ns, std::uint64_t cut,
                              std::uint64_t unsent) {
  take_pose(tool_, robot.measured_cp, before_.measured_cp);
  take_pose(tool_setpoint_, robot.setpoint_cp, before_.setpoint_cp);
  take_joints(joints_, robot.measured_js, before_.measured_js);
  take_joints(joints_setpoint_, robot.setpoint_js, before_.setpoint_js);
  take_jaw(robot);
  take_state(robot, now_ns, cut, unsent);
}

void RecordingFile::add_command(const RobotCommand& command, std::int64_t sent_ns) {
  if (command.kind == RobotCommand::Kind::kHold) return;
  const std::int64_t stamp_ns = static_cast<std::int64_t>(log_time(sent_ns));
  CartesianPose goal;
  JointState joints;
  joints.count = 6;
  bool has_joints = true;
  if (command.kind == RobotCommand::Kind::kServoCp) {
    goal.rotation = command.rotation;
    goal.translation = command.translation;
    const Isometry3d X_RA = X_AR_.inverse();
    const InverseSolution found = psm_solve(
        {X_RA.linear() * goal.rotation, X_RA * goal.translation}, roll_, *mount_.instrument);
    has_joints = found.fault == InverseFault::kNone;
    std::copy(found.q.begin(), found.q.end(), joints.position.begin());
  } else {
    PsmJoints q{};
    std::copy(command.joints.begin(), command.joints.end(), q.begin());
    const PsmPose pose = psm_forward(q, *mount_.instrument);
    goal.rotation = X_AR_.linear() * pose.R;
    goal.translation = X_AR_ * pose.p;
    std::copy(q.begin(), q.end(), joints.position.begin());
    joints.velocity_count = 6;
    std::copy(command.joint_velocity.begin(), command.joint_velocity.end(),
              joints.velocity.begin());
  }
  write_pose(tool_commanded_, sent_ns, stamp_ns, goal);
  if (has_joints) {
    roll_ = joints.position[3];
    write(joints_commanded_, sent_ns, joint_states(joints, stamp_ns));
  } else {
    ++invalid_;
  }
  if (std::isfinite(command.jaw)) add_jaw_goal(command.jaw, sent_ns);
}

void RecordingFile::add_jaw_goal(double jaw_rad, std::int64_t sent_ns) {
  jaw_.set_commanded_rad(jaw_rad);
  write(jaw_channel_, sent_ns, jaw_);
}

void RecordingFile::add_safety(const Period& period) {
  const Judgement& judged = period.judgement;
  const SafetyPhase phase = judged.memory.phase;
  const bool changed = !period_seen_ || phase != phase_ || judged.stopped_now ||
                       judged.finding.reason != finding_.reason ||
                       judged.finding.part != finding_.part;
  phase_ = phase;
  finding_ = judged.finding;
  if (!changed) return;
  pb::SafetyEvent event;
  event.set_period(period.number);
  event.set_phase(static_cast<int>(phase));
  event.set_phase_name(safety_phase_name(phase));
  event.set_reason(static_cast<int>(finding_.reason));
  event.set_reason_name(stop_reason_name(finding_.reason));
  event.set_value(finding_.value);
  event.set_allowed(finding_.allowed);
  event.set_part(finding_.part);
  if (finding_) event.set_text(describe(finding_));
  event.set_stopped(judged.stopped_now);
  write(safety_, period.began_ns, event);
}

void RecordingFile::add_latency(const Period& period) {
  if (period_seen_ && period.number > last_period_) unseen_ += period.number - last_period_ - 1;
  pb::LatencySample sample;
  sample.set_period(period.number);
  sample.set_jitter_s(seconds(period.late_ns));
  const bool sent = period.sent_ns != 0;
  sample.set_latency_s(sent ? seconds(period.sent_ns - period.began_ns) : kNotKnown);
  sample.set_state_age_s(sent && period.state_ns != 0 ? seconds(period.sent_ns - period.state_ns)
                                                      : kNotKnown);
  sample.set_sent_bytes(static_cast<std::uint32_t>(sent ? period.sent_bytes : 0));
  if (period.judgement.send) sample.set_command(command_name(period.judgement.command.kind));
  last_period_ = period.number;
  write(latency_, period.began_ns, sample);
}

void RecordingFile::add_period(const Period& period) {
  add_safety(period);
  add_latency(period);
  period_seen_ = true;
  add_robot(period.robot, period.began_ns, period.cut, period.unsent);
  if (period.sent_ns != 0) {
    add_command(period.judgement.command, period.sent_ns);
  } else if (dry_run_ && period.judgement.send) {
    add_command(period.judgement.command, period.began_ns);
  }
}

Result<void> RecordingFile::add_episode(const RolloutTask& task, const RolloutSegment& segment,
                                        const RecordingContext& context, std::int64_t end_ns) {
  const auto lasted_ns =
      static_cast<std::int64_t>(std::llround(1e9 * segment.steps * context.control_period));
  return episodes_.write("episode", task, segment, context, log_time(end_ns - lasted_ns));
}

}  // namespace omentum
