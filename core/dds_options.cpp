#include "core/dds_options.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <thread>

#include "core/certificate.h"
#include "core/check.h"
#include "core/clock.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr std::int64_t kNsPerS = 1'000'000'000;
constexpr std::int64_t kSmallBufferSpacingNs = 200'000;  // docs/wire.md 5.3

std::string text_of(const in_addr& address) {
  std::array<char, INET_ADDRSTRLEN> text{};
  return inet_ntop(AF_INET, &address, text.data(), text.size()) != nullptr ? text.data() : "";
}

/// First IPv4 address of a name.
Result<in_addr> resolve(const std::string& name) {
  addrinfo hints{};
  hints.ai_family = AF_INET;
  hints.ai_socktype = SOCK_DGRAM;
  addrinfo* found = nullptr;
  const int code = getaddrinfo(name.c_str(), nullptr, &hints, &found);
  if (code != 0) {
    hints.ai_family = AF_INET6;
    const bool six = getaddrinfo(name.c_str(), nullptr, &hints, &found) == 0;
    if (six) freeaddrinfo(found);
    return Failure{fmt::format(
        "host name {}: {}", name,
        six ? "has an address of IPv6 only, and DDS goes over IPv4 here" : gai_strerror(code))};
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> list(found, &freeaddrinfo);
  sockaddr_in address{};
  std::memcpy(&address, list->ai_addr, sizeof address);
  return address.sin_addr;
}

/// Address of the interface that packets to `peer` leave through. Nothing is sent.
Result<std::string> interface_towards(const in_addr& peer) {
  const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_addr = peer;
  to.sin_port = htons(9);
  sockaddr_in from{};
  socklen_t size = sizeof from;
  const bool ok = fd >= 0 && connect(fd, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0 &&
                  getsockname(fd, reinterpret_cast<sockaddr*>(&from), &size) == 0;
  if (fd >= 0) close(fd);
  if (!ok) return Failure{fmt::format("no route to {}", text_of(peer))};
  return text_of(from.sin_addr);
}

/// Address of the first interface that is up and not the loopback.
Result<std::string> first_interface() {
  ifaddrs* found = nullptr;
  if (getifaddrs(&found) != 0) return Failure{"no list of interfaces"};
  const std::unique_ptr<ifaddrs, decltype(&freeifaddrs)> list(found, &freeifaddrs);
  std::string six;
  for (const ifaddrs* at = found; at != nullptr; at = at->ifa_next) {
    if (at->ifa_addr == nullptr) continue;
    if ((at->ifa_flags & IFF_UP) == 0 || (at->ifa_flags & IFF_LOOPBACK) != 0) continue;
    if (at->ifa_addr->sa_family == AF_INET6) six = at->ifa_name;
    if (at->ifa_addr->sa_family != AF_INET) continue;
    return text_of(reinterpret_cast<const sockaddr_in*>(at->ifa_addr)->sin_addr);
  }
  if (!six.empty()) {
    return Failure{fmt::format(
        "interface {} has an address of IPv6 only: DDS goes over IPv4 here, give it one", six)};
  }
  return Failure{"no interface is up but the loopback"};
}

Discovery discovery_of(const DdsOptions& options) {
  if (options.discovery == "loopback") return Discovery::kLoopback;
  if (options.discovery == "mesh") return Discovery::kMesh;
  if (options.discovery == "hub") return Discovery::kHub;
  throw_error("--discovery {}: loopback, mesh or hub", options.discovery);
}

void check_options(const DdsOptions& options, Discovery discovery, DdsRole role) {
  if (discovery == Discovery::kMesh && options.peers.empty())
    throw_error("--discovery mesh needs --peers HOST,HOST,...");
  if (discovery == Discovery::kHub && role == DdsRole::kOther && options.hub.empty())
    throw_error("--discovery hub needs --hub HOST, the learner's");
  if (discovery != Discovery::kMesh && !options.peers.empty())
    throw_error("--peers has a meaning with --discovery mesh only");
  if (discovery != Discovery::kHub && !options.hub.empty())
    throw_error("--hub has a meaning with --discovery hub only");
  if (discovery == Discovery::kLoopback && !options.interface.empty())
    throw_error("--interface has no meaning with --discovery loopback");
}

/// Fills in peers and interface.
Result<void> find_peers(const DdsOptions& options, std::uint32_t domain, DdsConfig& config) {
  config.interface = options.interface;
  std::vector<std::string> hosts = options.peers;
  if (!options.hub.empty()) hosts = {options.hub};
  for (const std::string& host : hosts) {
    const Result<in_addr> address = resolve(host);
    if (!address) return Failure{address.error()};
    std::string peer = text_of(address.value());
    if (config.discovery == Discovery::kHub) peer += fmt::format(":{}", discovery_port(domain));
    config.peers.push_back(peer);
    if (!config.interface.empty()) continue;
    Result<std::string> own = interface_towards(address.value());
    if (!own) return Failure{own.error()};
    config.interface = std::move(own).value();
  }
  // A hub that was not told its own name.
  if (!config.interface.empty()) return {};
  Result<std::string> first = first_interface();
  if (!first) return Failure{first.error()};
  config.interface = std::move(first).value();
  return {};
}

}  // namespace

void add_dds_options(CLI::App& app, DdsOptions& options) {
  constexpr const char* kGroup = "Network";
  app.add_option("--discovery", options.discovery,
                 "How processes find each other: loopback (this machine), mesh (--peers) or hub "
                 "(everybody knows the learner's host)")
      ->envname("OMENTUM_DISCOVERY")
      ->capture_default_str()
      ->group(kGroup);
  app.add_option("--peers", options.peers,
                 "Hosts for --discovery mesh, names or addresses: A,B,...")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->envname("OMENTUM_PEERS")
      ->group(kGroup);
  app.add_option("--hub", options.hub,
                 "Host of the learner for --discovery hub, a name or an address")
      ->envname("OMENTUM_HUB")
      ->group(kGroup);
  app.add_option("--interface", options.interface,
                 "Network interface, a name or an address; default: the one that routes to the hub "
                 "or to the first peer")
      ->envname("OMENTUM_INTERFACE")
      ->group(kGroup);
  app.add_option("--security-dir", options.security_dir,
                 "Folder with certificate, key and permissions of this program's role, from "
                 "deploy/security/make.sh; default: no DDS Security")
      ->envname("OMENTUM_SECURITY_DIR")
      ->group(kGroup);
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

Result<DdsProfile> find_dds_profile(const DdsOptions& options, DdsRole role, std::uint32_t domain,
                                    std::size_t needed_bytes) {
  DdsConfig config;
  config.discovery = discovery_of(options);
  config.role = role;
  config.security_dir = options.security_dir;
  check_options(options, config.discovery, role);

  DdsProfile profile;
  profile.discovery = config.discovery;
  profile.role = role;
  profile.security_dir = options.security_dir;
  profile.receive_buffer_bytes = probe_receive_buffer(kReceiveBufferBytes);
  profile.small_buffer = profile.receive_buffer_bytes < std::min(needed_bytes, kReceiveBufferBytes);
  if (profile.small_buffer) profile.task_spacing_ns = kSmallBufferSpacingNs;
  // Read at start, before any thread is made.
  const char* uri = std::getenv("CYCLONEDDS_URI");  // NOLINT(concurrency-mt-unsafe)
  if (uri != nullptr && *uri != '\0') {
    profile.name = "environment";
    profile.uri = uri;
    return profile;
  }
  if (config.discovery != Discovery::kLoopback) {
    if (Result<void> found = find_peers(options, domain, config); !found)
      return Failure{found.error()};
  }
  if (!options.security_dir.empty()) {
    const Result<Certificate> certificate = check_security_dir(options.security_dir);
    if (!certificate) throw_error("--security-dir: {}", certificate.error());
    profile.certificate_name = certificate.value().name;
    profile.certificate_end_s = certificate.value().end_s;
  }
  config.large_buffers = !profile.small_buffer;
  profile.name = options.discovery;
  profile.uri = dds_config_xml(config);
  return profile;
}

std::optional<DdsProfile> wait_for_dds_profile(const DdsOptions& options, DdsRole role,
                                               std::uint32_t domain, std::size_t needed_bytes,
                                               std::int64_t max_wait_ns,
                                               const std::function<bool()>& stop) {
  constexpr std::int64_t kTellNs = 60'000'000'000;
  constexpr auto kAgain = std::chrono::milliseconds(500);
  const std::int64_t began = steady_now_ns();
  std::int64_t told = 0;
  while (!stop()) {
    Result<DdsProfile> found = find_dds_profile(options, role, domain, needed_bytes);
    if (found) {
      tell_of_small_buffers(found.value(), needed_bytes);
      return std::move(found).value();
    }
    const std::int64_t now = steady_now_ns();
    if (max_wait_ns > 0 && now - began > max_wait_ns) {
      log().error("event=gave_up reason=\"{}\"", found.error());
      return std::nullopt;
    }
    if (told == 0 || now - told > kTellNs) {
      log().warn("waiting: {}", found.error());
      told = now;
    }
    std::this_thread::sleep_for(kAgain);  // a rate: there is no event for a name that appears
  }
  return std::nullopt;
}

void tell_of_small_buffers(const DdsProfile& profile, std::size_t needed_bytes) {
  if (!profile.small_buffer) return;
  log().warn(
      "event=small_receive_buffer usable_bytes={} needed_bytes={} help=\"sysctl -w "
      "net.core.rmem_max={} on the host; tasks are spaced {} us apart until then\"",
      profile.receive_buffer_bytes, needed_bytes, kReceiveBufferBytes,
      kSmallBufferSpacingNs / 1000);
}

std::optional<std::string> certificate_warning(const DdsProfile& profile) {
  constexpr std::int64_t kWarnS = std::int64_t{14} * 24 * 3600;
  const std::int64_t left_s = profile.certificate_end_s - wall_now_ns() / kNsPerS;
  if (profile.certificate_end_s == 0 || left_s > kWarnS) return std::nullopt;
  const std::string end = date_text(profile.certificate_end_s);
  const Result<std::int64_t> now = certificate_end(profile.security_dir);
  if (now && now.value() > profile.certificate_end_s) {
    return fmt::format("certificate {} ends {}; its renewed one, valid until {}, is taken then",
                       profile.certificate_name, end, date_text(now.value()));
  }
  return fmt::format("certificate {} ends {}: deploy/security/make.sh --renew --role {}",
                     profile.certificate_name, end,
                     profile.certificate_name.substr(0, profile.certificate_name.find('-')));
}

void ProfileAlarms::raise(Alarms& alarms, const DdsProfile& profile, std::int64_t now_ns) {
  constexpr std::int64_t kAskNs = 60 * kNsPerS;
  alarms.set("buffers", profile.small_buffer,
             fmt::format("a socket holds {} bytes: sysctl -w net.core.rmem_max={} on the host",
                         profile.receive_buffer_bytes, kReceiveBufferBytes));
  if (asked_ns_ > 0 && now_ns - asked_ns_ < kAskNs) return;
  asked_ns_ = now_ns;
  const std::optional<std::string> warning = certificate_warning(profile);
  alarms.set("certificate", warning.has_value(), warning.value_or(""));
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
