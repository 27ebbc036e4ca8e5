#pragma once

#include <algorithm>
#include <string_view>

namespace omentum {

/// Whether a path ends in `ending`, given in small letters: cameras and old programs write
/// capitals.
inline bool has_ending(std::string_view path, std::string_view ending) {
  if (path.size() < ending.size()) return false;
  const std::string_view tail = path.substr(path.size() - ending.size());
  return std::equal(tail.begin(), tail.end(), ending.begin(), [](char a, char b) {
    return (a >= 'A' && a <= 'Z' ? static_cast<char>(a - 'A' + 'a') : a) == b;
  });
}

/// Whether the last part of a path begins with a dot, as what a Mac or an editor lays beside files.
inline bool is_hidden(std::string_view path) {
  const std::size_t slash = path.rfind('/');
  return path.substr(slash == std::string_view::npos ? 0 : slash + 1).starts_with('.');
}

}  // namespace omentum
