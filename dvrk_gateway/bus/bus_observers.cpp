#include "dvrk_gateway/bus/bus_observers.h"

#include <fmt/core.h>

#include <cstdio>

#include "core/build_id.h"
#include "core/hash.h"

namespace omentum {

BusObservers::BusObservers(GatewayBus* bus, const BusOptions& options, const SafetySetup& setup,
                           bool dry_run) {
  if (bus == nullptr) return;
  robot_.emplace(bus->participant(),
                 RobotBusOptions{.run = options.run,
                                 .arm = options.arm,
                                 .dry_run = dry_run,
                                 .build_id = build_id(),
                                 .program_version = git_revision()},
                 setup);
  if (options.ros) ros_.emplace(bus->participant(), options.arm);
}

void BusObservers::append_to(std::vector<GatewayObserver*>& observers) {
  if (robot_) observers.push_back(&*robot_);
  if (ros_) observers.push_back(&*ros_);
}

std::vector<BusMember*> BusObservers::members() {
  std::vector<BusMember*> members;
  if (robot_) members.push_back(&*robot_);
  if (ros_) members.push_back(&*ros_);
  return members;
}

void BusObservers::pin(const PolicyWeights& weights) {
  if (pinned_ && pinned_->weights_hash == weights.weights_hash &&
      pinned_->policy_version == weights.policy_version)
    return;
  fmt::print("policy version {}, weights {}\n", weights.policy_version,
             hex(weights.weights_hash).substr(0, 8));
  std::fflush(stdout);
  pinned_ = weights;
  if (robot_) robot_->pin(weights);
}

}  // namespace omentum
