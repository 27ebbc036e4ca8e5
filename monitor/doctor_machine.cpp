// What `omentum doctor` looks at on the machine itself.
#include <arpa/inet.h>
#include <fmt/core.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/timex.h>
#include <unistd.h>

#include <array>
#include <memory>

#include "core/certificate.h"
#include "monitor/doctor.h"

namespace omentum {
namespace {

constexpr std::uint32_t kMaxIndex = 80;          // core/dds_config.cpp: MaxAutoParticipantIndex
constexpr std::int64_t kNearS = 14 * 24 * 3600;  // as the programs warn (docs/cluster.md 5)

std::string text_of(const sockaddr* address) {
  std::array<char, INET_ADDRSTRLEN> text{};
  const auto* ipv4 = reinterpret_cast<const sockaddr_in*>(address);
  return inet_ntop(AF_INET, &ipv4->sin_addr, text.data(), text.size()) != nullptr ? text.data()
                                                                                  : "";
}

bool port_is_free(std::uint32_t port) {
  const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return false;
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  const bool free = bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  close(fd);
  return free;
}

}  // namespace

Finding check_receive_buffer(std::size_t usable_bytes) {
  const std::string detail = fmt::format("{} of {} bytes", usable_bytes, kReceiveBufferBytes);
  if (usable_bytes >= kReceiveBufferBytes) return {true, "receive buffer", detail, ""};
  return {false, "receive buffer", detail + ": bursts are spaced, batches 30 % slower",
          fmt::format("on the host, not in a container: sysctl -w net.core.rmem_max={}",
                      kReceiveBufferBytes)};
}

Finding check_clock() {
  timex clock{};
  const int state = adjtimex(&clock);
  if (state < 0) return {true, "clock", "cannot be asked here", ""};
  if (state != TIME_ERROR && (clock.status & STA_UNSYNC) == 0) {
    return {true, "clock", fmt::format("synchronised, error at most {} ms", clock.maxerror / 1000),
            ""};
  }
  return {false, "clock", "nobody keeps it right: certificates and logs go by it",
          "apt-get install chrony, or timedatectl set-ntp true"};
}

Finding check_cpu() {
  // Without AVX2 this program would have ended before main (core/cpu_check.cpp).
  const bool wide = __builtin_cpu_supports("avx512f") != 0;
  return {true, "CPU",
          fmt::format("AVX2 and FMA{}: {} lanes", wide ? ", AVX-512" : "", wide ? 16 : 8), ""};
}

Finding check_interfaces(const std::string& wanted) {
  ifaddrs* found = nullptr;
  if (getifaddrs(&found) != 0) return {false, "interfaces", "no list of interfaces", "ip address"};
  const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> list(found, &freeifaddrs);
  std::string up;
  bool there = wanted.empty(), loopback = false;
  for (const ifaddrs* at = found; at != nullptr; at = at->ifa_next) {
    if (at->ifa_addr == nullptr || at->ifa_addr->sa_family != AF_INET) continue;
    if ((at->ifa_flags & IFF_UP) == 0) continue;
    const std::string address = text_of(at->ifa_addr);
    up += fmt::format("{}{} {}", up.empty() ? "" : ", ", at->ifa_name, address);
    there = there || wanted == at->ifa_name || wanted == address;
    loopback = loopback || (at->ifa_flags & IFF_LOOPBACK) != 0;
  }
  if (!loopback) return {false, "interfaces", "lo is down", "ip link set lo up"};
  if (there) return {true, "interfaces", up, ""};
  return {false, "interfaces", fmt::format("{} is not up; up are {}", wanted, up),
          "name another with --interface, or leave it out"};
}

Finding check_name(const std::string& host) {
  addrinfo hints{};
  hints.ai_family = AF_INET;
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const int code = getaddrinfo(host.c_str(), nullptr, &hints, &found);
  if (code != 0) {
    return {false, "name", fmt::format("{}: {}", host, gai_strerror(code)),
            "start that host or container first, correct the name, or give its address"};
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> list(found, &freeaddrinfo);
  return {true, "name", fmt::format("{} is {}", host, text_of(list->ai_addr)), ""};
}

Finding check_ports(std::uint32_t domain) {
  const std::uint32_t first = discovery_port(domain);
  std::uint32_t free = 0;
  for (std::uint32_t index = 0; index <= kMaxIndex; ++index)
    free += port_is_free(first + 2 * index) ? 1 : 0;
  const std::string detail =
      fmt::format("{} of {} UDP ports from {} on are free", free, kMaxIndex + 1, first);
  if (free > 0) return {true, "ports", detail, ""};
  return {false, "ports", detail, "choose another --domain (ss -ulnp shows who has them)"};
}

Finding check_certificates(const std::string& dir, std::int64_t now_s) {
  const Result<Certificate> found = check_security_dir(dir);
  if (!found) return {false, "certificates", found.error(), "deploy/security/make.sh --help"};
  const Certificate& c = found.value();
  const std::string detail = fmt::format("{} until {}", c.name, date_text(c.end_s));
  if (c.end_s - now_s > kNearS) return {true, "certificates", detail, ""};
  return {false, "certificates", detail + ", in less than 14 days",
          "deploy/security/make.sh --renew, and copy the folder to its host again"};
}

}  // namespace omentum
