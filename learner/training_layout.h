#pragma once

#include <span>
#include <vector>

#include "core/aligned.h"
#include "core/policy.h"

namespace omentum {

/// The parameters as training works on them: same blocks in the same order as the canonical
/// ParameterLayout, but with the hidden width padded to a multiple of 16 and every block on a cache
/// line. Padding is zero and stays zero: padded units output 0, receive gradient 0 and are left
/// alone by Adam. Parameters, gradients and both Adam moments have this layout.
class TrainingLayout {
 public:
  explicit TrainingLayout(const PolicyShape& shape);

  const ParameterLayout& blocks() const { return padded_; }
  std::size_t count() const { return padded_.count; }
  int hidden() const { return hidden_; }

  /// Canonical -> padded and back. Spans have PolicyShape::parameter_count(), which is not checked,
  /// and count() entries, else it aborts.
  void spread(std::span<const float> canonical, std::span<float> padded) const;
  void collect(std::span<const float> padded, std::span<float> canonical) const;

 private:
  /// One run of consecutive parameters in both layouts.
  struct Run {
    std::size_t canonical = 0, padded = 0, size = 0;
  };

  int hidden_ = 0;
  ParameterLayout padded_;
  std::vector<Run> runs_;
};

}  // namespace omentum
