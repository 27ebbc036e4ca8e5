#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

namespace omentum {

/// Counts of durations up to 100 ms in steps of 10 us; longer ones count as 100 ms, their largest
/// is kept. No allocation.
class Histogram {
 public:
  void add(std::int64_t duration_ns) noexcept {
    const std::int64_t bin = std::clamp<std::int64_t>(duration_ns / kBinNs, 0, kBins - 1);
    ++bins_[static_cast<std::size_t>(bin)];
    ++count_;
    max_ns_ = std::max(max_ns_, duration_ns);
  }
  std::uint64_t count() const { return count_; }
  double max_ms() const { return 1e-6 * static_cast<double>(max_ns_); }
  /// Upper end of the bin that the share falls into [ms]; 0 without a value.
  double quantile_ms(double share) const {
    const auto wanted = static_cast<std::uint64_t>(share * static_cast<double>(count_));
    std::uint64_t seen = 0;
    for (std::size_t i = 0; i < bins_.size() && count_ > 0; ++i) {
      seen += bins_[i];
      if (seen > wanted || seen == count_) return 1e-6 * static_cast<double>((i + 1) * kBinNs);
    }
    return 0;
  }

 private:
  static constexpr std::int64_t kBinNs = 10'000, kBins = 10'000;
  std::array<std::uint32_t, kBins> bins_{};
  std::uint64_t count_ = 0;
  std::int64_t max_ns_ = 0;
};

}  // namespace omentum
