#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/dds.h"

namespace omentum::dds {

/// Writers of a topic that other participants have. Reads what discovery knows: not for a loop.
std::size_t other_writers(const Participant& participant, const std::string& topic);

/// Counts what discovery finds: participants, writers and readers, those of this process included.
/// Where many meet on a busy machine it takes a minute until it finds no more. One thread at a
/// time.
class Discovery {
 public:
  /// Throws Error.
  explicit Discovery(const Participant& participant);
  struct Count {
    std::uint64_t found = 0;  ///< so far; what was lost and came back counts twice
    std::uint64_t known = 0;  ///< of them, there now
  };
  Count count();

 private:
  std::array<Entity, 3> readers_;
  Count count_;
};

}  // namespace omentum::dds
