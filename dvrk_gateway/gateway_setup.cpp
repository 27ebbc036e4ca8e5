#include "dvrk_gateway/gateway_setup.h"

#include <cmath>
#include <filesystem>

#include "core/clock.h"
#include "core/config.h"
#include "core/log.h"
#include "core/registration_file.h"
#include "dvrk_gateway/bus/bus_policy_source.h"
#include "dvrk_gateway/protocol/base_frame.h"
#include "dvrk_gateway/protocol/udp_socket.h"

namespace omentum {
namespace {

constexpr const char* kPolicyOfBus = "bus";  // of --policy

}  // namespace

const char* mode_name(GatewayMode mode) {
  switch (mode) {
    case GatewayMode::kTwin:
      return "twin";
    case GatewayMode::kMeasured:
      return "measured";
    case GatewayMode::kReplay:
      return "replay";
    case GatewayMode::kTeach:
      return "teach";
  }
  return "?";
}

pb::SafetyLimits limits_of(const GatewayOptions& options) {
  pb::SafetyLimits limits;
  if (!options.limits.empty()) read_text_proto(options.limits, limits);
  return limits;
}

UdpAddress robot_address(const GatewayOptions& options) {
  return resolve_address("--robot", options.robot_host, options.robot_port);
}

SavedPolicy policy_of(const GatewayOptions& options) {
  if (options.policy == kPolicyOfBus)
    throw_error("--policy bus: only episodes run it; name a run folder or a checkpoint here");
  Result<SavedPolicy> saved = load_policy(options.policy);
  if (!saved) throw_error("--policy {}", saved.error());
  return std::move(saved).value();
}

std::unique_ptr<PolicySource> policy_source_of(const GatewayOptions& options, GatewayBus* bus,
                                               const std::function<bool()>& stop) {
  if (options.policy != kPolicyOfBus) return std::make_unique<FilePolicySource>(policy_of(options));
  if (options.bus.run.empty())
    throw_error("--policy bus: needs --run, the name of the run on the bus");
  if (bus == nullptr) return nullptr;  // stopped while joining
  return BusPolicySource::wait(*bus, options.bus.run, stop);
}

SafetySetup safety_of(const GatewayOptions& options, const ToolMount& scene_mount,
                      const pb::Config& config) {
  ToolMount mount = scene_mount;
  mount.instrument = &find_instrument(options.instrument);
  const bool registered = !options.registration.empty();
  if (registered && !std::filesystem::exists(options.registration)) {
    throw_error(
        "--registration {}: cannot be opened; `dvrk_gateway register --touches FILE.csv` makes it, "
        "with the touches of deploy/dvrk/double-touches.csv that of dvrk_double",
        options.registration);
  }
  if (registered) {
    const Registration found = load_registration(options.registration);
    if (found.instrument != mount.instrument->name) {
      throw_error("--registration {}: made with {}, and --instrument is {}", options.registration,
                  found.instrument, mount.instrument->name);
    }
    mount.X_WR = found.X_WR;
    for (const std::string& warning : registration_warnings(
             found, pb::RegistrationRules{}, mount.workspace_min, mount.workspace_max))
      log().warn("registration: {}", warning);
    const std::string age = age_warning(found, pb::RegistrationRules{}, wall_now_ns());
    if (!age.empty()) log().warn("registration: {}", age);
  }
  SafetySetup safety = make_safety_setup(limits_of(options), mount,
                                         parse_base_frame(options.base_frame), registered);
  if (std::abs(safety.limits.period_s() - config.task().control_period_s()) > 1e-9) {
    throw_error("period_s: {} s, the policy's control period is {} s", safety.limits.period_s(),
                config.task().control_period_s());
  }
  return safety;
}

std::uint32_t robot_starts(const pb::Scene& scene) {
  return scene.has_robot_grid() ? scene.robot_grid().rows() * scene.robot_grid().columns() : 0;
}

}  // namespace omentum
