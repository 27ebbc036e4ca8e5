#pragma once

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "core/result.h"

namespace omentum {

/// The whole content of a text file without its byte order mark. Fails, naming it, if it cannot be
/// opened, is a folder or a device, which may never end.
inline Result<std::string> read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file || std::filesystem::is_directory(path) || std::filesystem::is_character_file(path))
    return Failure{fmt::format("{}: cannot be opened", path)};
  std::ostringstream text;
  text << file.rdbuf();
  std::string content = std::move(text).str();
  if (content.starts_with("\xef\xbb\xbf")) content.erase(0, 3);
  return content;
}

}  // namespace omentum
