#pragma once

#include <string>

#include "mismatch/import/file_pattern.h"
#include "mismatch/recording/bag_parts.h"
#include "mismatch/recording/read_recording.h"
#include "proto/import_map.pb.h"

namespace omentum {

// Bags of ROS 1 and ROS 2 in MCAP files (docs/import.md 8).

/// Whether the first messages of a file .mcap, or of the parts of a folder, are those of ROS.
/// Throws Error, naming the conversion, for a bag in a container of ROS itself (.bag, .db3, a
/// folder with metadata.yaml of such files).
bool is_bag(const std::string& path);

/// A bag, a file or the parts of a folder one after the other, as a recording: topics become
/// channels by the `ros` part of the map, else by their names in CRTK and their types. Messages are
/// decoded by the definitions in the file. Clouds and pictures stay in the file until they are
/// fetched; rows of numbers are held in memory. Times are those of header.stamp, of the log where
/// there is none, from the first of them on. What is left out is told in `warnings`, what became of
/// the others in `notes`. Throws Error, one line with file, byte and topic.
Recording read_bag(const std::string& path, const pb::ImportMap& map, Values values);

/// The bag of a file, or those of a folder that fit `ros.files`, in the order of their names.
/// Throws Error.
void import_bags(const pb::ImportMap& map, const std::string& input, const TakeRecording& take,
                 const TellLeftOut& left_out = nullptr);

}  // namespace omentum
