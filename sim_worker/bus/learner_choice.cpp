#include "sim_worker/bus/learner_choice.h"

#include <algorithm>
#include <tuple>
#include <utility>

namespace omentum {
namespace {

// Manifests of strangers are not kept without end.
constexpr std::size_t kMaxLearners = 64;

}  // namespace

void LearnerChoice::offered(std::uint64_t participant, RunManifest manifest) {
  if (participant == 0) return;
  if (learners_.size() >= kMaxLearners && !learners_.contains(participant)) {
    learners_.erase(std::min_element(
        learners_.begin(), learners_.end(),
        [](const auto& a, const auto& b) { return a.second.spoke_ns < b.second.spoke_ns; }));
  }
  Learner& learner = learners_[participant];
  learner.participant = participant;
  learner.manifest = std::move(manifest);
}

void LearnerChoice::spoke(std::uint64_t participant, std::uint32_t epoch, std::int64_t now_ns) {
  const auto found = learners_.find(participant);
  if (found == learners_.end() || found->second.manifest.learner_epoch != epoch) return;
  found->second.spoke_ns = now_ns;
}

const LearnerChoice::Learner* LearnerChoice::choose(std::int64_t now_ns) const {
  const auto rank = [now_ns](const Learner& learner) {
    const bool fresh = learner.spoke_ns > 0 && now_ns - learner.spoke_ns < kLearnerFreshNs;
    return std::tuple(fresh, learner.manifest.learner_epoch, learner.participant);
  };
  const Learner* best = nullptr;
  for (const auto& [participant, learner] : learners_) {
    if (learner.spoke_ns == 0) continue;
    if (best == nullptr || rank(learner) > rank(*best)) best = &learner;
  }
  return best;
}

}  // namespace omentum
