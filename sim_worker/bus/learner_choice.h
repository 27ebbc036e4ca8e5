#pragma once

#include <cstdint>
#include <map>
#include <optional>

#include "core/types.h"

namespace omentum {

/// A learner speaks twice a second: after this long it is silent [ns].
inline constexpr std::int64_t kLearnerFreshNs = 3'000'000'000;

/// Which learner a worker follows. A learner is a participant that has published a manifest of the
/// run and speaks. The one with the highest epoch is followed; one that has fallen silent only
/// until another one speaks. What others publish under a learner's name or epoch is not believed.
/// Of 64 participants at most; the one that was silent for longest goes first.
///
/// For one thread. Times are of one steady clock [ns], above 0.
class LearnerChoice {
 public:
  struct Learner {
    std::uint64_t participant = 0;
    RunManifest manifest;
    std::int64_t spoke_ns = 0;  ///< last status; 0 = none yet
  };

  /// A participant's manifest, in the place of its earlier one; that of participant 0, which is
  /// none, is passed over.
  void offered(std::uint64_t participant, RunManifest manifest);
  /// A status of the epoch of its manifest; others, and those before a manifest, are ignored.
  void spoke(std::uint64_t participant, std::uint32_t epoch, std::int64_t now_ns);

  /// The learner to follow; null while no participant is one. Valid until the next call of
  /// offered().
  const Learner* choose(std::int64_t now_ns) const;

 private:
  std::map<std::uint64_t, Learner> learners_;  ///< by participant
};

}  // namespace omentum
