#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace omentum {

/// The newest value of one thread for one other. Neither ever waits: the reader sees whole values
/// and may miss some. Three places; each belongs to one side or to the exchange.
template <typename T>
class Latest {
 public:
  /// Writer: fill this, then publish().
  T& next() { return places_[mine_]; }
  void publish() {
    mine_ = exchange_.exchange(static_cast<std::uint8_t>(mine_ | kNew), std::memory_order_acq_rel) &
            kIndex;
  }

  /// Reader: takes over what is newer than value(); false where nothing is.
  bool refresh() {
    if ((exchange_.load(std::memory_order_acquire) & kNew) == 0) return false;
    theirs_ = exchange_.exchange(theirs_, std::memory_order_acq_rel) & kIndex;
    return true;
  }
  const T& value() const { return places_[theirs_]; }

 private:
  static constexpr std::uint8_t kIndex = 3, kNew = 4;
  std::array<T, 3> places_{};
  std::uint8_t mine_ = 0, theirs_ = 1;
  std::atomic<std::uint8_t> exchange_{2};
};

}  // namespace omentum
