#include "learner/normaliser.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"

namespace omentum {

namespace {

constexpr double kVarianceFloor = 1e-8;  // keeps a constant input finite
constexpr double kRewardClip = 10;       // docs/learner.md 4, row 20

}  // namespace

RunningMoments::RunningMoments(int dimensions)
    : mean_(static_cast<std::size_t>(dimensions), 0.0),
      squares_(static_cast<std::size_t>(dimensions), 0.0) {}

// [Chan83]: with d = mean_B - mean_A and n = n_A + n_B,
//   mean = mean_A + d n_B / n,   M2 = M2_A + M2_B + d^2 n_A n_B / n.
// Moments of the batch itself take two passes, which is exact enough at any offset.
template <typename T>
void RunningMoments::merge_rows(std::span<const T> values, std::size_t width) {
  const std::size_t dimensions = mean_.size();
  OMENTUM_CHECK(dimensions > 0 && width >= dimensions && values.size() % width == 0);
  const std::size_t rows = values.size() / width;
  if (rows == 0) return;
  const auto added = static_cast<double>(rows);
  std::vector<double> mean(dimensions, 0.0);
  std::vector<double> squares(dimensions, 0.0);
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t i = 0; i < dimensions; ++i)
      mean[i] += static_cast<double>(values[row * width + i]);
  }
  for (double& value : mean) value /= added;
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t i = 0; i < dimensions; ++i) {
      const double d = static_cast<double>(values[row * width + i]) - mean[i];
      squares[i] += d * d;
    }
  }
  const double total = count_ + added;
  for (std::size_t i = 0; i < dimensions; ++i) {
    const double d = mean[i] - mean_[i];
    mean_[i] += d * added / total;
    squares_[i] += squares[i] + d * d * count_ * added / total;
  }
  count_ = total;
}

void RunningMoments::merge(std::span<const float> values, std::size_t width) {
  merge_rows(values, width);
}
void RunningMoments::merge(std::span<const double> values) { merge_rows(values, mean_.size()); }

double RunningMoments::variance(std::size_t dimension) const {
  return count_ > 0 ? squares_[dimension] / count_ : 1.0;
}

void RunningMoments::restore(double count, std::vector<double> mean, std::vector<double> squares) {
  OMENTUM_CHECK(mean.size() == mean_.size() && squares.size() == squares_.size());
  count_ = count;
  mean_ = std::move(mean);
  squares_ = std::move(squares);
}

FrozenNormaliser freeze(const RunningMoments& moments) {
  FrozenNormaliser frozen;
  for (std::size_t i = 0; i < moments.mean().size(); ++i) {
    frozen.mean.push_back(static_cast<float>(moments.mean()[i]));
    frozen.inverse_deviation.push_back(
        static_cast<float>(1.0 / std::sqrt(moments.variance(i) + kVarianceFloor)));
  }
  return frozen;
}

RewardScaler::RewardScaler(int slots, double gamma)
    : gamma_(gamma), moments_(1), discounted_(static_cast<std::size_t>(slots), 0.0) {}

void RewardScaler::scale(const Batch& batch, std::span<float> scaled) {
  OMENTUM_CHECK(static_cast<std::size_t>(batch.slots) == discounted_.size() &&
                scaled.size() == batch.rows());
  const auto steps = static_cast<std::size_t>(batch.steps);
  std::vector<double> sums(batch.rows());
  for (std::size_t row = 0; row < sums.size(); ++row) {
    double& sum = discounted_[row / steps];
    sum = sum * gamma_ + static_cast<double>(batch.rewards[row]);
    sums[row] = sum;
    if ((batch.flags[row] & (step_flag::kTerminated | step_flag::kTruncated)) != 0) sum = 0;
  }
  moments_.merge(std::span<const double>(sums));
  const double deviation = std::sqrt(moments_.variance(0) + kVarianceFloor);
  for (std::size_t row = 0; row < sums.size(); ++row) {
    const double reward = static_cast<double>(batch.rewards[row]) / deviation;
    scaled[row] = static_cast<float>(std::clamp(reward, -kRewardClip, kRewardClip));
  }
}

void RewardScaler::restore(RunningMoments moments, std::vector<double> discounted) {
  OMENTUM_CHECK(discounted.size() == discounted_.size() && moments.mean().size() == 1);
  moments_ = std::move(moments);
  discounted_ = std::move(discounted);
}

}  // namespace omentum
