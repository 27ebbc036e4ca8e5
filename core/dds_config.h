#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace omentum {

/// How processes of a run find each other (docs/wire.md 6).
enum class Discovery {
  kLoopback,  ///< one machine, no packet leaves it
  kMesh,      ///< a written list of hosts; everybody pings every port of every host
  kHub,       ///< everybody knows the learner's host only, and the learner nobody
};

/// The place of a process in a hub.
enum class DdsRole { kHub, kOther };

/// Port on which the participant of index 0 is found.
inline constexpr std::uint32_t discovery_port(std::uint32_t domain) { return 7410 + 250 * domain; }

/// The three independent choices that make a Cyclone configuration.
struct DdsConfig {
  Discovery discovery = Discovery::kLoopback;
  DdsRole role = DdsRole::kOther;
  /// Addresses: of the hosts of a mesh, this one included or not, or of the hub, with its port.
  /// Names are not resolved here: Cyclone would do it once, take the first address and stay deaf
  /// without a word where it fails.
  std::vector<std::string> peers;
  std::string interface;      ///< name or address, never empty; of no meaning with kLoopback
  bool large_buffers = true;  ///< the kernel gives 4 MiB to a socket
  std::string security_dir;   ///< files of deploy/security/make.sh; empty: no security
};

/// XML for dds::Participant. Aborts without an interface where one is needed. deploy/dds/*.xml are
/// what it makes (tests/core/dds_config_test.cpp).
std::string dds_config_xml(const DdsConfig& config);

}  // namespace omentum
