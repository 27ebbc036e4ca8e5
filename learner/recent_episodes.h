#pragma once

#include <cstdint>
#include <deque>

namespace omentum {

/// The last 100 training episodes, for console, curves and summary; a checkpoint keeps them.
struct RecentEpisodes {
  struct One {
    double return_sum = 0, length = 0, exposure = 0;  ///< length in steps, exposure in [0, 1]
    bool success = false, held = false, lost = false;
  };
  std::deque<One> recent;
  std::uint64_t total = 0;  ///< of the whole run

  void add(const One& one) {
    recent.push_back(one);
    if (recent.size() > 100) recent.pop_front();
    ++total;
  }
  /// Mean of value(episode); 0 without any.
  template <typename F>
  double mean(F&& value) const {
    double sum = 0;
    for (const One& one : recent) sum += static_cast<double>(value(one));
    return recent.empty() ? 0 : sum / static_cast<double>(recent.size());
  }
};

}  // namespace omentum
