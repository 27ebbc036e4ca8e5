#pragma once

#include <functional>
#include <string>

#include "mismatch/recording/recording.h"

namespace omentum {

/// A recording folder or an MCAP file. Throws Error.
Recording read_recording(const std::string& path);

/// A recording that is done, under its name.
using TakeRecording = std::function<void(const std::string& name, const Recording& recording)>;

/// The recording of a file or folder, or those of the folders in a case folder, in the order of
/// their names. Throws Error.
void for_each_recording(const std::string& path, const TakeRecording& take);

}  // namespace omentum
