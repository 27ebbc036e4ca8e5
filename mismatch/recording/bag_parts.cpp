#include "mismatch/recording/bag_parts.h"

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>

#include "core/check.h"
#include "core/file_name.h"
#include "core/mcap.h"
#include "mismatch/recording/text_table.h"

namespace omentum {

namespace fs = std::filesystem;

namespace {

/// Names below "relative_file_paths:" of metadata.yaml, which ros2 writes one a line.
std::vector<std::string> listed_parts(const std::string& yaml) {
  std::vector<std::string> names;
  std::istringstream lines(yaml);
  bool listed = false;
  for (std::string line; std::getline(lines, line);) {
    const std::size_t begin = line.find_first_not_of(" \t");
    const std::size_t end = line.find_last_not_of(" \t\r");
    if (begin == std::string::npos) continue;
    std::string_view text = std::string_view(line).substr(begin, end + 1 - begin);
    if (text == "relative_file_paths:") {
      listed = true;
      continue;
    }
    if (!listed) continue;
    if (!text.starts_with("- ")) break;
    text.remove_prefix(2);
    if (text.size() > 1 && (text.front() == '"' || text.front() == '\'') &&
        text.back() == text.front())
      text = text.substr(1, text.size() - 2);
    // Older ones write the name of the folder, too: parts lie in it, and nowhere else.
    names.push_back(fs::path(text).filename().string());
  }
  return names;
}

/// FOLDER_0.mcap, FOLDER_1.mcap ... of a folder whose recorder was killed before it wrote
/// metadata.yaml, in the order of their first stamps; none where there are other files .mcap too.
std::vector<std::string> unlisted_parts(const fs::path& folder) {
  const std::string stem = fs::absolute(folder / "").lexically_normal().parent_path().filename();
  std::vector<std::pair<std::uint64_t, std::string>> parts;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const fs::path& path = entry.path();
    if (is_hidden(path.string()) || !has_ending(path.string(), ".mcap")) continue;
    const std::string name = path.stem().string();
    const std::string number = name.starts_with(stem + "_") ? name.substr(stem.size() + 1) : "";
    if (number.empty() || number.find_first_not_of("0123456789") != std::string::npos) return {};
    std::ifstream in(path, std::ios::binary);
    McapReader reader(in);
    McapView message;
    if (!entry.is_regular_file() || !reader.next(message)) continue;  // nothing was written
    parts.emplace_back(message.log_time, path.string());
  }
  std::ranges::sort(parts);
  std::vector<std::string> paths;
  for (auto& [first_ns, path] : parts) paths.push_back(std::move(path));
  return paths.size() > 1 ? paths : std::vector<std::string>();
}

}  // namespace

void refuse_bag_container(const char* kind, const std::string& path) {
  throw_error("{}: a bag of {}, allowed MCAP: mcap convert {} {}", path, kind, path,
              fs::path(path).replace_extension(".mcap").filename().string());
}

std::vector<std::string> parts_of_bag(const std::string& folder,
                                      std::vector<std::string>* missing) {
  const fs::path in(folder);
  if (!fs::is_directory(in)) return {};
  if (!fs::is_regular_file(in / "metadata.yaml")) return unlisted_parts(in);
  std::vector<std::string> parts;
  for (const std::string& name : listed_parts(read_whole_file((in / "metadata.yaml").string()))) {
    fs::path part = in / name;
    const bool packed = has_ending(name, ".zstd") || has_ending(name, ".zst");
    if (packed && !fs::exists(part)) part.replace_extension();  // it was unpacked by hand
    if (has_ending(name, ".db3")) refuse_bag_container("ROS 2 in SQLite", part.string());
    if (packed && fs::exists(in / name))
      throw_error("{}: a part of a bag that is compressed as a whole file: zstd -d {}, then again",
                  part.string(), part.string());
    if (!has_ending(part.string(), ".mcap")) continue;
    if (!fs::is_regular_file(part)) {
      if (missing != nullptr) missing->push_back(part.string());
      continue;
    }
    parts.push_back(part.string());
  }
  return parts;
}

}  // namespace omentum
