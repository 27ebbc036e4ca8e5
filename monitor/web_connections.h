#pragma once

#include <httplib.h>

#include <cstddef>
#include <string>

namespace omentum {

/// The server of a page whose connections have an end: each request must be read and answered in a
/// given time, however slowly its bytes come, and so many connections are open at most; one more is
/// closed at once. The library bounds the time of a single read, and no number at all.
class BoundedServer : public httplib::Server {
 public:
  struct Limits {
    std::size_t connections = 32;  ///< each has a thread
    int request_ms = 10'000;
    int idle_ms = 5'000;  ///< between two requests of a connection
    int requests = 100;   ///< of a connection
  };
  explicit BoundedServer(const Limits& limits);

 private:
  bool process_and_close_socket(socket_t socket) override;

  Limits limits_;
};

/// "[::1]" as "::1": the words of a URL are an address as well. As it is otherwise.
std::string plain_address(const std::string& address);
/// As a URL writes it: "::1" in brackets.
std::string address_in_url(const std::string& address);

}  // namespace omentum
