#include "core/segment_fields.h"

#include <span>
#include <vector>

#include "core/hash.h"

namespace omentum {

namespace {

struct Numbers : IgnoreFields {
  std::vector<std::uint64_t> all;
  template <typename T>
  void value(const T& field, const T& /*same*/, const char* /*name*/) {
    all.push_back(field);
  }
};

}  // namespace

std::uint32_t segment_crc(const RolloutSegment& segment) {
  Numbers numbers;
  segment_fields(segment, segment, numbers);
  std::uint32_t crc = crc32c(std::as_bytes(std::span(numbers.all)));
  for_each_array(segment, [&crc](const auto& array, const ArrayField& /*about*/) {
    crc = crc32c(std::as_bytes(std::span(array)), crc);
  });
  return crc;
}

}  // namespace omentum
