#pragma once

#include <string>
#include <string_view>

#include "core/mcap.h"
#include "mismatch/recording/recording.h"

namespace omentum {

/// A recording as an MCAP file (docs/formats.md 13). Files of `dvrk_gateway` have the same channels
/// and are read alike. Clouds and pictures stay in the file until they are fetched. A truncated or
/// damaged file gives what can be read of it and a warning. Throws Error: no MCAP file, a message
/// that is none of its type, nothing of a recording in it.
Recording read_recording_mcap(const std::string& path);

/// Replaces `path` by a file that is whole: written beside it under another name, then renamed.
/// Equal recordings make equal files. Throws Error.
void write_recording_mcap(const Recording& recording, const std::string& path,
                          McapCompression compression = McapCompression::kZstd);

/// Points of a message foxglove.PointCloud in its frame, its pose applied. Total over any bytes;
/// fails where x, y or z is missing, or a point does not fit into the data. Points that are not
/// finite are left out.
Result<Cloud> decode_cloud(std::string_view data);

}  // namespace omentum
