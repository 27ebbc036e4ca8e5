#pragma once

#include <set>
#include <string>
#include <vector>

#include "mismatch/import/file_pattern.h"
#include "mismatch/recording/read_recording.h"
#include "proto/import_map.pb.h"

namespace omentum {

/// A mapping file (docs/import.md). Throws Error with file:line:column.
pb::ImportMap read_import_map(const std::string& path);

/// Recordings of a folder as a mapping file describes it, one after the other, in the order of
/// their files. Throws Error: a source without files, a column that is missing, two recordings of
/// one name, whatever cannot be read.
void import_mapped(const pb::ImportMap& map, const std::string& folder, const TakeRecording& take);

/// Sets one field, "a.b=value". Throws Error with what is wrong behind `where`.
void set_info_field(pb::RecordingInfo& info, const std::string& assignment,
                    const std::string& where);

/// Fields that a map gives a recording of that name. Throws Error.
pb::RecordingInfo mapped_info(const pb::ImportMap& map, const Values& values,
                              const std::string& name);

/// Throws Error where it is no name of a file, or one of `names`, which it joins.
void check_recording_name(const std::string& name, std::set<std::string>& names);

/// Paths from the folder of every regular file in it, sorted. Throws Error.
std::vector<std::string> files_below(const std::string& folder);

}  // namespace omentum
