#pragma once

#include <cstdint>
#include <optional>
#include <shared_mutex>
#include <string>

#include "dvrk_gateway/bus/gateway_bus.h"
#include "dvrk_gateway/loop/session.h"

namespace omentum {

/// What ROS 2 reads of the arm by CRTK's names (docs/dvrk.md 10): rt/ARM/measured_cp, the pose of
/// the control point in the arm's reference frame, when it is new and valid; and
/// rt/ARM/operating_state, when it changes and ten times a second. Reliable, volatile, the last
/// one; no write waits. Another publisher of one of these names, as a second gateway of the arm or
/// the robot's own bridge, is a line in the log: readers get both.
class RosTopics final : public GatewayObserver, public BusMember {
 public:
  /// `participant` must outlive it, or leave() comes first. `arm` is a token of a ROS name
  /// (check_bus_options()). Throws Error: one line, for topics or writers that cannot be made.
  RosTopics(const dds::Participant& participant, const std::string& arm);

  /// Beside on_period(), which never waits for them.
  void leave() override;
  void join(const dds::Participant& participant) override;

  void on_period(const Period& period) override;

  /// Samples that were not written. The thread of on_period().
  std::uint64_t write_failures() const { return write_failures_; }

 private:
  struct Entities {
    Entities(const dds::Participant& joined, const TopicSpec& pose_spec,
             const TopicSpec& state_spec);
    const dds::Participant& participant;
    dds::Topic pose_topic, state_topic;
    dds::Writer pose, state;
  };

  void look_for_others();
  void publish_pose(const RobotState& robot);
  void publish_state(const RobotState& robot);
  void write(dds::Writer& writer, const void* sample);

  std::string pose_name_, state_name_;  // the specs point at them
  TopicSpec pose_spec_, state_spec_;
  std::shared_mutex joining_;         ///< held alone by who makes or ends the entities
  std::optional<Entities> entities_;  // guarded by joining_
  std::int64_t pose_told_ns_ = 0;     ///< of the newest pose that was published
  std::int64_t state_told_ns_ = 0;    ///< when the state was published last
  OperatingState state_;              ///< as published last
  std::uint64_t write_failures_ = 0;
  std::int64_t looked_ns_ = 0;  ///< for other publishers
  std::size_t others_ = 0;      ///< as told last
};

}  // namespace omentum
