#include "learner/shuffle.h"

#include <numeric>
#include <utility>

#include "core/rng.h"

namespace omentum {

namespace {

/// Words of one counter stream in order.
class WordStream {
 public:
  WordStream(std::uint64_t run_seed, std::uint64_t batch, std::uint32_t epoch)
      : run_seed_(run_seed), batch_(batch), epoch_(epoch) {}

  std::uint32_t next() {
    if (position_ == 4) {
      words_ = random_words(run_seed_, epoch_, Purpose::kShuffle, 0, batch_, call_++);
      position_ = 0;
    }
    return words_[position_++];
  }

  /// Uniform in [0, bound): multiply-shift, rejecting the low products that would make it uneven
  /// [Lemire19].
  std::uint32_t below(std::uint32_t bound) {
    const std::uint32_t uneven = (0u - bound) % bound;
    while (true) {
      const std::uint64_t product = std::uint64_t{next()} * bound;
      if (static_cast<std::uint32_t>(product) >= uneven)
        return static_cast<std::uint32_t>(product >> 32);
    }
  }

 private:
  std::uint64_t run_seed_ = 0, batch_ = 0;
  std::uint32_t epoch_ = 0, call_ = 0;
  PhiloxWords words_{};
  std::size_t position_ = 4;
};

}  // namespace

std::vector<std::uint32_t> shuffled_rows(std::uint64_t run_seed, std::uint64_t batch,
                                         std::uint32_t epoch, std::uint32_t count) {
  std::vector<std::uint32_t> rows(count);
  std::iota(rows.begin(), rows.end(), 0u);
  WordStream stream(run_seed, batch, epoch);
  for (std::uint32_t i = count; i > 1; --i) std::swap(rows[i - 1], rows[stream.below(i)]);
  return rows;
}

}  // namespace omentum
