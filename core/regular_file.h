#pragma once

#include <fmt/format.h>

#include <filesystem>
#include <string>
#include <system_error>

#include "core/result.h"

namespace omentum {

/// Success for a regular file or a link to one; else one line that names the path and what it is.
/// To be asked before a file is opened: opening a pipe without a writer never returns, a device
/// never ends, and a folder opens and cannot be read.
inline Result<void> require_regular_file(const std::string& path) {
  std::error_code failed;
  const std::filesystem::file_status status = std::filesystem::status(path, failed);
  const auto refused = [&path](const std::string& what) {
    return Failure{fmt::format("{}: cannot be opened: {}", path, what)};
  };
  switch (status.type()) {
    case std::filesystem::file_type::regular:
      return {};
    case std::filesystem::file_type::directory:
      return refused("a folder, needed a regular file");
    case std::filesystem::file_type::fifo:
      return refused("a pipe, needed a regular file: write what comes out of it to one first");
    case std::filesystem::file_type::socket:
      return refused("a socket, needed a regular file");
    case std::filesystem::file_type::character:
    case std::filesystem::file_type::block:
      return refused("a device, needed a regular file");
    default:
      return refused(failed ? failed.message() : "no regular file");
  }
}

}  // namespace omentum
