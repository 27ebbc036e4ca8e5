// What a record must satisfy whatever carried it.
#include <string>
#include <string_view>

#include "core/wire.h"
#include "omentum.h"

namespace omentum {
namespace {

// Lengths that belong together. Everything not named here is free.
class Lengths {
 public:
  Lengths& equal(std::size_t length, std::size_t wanted, std::string_view name) {
    if (length != wanted && failure_.empty()) {
      failure_ = fmt::format("{}: length {} is not {}", name, length, wanted);
    }
    return *this;
  }
  Lengths& require(bool ok, std::string_view reason) {
    if (!ok && failure_.empty()) failure_ = reason;
    return *this;
  }
  Result<void> result() const {
    return failure_.empty() ? Result<void>() : Result<void>(Failure{failure_});
  }

 private:
  std::string failure_;
};

}  // namespace

template <typename Record>
Result<void> check_record(const Record& /*record*/) {
  return {};
}

template <>
Result<void> check_record(const PolicyWeights& weights) {
  return Lengths()
      .equal(weights.obs_inv_std.size(), weights.obs_mean.size(), "obs_inv_std")
      .result();
}

template <>
Result<void> check_record(const RolloutTask& task) {
  return Lengths()
      .require(task.steps <= omentum_v1_MAX_STEPS, "steps: out of range")
      .require(task.reset || !task.start_state.empty(), "start_state: empty without reset")
      .result();
}

template <>
Result<void> check_record(const LearnerStatus& status) {
  return Lengths()
      .equal(status.worker_phases.size(), status.worker_ids.size(), "worker_phases")
      .equal(status.worker_steps_per_s.size(), status.worker_ids.size(), "worker_steps_per_s")
      .result();
}

template Result<void> check_record(const RolloutSegment&);
template Result<void> check_record(const WorkerStatus&);
template Result<void> check_record(const EpisodeSummary&);
template Result<void> check_record(const RunManifest&);

}  // namespace omentum
