#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "core/result.h"
#include "core/types.h"

namespace omentum {

/// Replaces `path` so that a crash at any moment leaves the old or the new content: temporary file
/// beside it, fsync, rename, fsync of the folder. On failure (full disk) the old file is untouched
/// and the temporary one removed.
Result<void> write_durably(const std::string& path, std::span<const std::byte> bytes);

/// The whole file. Fails on files above `limit` bytes.
Result<Bytes> read_whole(const std::string& path, std::size_t limit = std::size_t{1} << 32);

}  // namespace omentum
