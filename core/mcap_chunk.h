#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "core/mcap.h"
#include "core/result.h"

// Chunks of MCAP files: what they are compressed with.

namespace omentum::mcap {

/// Name in chunk and chunk index: "", "lz4" or "zstd".
std::string_view name_of(McapCompression compression);

std::string compress(McapCompression compression, const std::string& records);

/// What compress(kZstd, ...) was given, in this program. Aborts on any other bytes: those of a file
/// are for unpack_frame().
std::string uncompress_zstd(const std::string& packed);

/// What one frame of zstd holds; it lies in `unpacked`. At most `most` bytes are unpacked. Total
/// over any bytes.
Result<std::string_view> unpack_frame(std::string_view packed, std::uint64_t most,
                                      std::string& unpacked);
/// Whether bytes begin as a frame of zstd or lz4 does.
bool is_packed_frame(std::string_view bytes);

/// Records of the content of a chunk record, checked against its CRC; they lie in `body` or in
/// `unpacked`. Total over any bytes; at most `most` bytes are unpacked.
Result<std::string_view> unpack_chunk(std::string_view body, std::uint64_t most,
                                      std::string& unpacked);

}  // namespace omentum::mcap
