#include "dvrk_gateway/bus/policy_source.h"

#include <utility>

#include "core/check.h"
#include "core/task.h"

namespace omentum {

std::unique_ptr<Policy> fitting_policy(const std::string& name, const pb::Config& config,
                                       const PolicyWeights& weights) {
  if (turns_tool(config.task())) {
    throw_error(
        "{}: turns the tool (task.action ACTION_ORIENTED), allowed: the other actions; the arm is "
        "led "
        "with the orientation of the scene",
        name);
  }
  const PolicyShape shape = policy_shape(config);
  if (weights.layout_hash != shape.layout_hash()) {
    throw_error(
        "{}: made for other observations or actions than its configuration's {} numbers (layout "
        "{:016x}, needed {:016x})",
        name, shape.observations, weights.layout_hash, shape.layout_hash());
  }
  const auto observations = static_cast<std::size_t>(shape.observations);
  const bool normalised = !weights.obs_mean.empty();
  if (weights.parameters.size() != shape.parameter_count() ||
      (normalised && weights.obs_mean.size() != observations) ||
      weights.obs_inv_std.size() != weights.obs_mean.size()) {
    throw_error("{}: {} parameters and {} means of observations, needed {} and {} or none", name,
                weights.parameters.size(), weights.obs_mean.size(), shape.parameter_count(),
                observations);
  }
  return std::make_unique<Policy>(shape, weights);
}

FilePolicySource::FilePolicySource(SavedPolicy saved)
    : saved_(std::move(saved)),
      policy_(fitting_policy("--policy " + saved_.path, saved_.config, saved_.weights)) {}

}  // namespace omentum
