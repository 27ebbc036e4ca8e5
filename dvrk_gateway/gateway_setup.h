#pragma once

#include <cstdint>
#include <functional>
#include <memory>

#include "core/checkpoint_file.h"
#include "dvrk_gateway/bus/policy_source.h"
#include "dvrk_gateway/gateway_options.h"
#include "dvrk_gateway/safety/safety.h"

namespace omentum {

/// twin, measured, replay, teach
const char* mode_name(GatewayMode mode);

/// Of `--robot`. Throws Error: one line.
UdpAddress robot_address(const GatewayOptions& options);

/// Of `--limits`, or the defaults. Throws Error: one line with the knob.
pb::SafetyLimits limits_of(const GatewayOptions& options);

/// The policy that `--policy` names, a file. Throws Error: one line with the option.
SavedPolicy policy_of(const GatewayOptions& options);
/// The same, or the bus; `bus` is null without one. Null when `stop` became true while the policy
/// was waited for. Throws Error: one line with the option.
std::unique_ptr<PolicySource> policy_source_of(const GatewayOptions& options, GatewayBus* bus,
                                               const std::function<bool()>& stop);

/// The arm as it stands: the mount of the scene with the instrument that is on it, at the base that
/// the registration found; limits of the options. Throws Error: one line with the option or knob.
SafetySetup safety_of(const GatewayOptions& options, const ToolMount& scene_mount,
                      const pb::Config& config);

/// Starts of the scene's robot_grid; 0 without one.
std::uint32_t robot_starts(const pb::Scene& scene);

}  // namespace omentum
