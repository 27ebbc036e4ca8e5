#pragma once

#include <Eigen/Geometry>
#include <map>
#include <string>

#include "core/result.h"

namespace omentum {

/// Frames of ROS and how they stand to W: from transforms that do not move, and what a mapping file
/// states.
class FrameTree {
 public:
  /// A frame that is W itself, beside "W".
  void set_world(const std::string& frame);
  /// The pose of a frame in W, whatever the transforms say.
  void state(const std::string& frame, const Eigen::Isometry3d& X_WF);
  /// A transform as it was seen; other values for the same two frames make it one that moves.
  void add(const std::string& parent, const std::string& child, const Eigen::Isometry3d& X_PC);
  bool is_world(const std::string& frame) const;
  /// Fails with one line: no chain of transforms to W, or one of them moves.
  Result<Eigen::Isometry3d> to_world(const std::string& frame) const;
  /// The first frame of its chain of transforms that do not move.
  std::string root(const std::string& frame) const;
  /// Pose in a frame of that chain; fails where it is none.
  Result<Eigen::Isometry3d> pose_in(const std::string& ancestor, const std::string& frame) const;

 private:
  struct Edge {
    std::string parent;
    Eigen::Isometry3d X_PC;
    bool moves = false;
  };
  std::string world_;
  std::map<std::string, Eigen::Isometry3d> stated_;
  std::map<std::string, Edge> edges_;  ///< by child
};

/// Older names begin with a slash.
std::string frame_name(std::string_view frame);

}  // namespace omentum
