#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "learner/batch.h"

namespace omentum {

/// Count, mean and sum of squared deviations per dimension, merged batch by batch in double
/// [Chan83]: merging A then B equals one pass over both up to rounding. Order matters for the last
/// bits, so callers pass slot/step order.
class RunningMoments {
 public:
  /// Aborts at the first merge() where there are no dimensions.
  explicit RunningMoments(int dimensions);

  /// Merges rows of `width` values, of which the first `dimensions` count. Aborts for rows that are
  /// narrower or not whole.
  void merge(std::span<const float> values, std::size_t width);
  /// Merges rows x dimensions values.
  void merge(std::span<const double> values);

  double count() const { return count_; }
  const std::vector<double>& mean() const { return mean_; }
  /// Sums of squared deviations.
  const std::vector<double>& squares() const { return squares_; }
  /// Population variance; 1 while nothing was seen.
  double variance(std::size_t dimension) const;
  /// For loading: other sizes than those of the present moments abort.
  void restore(double count, std::vector<double> mean, std::vector<double> squares);

 private:
  template <typename T>
  void merge_rows(std::span<const T> values, std::size_t width);

  double count_ = 0;
  std::vector<double> mean_;
  std::vector<double> squares_;
};

/// What ships with the weights: mean and 1 / sqrt(variance + 1e-8) in f32.
struct FrozenNormaliser {
  std::vector<float> mean;
  std::vector<float> inverse_deviation;
};
FrozenNormaliser freeze(const RunningMoments& moments);

/// Optional reward scaling: rewards divided by the running deviation of the discounted return,
/// clipped to +-10.
class RewardScaler {
 public:
  RewardScaler(int slots, double gamma);

  /// Continues each slot's discounted return through the batch, merges all of them in slot/step
  /// order, then writes the scaled rewards (n). Aborts for another number of slots or rewards.
  void scale(const Batch& batch, std::span<float> scaled);

  const RunningMoments& moments() const { return moments_; }
  const std::vector<double>& discounted() const { return discounted_; }
  /// For loading. Aborts unless `discounted` has one entry per slot and `moments` one dimension.
  void restore(RunningMoments moments, std::vector<double> discounted);

 private:
  double gamma_ = 0;
  RunningMoments moments_;
  std::vector<double> discounted_;  ///< per slot, up to now
};

}  // namespace omentum
