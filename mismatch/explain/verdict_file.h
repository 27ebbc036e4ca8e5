#pragma once

#include <string>

#include "core/result.h"
#include "proto/verdict.pb.h"

namespace omentum {

/// verdict.json: the message as JSON under its field names (docs/formats.md 15).
std::string print_verdict(const pb::Verdict& verdict);

/// The verdict in such a text, as far as others may rely on it: its version is the one that this
/// program knows, its status is one of docs/formats.md 15, and an effect is there where the status
/// says so. Fields that are not known are passed over. It fails with one line that begins with
/// `path`.
Result<pb::Verdict> parse_verdict(const std::string& path, const std::string& text);

/// The verdict of a folder that `mismatch explain` wrote, or of its file. Throws Error.
pb::Verdict read_verdict(const std::string& folder);

}  // namespace omentum
