#include "learner/training_layout.h"

#include <algorithm>

#include "core/check.h"
#include "core/gemm.h"

namespace omentum {

TrainingLayout::TrainingLayout(const PolicyShape& shape) : hidden_(padded_columns(shape.hidden)) {
  const ParameterLayout canonical = parameter_layout(shape);
  const auto width = static_cast<std::size_t>(shape.hidden);
  const auto padded_width = static_cast<std::size_t>(hidden_);
  std::size_t offset = 0;
  // Places `rows` rows of `size` parameters; `occupied_rows` may be larger (padding below).
  const auto place = [&](std::size_t from, std::size_t rows, std::size_t size,
                         std::size_t padded_size, std::size_t occupied_rows) {
    const std::size_t start = offset;
    for (std::size_t row = 0; row < rows; ++row)
      runs_.push_back({from + row * size, start + row * padded_size, size});
    offset +=
        static_cast<std::size_t>(padded_columns(static_cast<int>(occupied_rows * padded_size)));
    return start;
  };
  const auto network = [&](const NetworkLayout& from) {
    NetworkLayout to = from;
    const auto inputs = static_cast<std::size_t>(shape.inputs());
    const auto outputs = static_cast<std::size_t>(from.outputs);
    // Filters are multiples of 16 and need no padding.
    const auto copy = [&](std::size_t first, std::size_t end) {
      return place(first, 1, end - first, end - first, 1);
    };
    to.filters1 = copy(from.filters1, from.filters1_bias);
    to.filters1_bias = copy(from.filters1_bias, from.filters2);
    to.filters2 = copy(from.filters2, from.filters2_bias);
    to.filters2_bias = copy(from.filters2_bias, from.weights1);
    to.weights1 = place(from.weights1, inputs, width, padded_width, inputs);
    to.bias1 = place(from.bias1, 1, width, padded_width, 1);
    to.weights2 = place(from.weights2, width, width, padded_width, padded_width);
    to.bias2 = place(from.bias2, 1, width, padded_width, 1);
    to.head = place(from.head, outputs, width, padded_width, outputs);
    to.head_bias = place(from.head_bias, from.has_head_bias ? 1 : 0, outputs,
                         static_cast<std::size_t>(padded_columns(from.outputs)), 1);
    return to;
  };
  padded_.actor = network(canonical.actor);
  padded_.log_std = offset;
  if (shape.continuous) place(canonical.log_std, 1, kContinuousDimensions, kPanel, 1);
  padded_.critic = network(canonical.critic);
  padded_.count = offset;
}

void TrainingLayout::spread(std::span<const float> canonical, std::span<float> padded) const {
  OMENTUM_CHECK(padded.size() == padded_.count);
  std::fill(padded.begin(), padded.end(), 0.0F);
  for (const Run& run : runs_)
    std::copy_n(canonical.data() + run.canonical, run.size, padded.data() + run.padded);
}

void TrainingLayout::collect(std::span<const float> padded, std::span<float> canonical) const {
  OMENTUM_CHECK(padded.size() == padded_.count);
  for (const Run& run : runs_)
    std::copy_n(padded.data() + run.padded, run.size, canonical.data() + run.canonical);
}

}  // namespace omentum
