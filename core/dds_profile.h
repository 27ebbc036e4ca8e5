#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace omentum {

/// The Cyclone configuration of a process, and what the program itself must do on this machine
/// (docs/wire.md 5.3, 6).
struct DdsProfile {
  std::string name;  ///< "environment" (CYCLONEDDS_URI is set), "mesh" or "small-buffer"
  std::string uri;   ///< text for CYCLONEDDS_URI and dds::Participant
  std::size_t receive_buffer_bytes = 0;  ///< usable bytes of a UDP socket, as the kernel reports
  bool small_buffer = false;             ///< receive_buffer_bytes < needed: bursts must be spaced
  std::int64_t task_spacing_ns = 0;      ///< between two task writes; 0 with large buffers
};

/// Receive buffer wanted for `mesh`; also asked for in its XML.
inline constexpr std::size_t kReceiveBufferBytes = std::size_t{4} << 20;

/// Usable bytes of a learner that gets E segments at once, and of a worker that gets its tasks and
/// weights at once (docs/wire.md 5.3).
std::size_t learner_receive_bytes(std::size_t slots, std::size_t segment_bytes);
std::size_t worker_receive_bytes(std::size_t lanes, std::size_t state_bytes,
                                 std::size_t weights_bytes);

/// CYCLONEDDS_URI when set and not empty, else the built-in profile `mesh`, or `small-buffer` with
/// a warning where a socket has less than `needed_bytes`: Cyclone itself would not warn, and stall
/// for 100 ms at a time.
DdsProfile choose_dds_profile(std::size_t needed_bytes);

/// Opens a UDP socket, asks for `wanted` bytes and returns the usable bytes it got (half of what
/// Linux reports).
std::size_t probe_receive_buffer(std::size_t wanted);

/// XML of a built-in profile, byte for byte the file deploy/dds/<name>.xml. Names: "mesh",
/// "small-buffer".
std::string dds_profile_xml(const std::string& name);

/// For `--print-dds-env`: a shell line that sets the configuration of this program for other tools
/// (cyclonedds, ddsperf), used as: eval "$(learner --print-dds-env)".
std::string dds_environment(const DdsProfile& profile);

}  // namespace omentum
