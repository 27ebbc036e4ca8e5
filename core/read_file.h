#pragma once

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string>

#include "core/regular_file.h"

namespace omentum {

/// The whole content of a text file without its byte order mark. Fails, naming it, if it cannot be
/// opened or is no regular file: a pipe or device may never end.
inline Result<std::string> read_file(const std::string& path) {
  if (const Result<void> regular = require_regular_file(path); !regular)
    return Failure{regular.error()};
  std::ifstream file(path, std::ios::binary);
  if (!file) return Failure{fmt::format("{}: cannot be opened: {}", path, std::strerror(errno))};
  std::ostringstream text;
  text << file.rdbuf();
  std::string content = std::move(text).str();
  if (content.starts_with("\xef\xbb\xbf")) content.erase(0, 3);
  return content;
}

}  // namespace omentum
