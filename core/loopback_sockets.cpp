#include "core/loopback_sockets.h"

#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>
#include <charconv>
#include <filesystem>
#include <system_error>

namespace omentum {
namespace {

bool is_open_udp(int descriptor) {
  int type = 0;
  socklen_t size = sizeof type;
  if (getsockopt(descriptor, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM)
    return false;
  sockaddr_in address{};
  size = sizeof address;
  return getsockname(descriptor, reinterpret_cast<sockaddr*>(&address), &size) == 0 &&
         address.sin_family == AF_INET && address.sin_addr.s_addr == INADDR_ANY;
}

}  // namespace

std::set<int> open_udp_sockets() {
  std::set<int> sockets;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd", error)) {
    const std::string name = entry.path().filename().string();
    int descriptor = -1;
    std::from_chars(name.data(), name.data() + name.size(), descriptor);
    if (is_open_udp(descriptor)) sockets.insert(descriptor);
  }
  return sockets;
}

Result<void> bind_to_loopback(int socket) {
  if (setsockopt(socket, SOL_SOCKET, SO_BINDTODEVICE, "lo", 2) == 0) return {};
  return Failure{"SO_BINDTODEVICE lo: " + std::generic_category().message(errno)};
}

}  // namespace omentum
