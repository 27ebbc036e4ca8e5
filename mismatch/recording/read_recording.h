#pragma once

#include <functional>
#include <string>
#include <vector>

#include "mismatch/recording/recording.h"

namespace omentum {

/// A recording folder or an MCAP file. Throws Error.
Recording read_recording(const std::string& path);

/// A recording that is done, under its name.
using TakeRecording = std::function<void(const std::string& name, const Recording& recording)>;

using ReadRecording = std::function<Recording(const std::string& path)>;

/// Told of one of several recordings that cannot be read and is left out: why, in one line.
using TellLeftOut = std::function<void(const std::string& path, const std::string& why)>;

/// What the recording of a file or folder is called.
std::string recording_name(const std::string& path);

/// The recording of a file or folder, or those of the folders and files .mcap in a case folder, in
/// the order of their names; `read` reads one of them. Throws Error, also for one of several that
/// cannot be read unless there is `left_out`, and where none can.
void for_each_recording(const std::string& path, const TakeRecording& take,
                        const ReadRecording& read = read_recording,
                        const TellLeftOut& left_out = nullptr);

/// The same for `paths`: read(path), then take of what was read. `read` throws Error.
void take_readable(const std::vector<std::string>& paths, const ReadRecording& read,
                   const std::function<void(const std::string& path, const Recording&)>& take,
                   const TellLeftOut& left_out);

}  // namespace omentum
