#include "mismatch/recording/read_recording.h"

#include <algorithm>
#include <filesystem>

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
  return fs::is_directory(path) ? read_recording_folder(path) : read_recording_mcap(path);
}

void for_each_recording(const std::string& path, const TakeRecording& take,
                        const ReadRecording& read) {
  const fs::path input(path);
  if (!fs::is_directory(input)) return take(input.stem().string(), read(path));
  std::vector<fs::path> parts;
  if (!holds_recording(input)) {  // a case: a folder or a file a recording
    for (const auto& entry : fs::directory_iterator(input)) {
      const bool file = entry.is_regular_file() && entry.path().extension() == ".mcap";
      if (file || (entry.is_directory() && holds_recording(entry.path())))
        parts.push_back(entry.path());
    }
    std::sort(parts.begin(), parts.end());
  }
  if (parts.empty()) parts.push_back(input);
  for (const fs::path& part : parts) {
    const fs::path named = fs::absolute(part).lexically_normal();
    take(fs::is_directory(part) ? named.filename().string() : named.stem().string(),
         read(part.string()));
  }
}

}  // namespace omentum
