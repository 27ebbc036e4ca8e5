#pragma once

#include <string>

#include "dvrk_gateway/protocol/link.h"

namespace omentum {

/// A non-blocking IPv4 UDP socket for both directions: the robot sends its stream to whoever spoke
/// to it last, so that a second socket would take the stream away from the first (docs/dvrk.md
/// 4.1). Counts what the network refused.
class UdpSocket final : public Link {
 public:
  /// Bound to `port` of every address; 0: a free one. Longer datagrams than `max_send_bytes` are
  /// refused. Throws Error: one line with the port and the reason.
  explicit UdpSocket(std::uint16_t port, std::size_t max_send_bytes = 65507);
  ~UdpSocket() override;

  std::optional<Received> receive(std::span<char> memory) noexcept override;
  SendOutcome send(std::string_view datagram, const UdpAddress& to) noexcept override;

  std::uint16_t port() const { return port_; }
  int descriptor() const { return socket_; }
  std::uint64_t failed() const { return failed_; }  ///< sends and receptions

 private:
  int socket_ = -1;
  std::uint16_t port_ = 0;
  std::size_t max_send_bytes_;
  std::uint64_t failed_ = 0;
};

/// "192.168.1.7" or a host name that is one in IPv4, and a port. Throws Error naming `what`. It may
/// wait for a name server: only at the start.
UdpAddress resolve_address(const std::string& what, const std::string& host, std::uint16_t port);

/// "192.168.1.7:48051"
std::string to_string(const UdpAddress& address);

}  // namespace omentum
