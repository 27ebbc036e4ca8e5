#include "dvrk_gateway/protocol/udp_socket.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "core/check.h"
#include "core/clock.h"

namespace omentum {
namespace {

sockaddr_in to_socket_address(const UdpAddress& address) {
  sockaddr_in raw{};
  raw.sin_family = AF_INET;
  raw.sin_addr.s_addr = htonl(address.ipv4);
  raw.sin_port = htons(address.port);
  return raw;
}

UdpAddress to_udp_address(const sockaddr_in& raw) {
  return {ntohl(raw.sin_addr.s_addr), ntohs(raw.sin_port)};
}

std::string reason() { return std::strerror(errno); }  // NOLINT(concurrency-mt-unsafe): start-up

}  // namespace

std::int64_t SteadyClock::now_ns() noexcept { return steady_now_ns(); }

void SteadyClock::sleep_until(std::int64_t time_ns) noexcept {
  constexpr std::int64_t kSecond_ns = 1'000'000'000;
  const timespec until{time_ns / kSecond_ns, time_ns % kSecond_ns};
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
}

UdpSocket::UdpSocket(std::uint16_t port, std::size_t max_send_bytes)
    : max_send_bytes_(max_send_bytes) {
  socket_ = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (socket_ < 0) throw_error("no UDP socket: {}", reason());
  sockaddr_in raw = to_socket_address({INADDR_ANY, port});
  socklen_t size = sizeof raw;
  if (bind(socket_, reinterpret_cast<sockaddr*>(&raw), size) != 0 ||
      getsockname(socket_, reinterpret_cast<sockaddr*>(&raw), &size) != 0) {
    const std::string why = reason();
    close(socket_);
    throw_error("UDP port {} cannot be used: {}", port, why);
  }
  port_ = ntohs(raw.sin_port);
}

UdpSocket::~UdpSocket() { close(socket_); }

std::optional<Link::Received> UdpSocket::receive(std::span<char> memory) noexcept {
  while (true) {
    sockaddr_in raw{};
    iovec part{memory.data(), memory.size()};
    msghdr message{};
    message.msg_name = &raw;
    message.msg_namelen = sizeof raw;
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    const ssize_t size = recvmsg(socket_, &message, 0);
    if (size >= 0) {
      return Received{static_cast<std::size_t>(size), to_udp_address(raw),
                      (message.msg_flags & MSG_TRUNC) != 0};
    }
    if (errno == EAGAIN || errno == EWOULDBLOCK) return std::nullopt;
    // An earlier datagram found nobody (ECONNREFUSED); what waits behind the error is still there.
    ++failed_;
    if (errno != EINTR && errno != ECONNREFUSED) return std::nullopt;
  }
}

SendOutcome UdpSocket::send(std::string_view datagram, const UdpAddress& to) noexcept {
  if (datagram.empty() || datagram.size() > max_send_bytes_) return SendOutcome::kRefused;
  const sockaddr_in raw = to_socket_address(to);
  const ssize_t size = sendto(socket_, datagram.data(), datagram.size(), 0,
                              reinterpret_cast<const sockaddr*>(&raw), sizeof raw);
  if (size == static_cast<ssize_t>(datagram.size())) return SendOutcome::kSent;
  ++failed_;
  return SendOutcome::kFailed;
}

UdpAddress resolve_address(const std::string& what, const std::string& host, std::uint16_t port) {
  addrinfo wanted{};
  wanted.ai_family = AF_INET;
  wanted.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const int error = getaddrinfo(host.c_str(), nullptr, &wanted, &found);
  if (error != 0) throw_error("{}: {}: {}", what, host, gai_strerror(error));
  sockaddr_in raw{};
  std::memcpy(&raw, found->ai_addr, sizeof raw);
  freeaddrinfo(found);
  return {ntohl(raw.sin_addr.s_addr), port};
}

std::string to_string(const UdpAddress& address) {
  return fmt::format("{}.{}.{}.{}:{}", address.ipv4 >> 24, address.ipv4 >> 16 & 255,
                     address.ipv4 >> 8 & 255, address.ipv4 & 255, address.port);
}

}  // namespace omentum
