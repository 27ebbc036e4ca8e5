#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>

#include "core/result.h"
#include "core/types.h"

namespace omentum {

/// Replaces `path` so that a crash at any moment leaves the old or the new content: temporary file
/// beside it, fsync, rename, fsync of the folder. On failure (full disk) the old file is untouched
/// and the temporary one removed. Two writers of one path at a time spoil each other's temporary
/// file, PATH.tmp. A missing folder is made. A device or pipe is written into: root would put a
/// file in the place of /dev/null.
Result<void> write_durably(const std::string& path, std::span<const std::byte> bytes);
Result<void> write_durably(const std::string& path, std::string_view text);

/// The whole file. Fails on what is no regular file.
Result<Bytes> read_whole(const std::string& path);

/// A file that grows piece by piece. Not thread-safe.
class AppendFile {
 public:
  /// `header` is what an empty file begins with. Throws Error when it cannot be opened.
  explicit AppendFile(std::string path, std::string header = {});
  ~AppendFile();
  AppendFile(const AppendFile&) = delete;
  AppendFile& operator=(const AppendFile&) = delete;

  /// Appends all of `bytes` or, on failure (full disk), nothing. A file that was removed is begun
  /// again, its folder too.
  Result<void> append(std::string_view bytes);

 private:
  Result<void> open();
  Result<void> write(std::string_view bytes);

  std::string path_, header_;
  int fd_ = -1;
};

}  // namespace omentum
