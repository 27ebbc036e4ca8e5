#pragma once

#include <string>

#include "core/registration.h"
#include "core/result.h"

namespace omentum {

/// registration.txtpb (docs/formats.md 9, proto/registration.proto).

std::string print_registration(const Registration& registration);
/// Durable: the old file or the new one.
Result<void> save_registration(const std::string& path, const Registration& registration);

/// Throws Error, one line with path:line:column or the field: syntax, a number out of range, an
/// unknown instrument, a date that is none, a rotation that is none, fewer than 4 points in the
/// fit, a pose, a residual or a figure that does not follow from the points (an edited file).
Registration load_registration(const std::string& path);
/// As above from a text that is called `name` in errors.
Registration parse_registration(const std::string& name, const std::string& text);

}  // namespace omentum
