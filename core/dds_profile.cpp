#include "core/dds_profile.h"

#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <string_view>

#include "core/check.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr std::int64_t kSmallBufferSpacingNs =
    200'000;  // docs/wire.md 5.3: 0 stalls in 4 960 batches

constexpr std::string_view kLargeWatermarks =
    "<WhcHighInit>2MB</WhcHighInit><WhcHigh>8MB</WhcHigh>";
constexpr std::string_view kSmallWatermarks =
    "<WhcAdaptive>false</WhcAdaptive><WhcHighInit>32kB</WhcHighInit><WhcHigh>32kB</WhcHigh>";

std::string profile_text(std::string_view watermarks) {
  return fmt::format(R"(<CycloneDDS xmlns="https://cdds.io/config">
  <Domain Id="any">
    <General>
      <Interfaces><NetworkInterface name="lo"/></Interfaces>
      <AllowMulticast>false</AllowMulticast>
      <MaxMessageSize>65500B</MaxMessageSize>
    </General>
    <Discovery>
      <ParticipantIndex>auto</ParticipantIndex>
      <MaxAutoParticipantIndex>80</MaxAutoParticipantIndex>
      <LeaseDuration>2s</LeaseDuration>
      <SPDPInterval>500ms</SPDPInterval>
      <EnableTopicDiscoveryEndpoints>true</EnableTopicDiscoveryEndpoints>
      <Peers><Peer Address="127.0.0.1"/></Peers>
    </Discovery>
    <Internal>
      <SocketReceiveBufferSize min="default" max="4MiB"/>
      <HeartbeatInterval>20ms</HeartbeatInterval>
      <NackDelay>10ms</NackDelay>
      <Watermarks>{}</Watermarks>
    </Internal>
  </Domain>
</CycloneDDS>
)",
                     watermarks);
}

}  // namespace

std::size_t learner_receive_bytes(std::size_t slots, std::size_t segment_bytes) {
  return slots * segment_bytes;
}

std::size_t worker_receive_bytes(std::size_t lanes, std::size_t state_bytes,
                                 std::size_t weights_bytes) {
  return 2 * (lanes * state_bytes + weights_bytes);
}

std::size_t probe_receive_buffer(std::size_t wanted) {
  const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return 0;
  const int ask = static_cast<int>(std::min<std::size_t>(wanted, std::size_t{1} << 30));
  setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &ask, sizeof ask);
  int got = 0;
  socklen_t size = sizeof got;
  const bool ok = getsockopt(fd, SOL_SOCKET, SO_RCVBUF, &got, &size) == 0;
  close(fd);
  return ok ? static_cast<std::size_t>(got) / 2 : 0;
}

DdsProfile choose_dds_profile(std::size_t needed_bytes) {
  DdsProfile profile;
  profile.receive_buffer_bytes = probe_receive_buffer(kReceiveBufferBytes);
  profile.small_buffer = profile.receive_buffer_bytes < std::min(needed_bytes, kReceiveBufferBytes);
  if (profile.small_buffer) {
    profile.task_spacing_ns = kSmallBufferSpacingNs;
    log().warn(
        "event=small_receive_buffer usable_bytes={} needed_bytes={} help=\"sysctl -w "
        "net.core.rmem_max={} on the host; tasks are spaced {} us apart until then\"",
        profile.receive_buffer_bytes, needed_bytes, kReceiveBufferBytes,
        kSmallBufferSpacingNs / 1000);
  }
  // Read once at start, before any thread is made.
  const char* uri = std::getenv("CYCLONEDDS_URI");  // NOLINT(concurrency-mt-unsafe)
  if (uri != nullptr && *uri != '\0') {
    profile.name = "environment";
    profile.uri = uri;
  } else {
    profile.name = profile.small_buffer ? "small-buffer" : "mesh";
    profile.uri = dds_profile_xml(profile.name);
  }
  return profile;
}

std::string dds_profile_xml(const std::string& name) {
  if (name == "mesh") return profile_text(kLargeWatermarks);
  if (name == "small-buffer") return profile_text(kSmallWatermarks);
  throw_error("DDS profile \"{}\": mesh, small-buffer", name);
}

std::string dds_environment(const DdsProfile& profile) {
  std::string quoted;
  for (const char c : profile.uri) {
    if (c == '\'') {
      quoted += "'\\''";
    } else if (c != '\n') {
      quoted += c;
    }
  }
  return fmt::format("export CYCLONEDDS_URI='{}'\n", quoted);
}

}  // namespace omentum
