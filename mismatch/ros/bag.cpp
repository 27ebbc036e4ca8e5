#include "mismatch/ros/bag.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>

#include "core/check.h"
#include "core/file_name.h"
#include "core/regular_file.h"
#include "mismatch/import/import_map.h"
#include "mismatch/ros/bag_reader.h"
#include "mismatch/ros/topics.h"

namespace omentum {

namespace fs = std::filesystem;

bool is_bag(const std::string& path) {
  const fs::path file(path);
  if (fs::is_directory(file)) {
    const std::vector<std::string> parts = parts_of_bag(path);
    return !parts.empty() && is_bag(parts.front());
  }
  if (has_ending(path, ".bag")) refuse_bag_container("ROS 1", path);
  if (has_ending(path, ".db3")) refuse_bag_container("ROS 2 in SQLite", path);
  if (has_ending(path, ".mcap.zstd") || has_ending(path, ".mcap.zst"))
    throw_error("{}: compressed as a whole file: zstd -d {}, then again", path, path);
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

namespace {

/// What is to be said of a file that is one of the parts of a bag; else empty.
std::string told_part(const fs::path& file) {
  try {
    const std::string folder = file.parent_path().string();
    const std::vector<std::string> all = parts_of_bag(folder);
    for (const std::string& part : all) {
      if (all.size() > 1 && fs::path(part).filename() == file.filename())
        return fmt::format(
            "one of {} parts of a bag: `mismatch import {}` takes all of them as one recording",
            all.size(), folder);
    }
  } catch (const Error&) {  // of the other parts, which nobody asked for
  }
  return "";
}

}  // namespace

Recording read_bag(const std::string& path, const pb::ImportMap& map, Values values) {
  const fs::path named = fs::absolute(path).lexically_normal();
  std::vector<std::string> parts = {path}, missing;
  const bool folder = fs::is_directory(path);
  if (folder) parts = parts_of_bag(path, &missing);
  if (parts.empty()) throw_error("{}: no bag of ROS in MCAP", path);
  values["file"] = parts.size() > 1
                       ? (named.has_filename() ? named : named.parent_path()).filename().string()
                       : fs::path(parts.front()).stem().string();
  Recording recording = BagReader(parts, map, std::move(values)).read();
  for (const std::string& part : missing)
    recording.warnings.push_back(fmt::format(
        "{}: metadata.yaml names this part, and it is not there: what it held is missing", part));
  if (const std::string told = folder ? "" : told_part(named); !told.empty())
    recording.warnings.push_back(fmt::format("{}: {}", path, told));
  return recording;
}

void import_bags(const pb::ImportMap& map, const std::string& input, const TakeRecording& take,
                 const TellLeftOut& left_out) {
  if (map.source_size() > 0) throw_error("ros: with source, allowed one of them");
  check_ros_map(map.ros());
  const Result<FilePattern> pattern = FilePattern::parse(map.ros().files());
  if (!pattern) throw_error("ros.files: {}", pattern.error());
  const auto match = [&](std::string path) {
    // What nobody stated fits capitals too.
    if (!map.ros().has_files() && has_ending(path, ".mcap"))
      path.replace(path.size() - 5, 5, ".mcap");
    return pattern.value().match(path);
  };
  std::vector<std::string> bags;
  std::map<std::string, Values> values_of;
  if (!fs::is_directory(input)) {
    auto parts = match(fs::path(input).filename().string());
    if (!parts && map.ros().has_files())
      throw_error("{}: does not fit ros.files \"{}\"", input, map.ros().files());
    bags.push_back(input);
    values_of[input] = parts.value_or(Values());
  } else {
    std::set<std::string> folders;  // bags in several parts
    for (const std::string& path : files_below(input)) {
      const fs::path file = fs::path(input) / path;
      auto values = match(path);
      // What nobody stated fits the parts in the folders of bags, too.
      if (!values && !map.ros().has_files() && has_ending(path, ".mcap") &&
          !parts_of_bag(file.parent_path().string()).empty())
        values = match(file.filename().string());
      if (!values) continue;
      const bool of_several = !told_part(fs::absolute(file)).empty();
      const std::string bag = of_several ? file.parent_path().string() : file.string();
      if (of_several && !folders.insert(bag).second) continue;
      bags.push_back(bag);
      values_of[bag] = std::move(*values);
    }
    if (bags.empty()) throw_error("{}: no file fits ros.files \"{}\"", input, map.ros().files());
  }
  std::set<std::string> names;
  const auto read = [&](const std::string& path) {
    if (!is_bag(path)) throw_error("{}: no bag of ROS in MCAP", path);
    return read_bag(path, map, values_of[path]);
  };
  const auto take_named = [&](const std::string&, const Recording& recording) {
    check_recording_name(recording.info.name(), names);
    take(recording.info.name(), recording);
  };
  take_readable(bags, read, take_named, left_out);
}

}  // namespace omentum
