#include "mismatch/ros/bag.h"

#include <fmt/format.h>

#include <filesystem>
#include <fstream>
#include <set>

#include "core/check.h"
#include "core/regular_file.h"
#include "mismatch/import/import_map.h"
#include "mismatch/ros/bag_reader.h"
#include "mismatch/ros/topics.h"

namespace omentum {

namespace fs = std::filesystem;

bool is_bag(const std::string& path) {
  const fs::path file(path);
  const auto other = [&](const char* kind, const fs::path& found) {
    throw_error("{}: a bag of {}, allowed MCAP: mcap convert {} {}", found.string(), kind,
                found.string(), fs::path(found).replace_extension(".mcap").filename().string());
  };
  if (fs::is_directory(file)) {
    if (!fs::exists(file / "metadata.yaml")) return false;
    for (const auto& entry : fs::directory_iterator(file)) {
      if (entry.path().extension() == ".db3") other("ROS 2 in SQLite", entry.path());
    }
    return false;
  }
  if (file.extension() == ".bag") other("ROS 1", file);
  if (file.extension() == ".db3") other("ROS 2 in SQLite", file);
  if (const Result<void> regular = require_regular_file(path); !regular)
    throw_error("{}", regular.error());
  std::ifstream in(path, std::ios::binary);
  McapReader reader(in);
  constexpr int kEnough = 100;  // logs of other programs may come first
  McapView message;
  for (int k = 0; k < kEnough && reader.next(message); ++k) {
    const McapChannel& channel = reader.channels().at(message.channel);
    if (channel.encoding == "ros1" || channel.encoding == "cdr") return true;
    if (channel.topic == "/recording") return false;
  }
  return false;
}

Recording read_bag(const std::string& path, const pb::ImportMap& map, Values values) {
  values["file"] = fs::path(path).stem().string();
  return BagReader(path, map, std::move(values)).read();
}

void import_bags(const pb::ImportMap& map, const std::string& input, const TakeRecording& take) {
  if (map.source_size() > 0) throw_error("ros: with source, allowed one of them");
  check_ros_map(map.ros());
  const Result<FilePattern> pattern = FilePattern::parse(map.ros().files());
  if (!pattern) throw_error("ros.files: {}", pattern.error());
  std::vector<std::pair<std::string, Values>> bags;
  if (!fs::is_directory(input)) {
    auto parts = pattern.value().match(fs::path(input).filename().string());
    if (!parts && map.ros().has_files())
      throw_error("{}: does not fit ros.files \"{}\"", input, map.ros().files());
    bags.emplace_back(input, parts.value_or(Values()));
  } else {
    for (const std::string& path : files_below(input)) {
      if (auto parts = pattern.value().match(path))
        bags.emplace_back((fs::path(input) / path).string(), std::move(*parts));
    }
    if (bags.empty()) throw_error("{}: no file fits ros.files \"{}\"", input, map.ros().files());
  }
  std::set<std::string> names;
  for (auto& [path, parts] : bags) {
    if (!is_bag(path)) throw_error("{}: no bag of ROS in MCAP", path);
    const Recording recording = read_bag(path, map, std::move(parts));
    check_recording_name(recording.info.name(), names);
    take(recording.info.name(), recording);
  }
}

}  // namespace omentum
