#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace omentum {

/// A moment, in ns since 1970-01-01 UTC, as 2026-01-31T12:00:00Z: whole seconds, rounded down.
std::string utc_text(std::int64_t ns);
/// The moment that such a text names, of the years 1970 ... 2200; nothing for any other text.
std::optional<std::int64_t> parse_utc(std::string_view text);

}  // namespace omentum
