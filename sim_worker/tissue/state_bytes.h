#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

#include "core/types.h"
#include "sim_worker/lanes/lane_array.h"

namespace omentum {

/// What follows the fixed part of a lane's saved state: one word of these. Thickness comes first,
/// then effects, then the grasp. Reaches checkpoints: do not change.
enum StateParts : std::uint32_t { kEffectsFollow = 1, kGraspFollows = 2, kThicknessFollows = 4 };

/// Appends plain values to the state of a lane, as they lie in memory (little-endian machines). A
/// type with padding would make two saves of one state differ.
class StateWriter {
 public:
  explicit StateWriter(Bytes& out) : out_(out) {}

  template <typename T>
  void add(const T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    add_bytes(&value, sizeof value);
  }
  template <typename T>
  void add_all(std::span<const T> values) {
    static_assert(std::is_trivially_copyable_v<T>);
    add_bytes(values.data(), values.size_bytes());
  }
  /// Numbers of one lane.
  template <typename T>
  void add_lane(const LaneArray<T>& array, int lane) {
    for (int k = 0; k < array.in_lane(); ++k) add(array.lane_value(k, lane));
  }

 private:
  void add_bytes(const void* data, std::size_t size) {
    const auto* bytes = static_cast<const std::byte*>(data);
    out_.insert(out_.end(), bytes, bytes + size);
  }
  Bytes& out_;
};

/// Reads what StateWriter wrote; every read is false, and reads nothing, where the bytes end before
/// it.
class StateReader {
 public:
  explicit StateReader(std::span<const std::byte> bytes) : rest_(bytes), size_(bytes.size()) {}

  template <typename T>
  bool read(T& value) {
    return read_all(std::span<T>(&value, 1));
  }
  template <typename T, std::size_t kExtent>
  bool read_all(std::span<T, kExtent> values) {
    static_assert(std::is_trivially_copyable_v<T>);
    if (rest_.size() < values.size_bytes()) return false;
    // memcpy must not get the null pointer of an empty vector.
    if (!values.empty())
      std::memcpy(static_cast<void*>(values.data()), rest_.data(), values.size_bytes());
    rest_ = rest_.subspan(values.size_bytes());
    return true;
  }
  /// Whether `count` values of this size are left.
  bool has(std::size_t count, std::size_t size) const { return count <= rest_.size() / size; }
  /// Bytes read so far.
  std::size_t used() const { return size_ - rest_.size(); }

 private:
  std::span<const std::byte> rest_;
  std::size_t size_;
};

template <typename T>
bool all_finite(std::span<const T> values) {
  for (const T v : values) {
    if (!std::isfinite(v)) return false;
  }
  return true;
}

}  // namespace omentum
