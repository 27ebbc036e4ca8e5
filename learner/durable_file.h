#pragma once

#include <cstddef>
#include <cstdio>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "core/result.h"
#include "core/types.h"

namespace omentum {

/// Replaces `path` so that a crash at any moment leaves the old or the new content: temporary file
/// beside it, fsync, rename, fsync of the folder. On failure (full disk) the old file is untouched
/// and the temporary one removed.
Result<void> write_durably(const std::string& path, std::span<const std::byte> bytes);

/// The whole file. Fails on what is no regular file.
Result<Bytes> read_whole(const std::string& path);

/// Appends to a file, flushing after every piece.
class AppendFile {
 public:
  /// Throws Error when it cannot be opened.
  explicit AppendFile(const std::string& path);
  Result<void> append(std::string_view bytes);

 private:
  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };
  std::string path_;
  std::unique_ptr<std::FILE, Close> file_;
};

}  // namespace omentum
