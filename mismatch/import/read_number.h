#pragma once

#include <algorithm>
#include <cstring>

namespace omentum {

/// A number of type T as a file holds it, its bytes in the order of this machine or `swapped`.
template <typename T>
double read_as(const char* bytes, bool swapped) {
  char raw[sizeof(T)];
  std::memcpy(raw, bytes, sizeof(T));
  if (swapped) std::reverse(raw, raw + sizeof(T));
  T value;
  std::memcpy(&value, raw, sizeof(T));
  return static_cast<double>(value);
}

}  // namespace omentum
