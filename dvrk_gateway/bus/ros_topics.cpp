#include "dvrk_gateway/bus/ros_topics.h"

#include <Eigen/Geometry>
#include <mutex>

#include "core/clock.h"
#include "core/dds_discovery.h"
#include "core/log.h"
#include "dvrk_gateway/bus/robot_account.h"
#include "ros.h"

namespace omentum {
namespace {

constexpr std::int64_t kStatePeriodNs = 100'000'000;
constexpr std::int64_t kLookNs = 2'000'000'000;

/// As rmw_cyclonedds_cpp offers a topic with ROS 2's default profile, but for the depth.
TopicSpec spec_of(const std::string& name) {
  return {TopicId::kRobotState,  // no topic of ours: only name and policies are looked at
          name.c_str(),          true, History::kKeepLast, 1,
          Durability::kVolatile, 0,    100'000'000,        0};
}

/// Of an arrival by the steady clock, in the time that ROS 2 has: since 1970 UTC.
std_msgs_msg_dds__Header_ header_of(std::int64_t arrival_ns, const char* frame) {
  const std::int64_t time_ns = wall_now_ns() - (steady_now_ns() - arrival_ns);
  std_msgs_msg_dds__Header_ header{};
  header.stamp.sec = static_cast<std::int32_t>(time_ns / 1'000'000'000);
  header.stamp.nanosec = static_cast<std::uint32_t>(time_ns % 1'000'000'000);
  header.frame_id = const_cast<char*>(frame);  // the C types have no const; never written through
  return header;
}

}  // namespace

RosTopics::Entities::Entities(const dds::Participant& joined, const TopicSpec& pose_spec,
                              const TopicSpec& state_spec)
    : participant(joined),
      pose_topic(joined, pose_spec, geometry_msgs_msg_dds__PoseStamped__desc),
      state_topic(joined, state_spec, crtk_msgs_msg_dds__OperatingState__desc),
      pose(joined, pose_topic, {.partitions = {""}, .entity_name = "ros-measured_cp"}),
      state(joined, state_topic, {.partitions = {""}, .entity_name = "ros-operating_state"}) {}

RosTopics::RosTopics(const dds::Participant& participant, const std::string& arm)
    : pose_name_("rt/" + arm + "/measured_cp"),
      state_name_("rt/" + arm + "/operating_state"),
      pose_spec_(spec_of(pose_name_)),
      state_spec_(spec_of(state_name_)) {
  RosTopics::join(participant);
}

void RosTopics::leave() {
  const std::lock_guard alone(joining_);
  entities_.reset();
}

void RosTopics::join(const dds::Participant& participant) {
  const std::lock_guard alone(joining_);
  entities_.emplace(participant, pose_spec_, state_spec_);
}

void RosTopics::look_for_others() {
  const std::int64_t now_ns = steady_now_ns();
  if (now_ns - looked_ns_ < kLookNs) return;
  looked_ns_ = now_ns;
  const std::size_t poses = dds::other_writers(entities_->participant, pose_name_);
  const std::size_t others = poses + dds::other_writers(entities_->participant, state_name_);
  if (others > others_) {
    log().warn(
        "event=ros_publishers_meet topic={} others={} readers get both: one of them ends, or takes "
        "another --arm",
        poses > 0 ? pose_name_ : state_name_, others);
  }
  others_ = others;
}

void RosTopics::on_period(const Period& period) {
  // This thread hears the operator, too: it waits for nobody.
  const std::shared_lock joined(joining_, std::try_to_lock);
  if (!joined || !entities_) return;
  look_for_others();
  publish_pose(period.robot);
  publish_state(period.robot);
}

void RosTopics::publish_pose(const RobotState& robot) {
  const Stream<CartesianPose>& stream = robot.measured_cp;
  if (!stream.seen || !stream.payload.valid || stream.advanced_ns == pose_told_ns_) return;
  pose_told_ns_ = stream.advanced_ns;
  const Eigen::Quaterniond q = Eigen::Quaterniond(stream.payload.rotation).normalized();
  const Eigen::Vector3d& p = stream.payload.translation;
  geometry_msgs_msg_dds__PoseStamped_ pose{};
  pose.header = header_of(stream.advanced_ns, robot.reference_frame.data());
  pose.pose.position = {p.x(), p.y(), p.z()};
  pose.pose.orientation = {q.x(), q.y(), q.z(), q.w()};
  write(entities_->pose, &pose);
}

void RosTopics::publish_state(const RobotState& robot) {
  const Stream<OperatingState>& stream = robot.operating_state;
  if (!stream.seen) return;
  if (stream.payload == state_ && stream.arrival_ns - state_told_ns_ < kStatePeriodNs) return;
  state_ = stream.payload;
  state_told_ns_ = stream.arrival_ns;
  crtk_msgs_msg_dds__OperatingState_ state{};
  state.header = header_of(stream.arrival_ns, "");
  state.state = const_cast<char*>(operating_state_word(state_.state));
  state.is_homed = state_.is_homed;
  state.is_busy = state_.is_busy;
  write(entities_->state, &state);
}

void RosTopics::write(dds::Writer& writer, const void* sample) {
  const Result<void> sent = writer.write(sample);
  if (sent) return;
  ++write_failures_;
  log().warn("event=not_published reason=\"{}\"", sent.error());  // the log counts what repeats
}

}  // namespace omentum
