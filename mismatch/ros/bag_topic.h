#pragma once

#include <map>
#include <memory>
#include <optional>
#include <set>
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
    std::int64_t time_ns = 0;  ///< by settle(), before it the number of its stamp
    McapPlace place;
    std::size_t part = 0;  ///< of a bag in several files
  };

  /// Messages of which nothing can be read are counted, and left_out says why.
  BagTopic(const McapChannel& channel, const pb::RosMap& map);

  /// Takes a message of a part of the bag; transforms go to the tree. One that is none of its type
  /// or claims what it does not hold is counted and left out.
  void take(const McapView& message, std::size_t part, FrameTree& tree);
  /// Decodes a message of this topic, packed by itself or not; it goes with the next call. Throws
  /// Error.
  RosValue decode(std::string_view data) const;
  /// Once, behind the last message: when pictures and rows were, by header.stamp or the log.
  void settle();
  /// Rows of a role with their times.
  Series rows_of(std::size_t role, RosRows& found) const;

  std::string name, type;
  RosKind kind = RosKind::kOther;
  RosEncoding encoding = RosEncoding::kRos1;
  std::shared_ptr<const RosSchema> schema;  ///< null: its messages cannot be read
  std::string left_out;                     ///< why nothing becomes of it
  std::vector<RosRole> roles;
  std::size_t messages = 0;
  std::size_t damaged = 0;      ///< that are none of their type
  std::string first_damage;     ///< byte and reason of the first of them
  bool of_log = false;          ///< times are those of the log
  std::set<std::string> told;   ///< what was odd, one line each
  std::size_t not_finite = 0;   ///< without a number that is finite where one is needed
  std::size_t in_part = 0;      ///< without orientation, or with more than nine joints
  std::size_t other_frame = 0;  ///< pictures or clouds in another frame than the first
  std::size_t other_kind = 0;   ///< pictures of another size or encoding than the first
  std::vector<std::map<std::string, RosRows>> rows;  ///< of each role, by frame
  std::vector<Found> frames;                         ///< pictures and clouds
  std::string frame;                                 ///< of the first picture, cloud or camera
  std::string picture;  ///< what the first picture is: encoding or format
  bool is_depth = false, is_color = false;
  std::uint32_t width = 0, height = 0;  ///< of the first picture; 0: not known
  std::optional<RosCamera> camera;
  std::vector<RosJointNames> joint_names;  ///< of each role

 private:
  void take_known(const McapView& message, std::size_t part, FrameTree& tree);
  std::int64_t stamp_of(const RosValue& header, const McapView& message,
                        std::vector<RosStamp>& stamps);
  void take_transforms(const RosValue& value, const McapView& message, FrameTree& tree);
  void take_row(const RosValue& value, const McapView& message, std::size_t role);
  void take_frame(const RosValue& value, const McapView& message, std::size_t part);
  void begin_pictures(const RosValue& value);
  bool is_like_first(const RosValue& value);

  std::vector<std::vector<RosStamp>> stamps_;  ///< of the messages of each role, then of pictures
  std::vector<RosTimes> times_;                ///< the same, settled
  mutable std::string unpacked_;
};

/// A geometry_msgs Transform; the identity and false where it is none.
bool rigid_of(const RosValue& transform, Eigen::Isometry3d& X);

}  // namespace omentum
