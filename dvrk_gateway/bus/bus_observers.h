#pragma once

#include <optional>
#include <vector>

#include "dvrk_gateway/bus/gateway_bus.h"
#include "dvrk_gateway/bus/robot_bus.h"
#include "dvrk_gateway/bus/ros_topics.h"

namespace omentum {

/// All that publishes what the gateway does: nothing without a bus. One thread makes it, appends
/// and pins; what it appends is called on the threads that GatewayObserver names.
class BusObservers {
 public:
  /// `bus` may be null, else it must outlive this. `options` are checked (check_bus_options()).
  /// Throws Error: one line, for entities that cannot be made.
  BusObservers(GatewayBus* bus, const BusOptions& options, const SafetySetup& setup, bool dry_run);

  /// Adds its observers at the end; this must outlive who calls them.
  void append_to(std::vector<GatewayObserver*>& observers);
  /// Those of them that are made from the participant of the bus.
  std::vector<BusMember*> members();
  /// The arm was armed in the last period that they were told of.
  bool sees_armed() const { return robot_ && robot_->is_armed(); }
  /// The policy of the episodes from now on; another one than before is printed.
  void pin(const PolicyWeights& weights);

 private:
  std::optional<RobotBus> robot_;
  std::optional<RosTopics> ros_;
  std::optional<PolicyWeights> pinned_;
};

}  // namespace omentum
