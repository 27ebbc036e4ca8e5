#pragma once

#include <cstddef>
#include <string>

namespace omentum {

/// A text that may hold names of strangers, for a terminal: control characters but the end of a
/// line are shown as '?', those of two bytes in UTF-8 (C1) as well.
inline std::string printable(std::string text) {
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto byte = static_cast<unsigned char>(text[i]);
    if ((byte < 0x20 && byte != '\n') || byte == 0x7f) text[i] = '?';
    if (byte != 0xc2 || i + 1 == text.size()) continue;
    const auto next = static_cast<unsigned char>(text[i + 1]);
    if (next >= 0x80 && next < 0xa0) text[i] = text[i + 1] = '?';
  }
  return text;
}

}  // namespace omentum
