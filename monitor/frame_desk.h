#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "core/types.h"

namespace omentum {

/// A frame with its number, which grows with every frame of any slot.
struct NumberedFrame {
  std::uint64_t number = 0;
  SimFrame frame;
};

/// Which slots somebody looks at, what the learner must be told therefore, and the newest frame of
/// each. Times are of the steady clock. Not thread-safe.
class FrameDesk {
 public:
  static constexpr std::size_t kMaxSlots = 4;                ///< at a time
  static constexpr std::int64_t kIdleNs = 5'000'000'000;     ///< nobody looks any more
  static constexpr std::int64_t kMissingNs = 3'000'000'000;  ///< then frames are asked for again

  /// Somebody looks at a slot now. False when too many others are looked at.
  bool look(std::uint32_t slot, float hz, std::int64_t now_ns);
  /// Commands that are due: frames on for what is looked at, off for what is not any more.
  std::vector<ControlCommand> due(std::int64_t now_ns);
  /// Commands that end everything that is on.
  std::vector<ControlCommand> all_off();
  /// Keeps a frame of a slot that is looked at.
  void put(SimFrame&& frame, std::int64_t now_ns);
  /// The newest frame of a slot; null without one.
  std::shared_ptr<const NumberedFrame> newest(std::uint32_t slot) const;

 private:
  struct Row {
    float hz = 0;
    float told_hz = 0;  ///< 0: not told yet
    std::int64_t looked_at_ns = 0, told_at_ns = 0, frame_at_ns = 0;
    std::shared_ptr<const NumberedFrame> newest;
  };
  std::map<std::uint32_t, Row> rows_;
  std::uint64_t numbers_ = 0;
};

}  // namespace omentum
