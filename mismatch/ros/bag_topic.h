#pragma once

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/mcap.h"
#include "mismatch/ros/frame_tree.h"
#include "mismatch/ros/images.h"
#include "mismatch/ros/topics.h"

namespace omentum {

/// A topic of a bag and what was taken of it: rows of numbers; of pictures and clouds only where
/// they lie.
class BagTopic {
 public:
  struct Found {
    std::int64_t time_ns = 0;
    McapPlace place;
  };

  /// Messages of which nothing can be read are counted, and left_out says why.
  BagTopic(const McapChannel& channel, const pb::RosMap& map);

  /// Takes a message; transforms go to the tree. Throws Error where it is none of its type.
  void take(const McapView& message, FrameTree& tree);
  /// Decodes a message of this topic. Throws Error.
  RosValue decode(std::string_view data) const;

  std::string name, type;
  RosKind kind = RosKind::kOther;
  RosEncoding encoding = RosEncoding::kRos1;
  std::shared_ptr<const RosSchema> schema;  ///< null: its messages cannot be read
  std::string left_out;                     ///< why nothing becomes of it
  std::vector<RosRole> roles;
  std::size_t messages = 0;
  std::size_t unstamped = 0;    ///< without header.stamp: at their log time
  std::size_t not_finite = 0;   ///< without a number that is finite where one is needed
  std::size_t in_part = 0;      ///< without orientation, or with more than nine joints
  std::size_t other_frame = 0;  ///< pictures or clouds in another frame than the first
  std::vector<std::map<std::string, RosRows>> rows;  ///< of each role, by frame
  std::vector<Found> frames;                         ///< pictures and clouds
  std::string frame;                                 ///< of the first picture, cloud or camera
  std::string picture;  ///< what the first picture is: encoding or format
  bool is_depth = false, is_color = false;
  std::uint32_t width = 0, height = 0;  ///< of the first picture; 0: not known
  pb::RecordingCamera camera;
  bool distorted = false;

 private:
  std::int64_t time_of(const RosValue& header, const McapView& message, bool log_time);
  void take_transforms(const RosValue& value, const McapView& message, FrameTree& tree);
  void take_row(const RosValue& value, const McapView& message, std::size_t role);
  void take_frame(const RosValue& value, const McapView& message);
};

/// A geometry_msgs Transform; the identity and false where it is none.
bool rigid_of(const RosValue& transform, Eigen::Isometry3d& X);

}  // namespace omentum
