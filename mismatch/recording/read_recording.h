#pragma once

#include <functional>
#include <string>

#include "mismatch/recording/recording.h"

namespace omentum {

/// A recording folder or an MCAP file. Throws Error.
Recording read_recording(const std::string& path);

/// A recording that is done, under its name.
using TakeRecording = std::function<void(const std::string& name, const Recording& recording)>;

using ReadRecording = std::function<Recording(const std::string& path)>;

/// The recording of a file or folder, or those of the folders and files .mcap in a case folder, in
/// the order of their names; `read` reads one of them. Throws Error.
void for_each_recording(const std::string& path, const TakeRecording& take,
                        const ReadRecording& read = read_recording);

}  // namespace omentum
