#pragma once

#include <memory>
#include <set>
#include <string>
#include <vector>

#include "mismatch/import/file_pattern.h"
#include "mismatch/recording/recording.h"
#include "mismatch/ros/bag_topic.h"

namespace omentum {

/// Makes a recording of one bag, in one file or several (read_bag() in mismatch/ros/bag.h).
class BagReader {
 public:
  BagReader(std::vector<std::string> parts, const pb::ImportMap& map, Values values);
  /// Once. Throws Error.
  Recording read();

 private:
  using Topics = std::vector<std::shared_ptr<BagTopic>>;

  void state_frames();
  void scan();
  void scan(std::size_t part);
  std::shared_ptr<BagTopic> topic_of(const McapChannel& channel);
  void keep_one_arm();
  std::shared_ptr<BagTopic> choose(const std::string& to, bool (*fits)(const BagTopic&));
  Eigen::Isometry3d pose_of(const std::string& frame, const std::string& topic);
  void set_reference();
  std::string anchor_of(const std::string& frame) const;
  bool stands_apart(const std::string& frame, std::string& why) const;
  bool leave_out_apart(std::shared_ptr<BagTopic>& topic);
  void set_camera();
  std::shared_ptr<BagTopic> camera_topic() const;
  void add_series();
  void add_frames();
  template <typename T, typename Decode>
  void set_frames(const std::shared_ptr<BagTopic>& topic, const char* to, Frames<T>& frames,
                  Decode decode);
  void shift_times();
  void tell();
  void tell(const BagTopic& topic);
  void tell_odd(const BagTopic& topic);
  void warn(const std::string& text);
  std::string topic_names() const;

  const std::vector<std::string> parts_;
  const std::string path_;  ///< the file, or the folder of several
  const pb::ImportMap& map_;
  Values values_;
  Recording recording_;
  FrameTree tree_;
  bool stated_ = false;  ///< the map says what W is
  std::set<std::string> taken_for_W_;
  /// What the recording stands in: "W", or the root of its transforms; empty: not known.
  std::string reference_, reference_topic_, arm_frame_;
  Topics topics_;
  std::string arm_;                                     ///< whose names are known; empty: none
  std::shared_ptr<BagTopic> depth_, color_, cloud_;     ///< null: none
  std::vector<std::shared_ptr<McapFetcher>> fetchers_;  ///< of each part
};

}  // namespace omentum
