#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/recording/recording.h"
#include "mismatch/ros/message.h"

namespace omentum {

/// Rows of one topic of ROS that become a part of a channel. Columns appear as they are met; what a
/// row lacks is NaN.
class RosRows {
 public:
  void begin_row(std::int64_t time_ns);
  std::size_t column(const std::string& name);
  void set(std::size_t column, double value);
  void set(const std::string& name, double value) { set(column(name), value); }
  std::size_t rows() const { return series_.time_ns.size(); }
  Series take();

 private:
  Series series_;
};

/// What the messages of a topic are taken for: the columns they fill.
struct RosColumns {
  std::string stem;                   ///< of a pose: tip_measured_
  std::string source;                 ///< of joints and jaw: measured, commanded, setpoint
  bool linear_known = false;          ///< `linear` is stated
  std::vector<std::uint32_t> linear;  ///< joints in m, from 1
};

/// Numbers of joints by their names. Those of the dVRK (yaw, pitch, insertion, roll, wrist_pitch,
/// wrist_yaw, jaw, with anything before an underscore) and q1, joint_2, ... have theirs; other
/// names are numbered by their places in the first message that has them, and keep their numbers.
class RosJointNames {
 public:
  /// Of each joint of a message, from 1; by place where names are missing or stand twice.
  std::vector<std::uint32_t> numbers(const std::vector<RosValue>& names, std::size_t count);
  /// Messages whose joints stood in another order than those of the first.
  std::size_t reordered() const { return reordered_; }
  /// "q1 outer_yaw, q2 ..." where names and places are not the same; else empty.
  std::string told() const;

 private:
  std::vector<std::string> by_number_;  ///< from 1; empty: none
  std::vector<std::uint32_t> first_numbers_;
  bool of_robot_ = false;
  std::size_t reordered_ = 0;
};

/// What became of a message; kNothing: no number in it that is needed is finite, there is no row.
enum class RowTaken { kNothing, kPart, kAll };

/// Position and orientation of a geometry_msgs Pose or Transform; an orientation that is no unit
/// quaternion is left out (kPart). This and the others throw Error where a field is missing.
RowTaken add_pose_row(const RosValue& pose, std::int64_t time_ns, const std::string& stem,
                      RosRows& rows);

/// x, y, z of one marker.
RowTaken add_marker_row(const RosValue& pose, std::int64_t time_ns, const std::string& marker,
                        RosRows& rows);

/// geometry_msgs Wrench times a factor: force and torque.
RowTaken add_wrench_row(const RosValue& wrench, std::int64_t time_ns, double factor, RosRows& rows);

/// sensor_msgs/JointState by the names of the joints. A joint is in m where `linear` says so; else
/// where its name has "insertion" in it; without names, and of q1, q2, ..., joint 3. Joints from
/// the tenth on are left out (kPart).
RowTaken add_joint_row(const RosValue& state, std::int64_t time_ns, const RosColumns& columns,
                       RosJointNames& names, RosRows& rows);

/// The first joint of a sensor_msgs/JointState as jaw_measured_rad ...; velocity and effort only of
/// the measured one.
RowTaken add_jaw_row(const RosValue& state, std::int64_t time_ns, const std::string& source,
                     RosRows& rows);

/// One channel of several parts, rows in the order of time. Rows of one time become one where they
/// do not contradict each other; else the first stays, and `dropped` counts the others.
Series merge_rows(std::vector<Series> parts, std::size_t& dropped);

/// Forces of the frame of the tip become forces in W by the orientation of the tip; those of the
/// base B of the robot by X_WB where it is given, and torques about its origin become torques about
/// the tip. `tool`: columns tip_measured_, in W. Rows at times when the tip is not known are left
/// out and counted.
Series wrench_at_tip(const Series& wrench, const Series& tool,
                     const std::optional<Eigen::Isometry3d>& X_WB, std::size_t& dropped);

}  // namespace omentum
