#include "mismatch/recording/read_recording.h"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <utility>

#include "core/check.h"
#include "core/file_name.h"
#include "mismatch/recording/bag_parts.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/recording_mcap.h"
#include "mismatch/recording/table_columns.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

bool holds_recording(const fs::path& folder) {
  for (const std::string_view file : kTableFiles) {
    if (fs::exists(folder / file)) return true;
  }
  return fs::exists(folder / "clouds.csv") || fs::exists(folder / "depth.csv");
}

}  // namespace

Recording read_recording(const std::string& path) {
  if (!parts_of_bag(path).empty())
    throw_error("{}: a bag of ROS, needed what `mismatch import` makes of it", path);
  return fs::is_directory(path) ? read_recording_folder(path) : read_recording_mcap(path);
}

std::string recording_name(const std::string& path) {
  const fs::path named = fs::absolute(path).lexically_normal();
  return fs::is_directory(named) ? named.filename().string() : named.stem().string();
}

void for_each_recording(const std::string& path, const TakeRecording& take,
                        const ReadRecording& read, const TellLeftOut& left_out) {
  const fs::path input(path);
  if (!fs::is_directory(input)) return take(input.stem().string(), read(path));
  std::vector<fs::path> parts;
  if (!holds_recording(input) && parts_of_bag(path).size() < 2) {  // a case: one recording each
    for (const auto& entry : fs::directory_iterator(input)) {
      const std::string name = entry.path().string();
      if (is_hidden(name)) continue;  // of a Mac or an editor
      const bool file = entry.is_regular_file() && has_ending(name, ".mcap");
      const bool folder =
          entry.is_directory() && (holds_recording(entry.path()) || !parts_of_bag(name).empty());
      if (file || folder) parts.push_back(entry.path());
    }
    std::sort(parts.begin(), parts.end());
  }
  if (parts.empty()) parts.push_back(input);
  std::vector<std::string> paths;
  for (const fs::path& part : parts) paths.push_back(part.string());
  const auto take_named = [&](const std::string& part, const Recording& recording) {
    take(recording_name(part), recording);
  };
  take_readable(paths, read, take_named, left_out);
}

void take_readable(const std::vector<std::string>& paths, const ReadRecording& read,
                   const std::function<void(const std::string& path, const Recording&)>& take,
                   const TellLeftOut& left_out) {
  std::vector<std::pair<std::string, std::string>> refused;  // path and why
  for (const std::string& path : paths) {
    std::optional<Recording> recording;
    try {
      recording = read(path);
    } catch (const Error& error) {
      if (left_out == nullptr || paths.size() == 1) throw;
      refused.emplace_back(path, error.what());
      continue;
    }
    take(path, *recording);
  }
  if (refused.size() == paths.size())
    throw_error("none of {} recordings can be read; the first: {}", paths.size(),
                refused.front().second);
  for (const auto& [path, why] : refused) left_out(path, why);
}

}  // namespace omentum
