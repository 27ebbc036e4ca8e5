#pragma once

#include <set>

#include "core/result.h"

namespace omentum {

/// Descriptors of this process that are UDP sockets bound to every IPv4 address.
std::set<int> open_udp_sockets();

/// Lets a socket receive what comes over the interface lo only (SO_BINDTODEVICE, socket(7)).
Result<void> bind_to_loopback(int socket);

}  // namespace omentum
