#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/alarms.h"
#include "core/dds_config.h"
#include "core/result.h"

namespace CLI {  // NOLINT(readability-identifier-naming): the library's name
class App;
}

namespace omentum {

/// How a program reaches the others, as told by its command line or environment: the same words in
/// every program (docs/cluster.md).
struct DdsOptions {
  std::string discovery = "loopback";  ///< loopback, mesh or hub
  std::vector<std::string> peers;      ///< mesh: names or addresses of hosts
  std::string hub;                     ///< name or address of the learner's host
  std::string interface;               ///< empty: the one that routes to the hub or the first peer
  std::string security_dir;
};

/// Adds --discovery, --peers, --hub, --interface and --security-dir, which OMENTUM_DISCOVERY ...
/// set as well.
void add_dds_options(CLI::App& app, DdsOptions& options);

/// Receive buffer that a socket asks for. A learner and a worker need all of it: they join before
/// anybody knows the size of a state, and a burst is as many of them as there are slots or lanes.
inline constexpr std::size_t kReceiveBufferBytes = std::size_t{4} << 20;

/// The Cyclone configuration of a process, and what the program itself must do on this machine
/// (docs/wire.md 5.3, 6).
struct DdsProfile {
  std::string name;  ///< "environment" (CYCLONEDDS_URI is set), "loopback", "mesh" or "hub"
  std::string uri;   ///< text for CYCLONEDDS_URI and dds::Participant
  Discovery discovery = Discovery::kLoopback;
  DdsRole role = DdsRole::kOther;
  std::string security_dir;
  std::string certificate_name;          ///< role, or role-host; empty without security
  std::int64_t certificate_end_s = 0;    ///< since 1970 UTC, as read when the profile was made
  std::size_t receive_buffer_bytes = 0;  ///< usable bytes of a UDP socket, as the kernel reports
  bool small_buffer = false;             ///< receive_buffer_bytes < needed: bursts must be spaced
  std::int64_t task_spacing_ns = 0;      ///< between two task writes; 0 with large buffers
};

/// Profile of a program. Fails while a name does not exist or nothing routes to it: try again, as
/// names of a cluster come and go. Throws Error for options that are wrong in themselves.
/// CYCLONEDDS_URI, when set and not empty, is taken as it is. Where a socket has less than
/// `needed_bytes`, of which more than kReceiveBufferBytes do not count, it is the configuration for
/// small buffers: Cyclone itself would not warn, and stall for 100 ms at a time.
Result<DdsProfile> find_dds_profile(const DdsOptions& options, DdsRole role, std::uint32_t domain,
                                    std::size_t needed_bytes);

/// The same, waiting for names: says at once and every minute which one is missing. Empty when
/// asked to stop, or after `max_wait_ns` (0 = for ever).
std::optional<DdsProfile> wait_for_dds_profile(const DdsOptions& options, DdsRole role,
                                               std::uint32_t domain, std::size_t needed_bytes,
                                               std::int64_t max_wait_ns,
                                               const std::function<bool()>& stop);

/// Alarms of every program on the bus: small buffers, the end of its certificate.
class ProfileAlarms {
 public:
  /// Reads the certificate's files at most once a minute.
  void raise(Alarms& alarms, const DdsProfile& profile, std::int64_t now_ns);

 private:
  std::int64_t asked_ns_ = 0;
};

/// One warning where the buffers are small: what is wrong and what to type.
void tell_of_small_buffers(const DdsProfile& profile, std::size_t needed_bytes);

/// A line for an alarm from 14 days before the end of the certificate: when it ends and what to
/// type; where the files are renewed already, that they are taken when this one ends. Nothing
/// before, and without security. Reads files: call it every few minutes.
std::optional<std::string> certificate_warning(const DdsProfile& profile);

/// Opens a UDP socket, asks for `wanted` bytes and returns the usable bytes it got (half of what
/// Linux reports).
std::size_t probe_receive_buffer(std::size_t wanted);

/// For `--print-dds-env`: a shell line that sets the configuration for other tools (cyclonedds,
/// ddsperf), used as: eval "$(learner --print-dds-env)".
std::string dds_environment(const DdsProfile& profile);

}  // namespace omentum
