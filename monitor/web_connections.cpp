#include "monitor/web_connections.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>

#include "core/clock.h"

namespace omentum {
namespace {

constexpr int kSliceMs = 100;

// A connection beyond the limit is handled by the thread that accepts: it closes it.
thread_local bool refuse = false;

/// Waits until the socket is ready; false at the end of the time.
bool ready(int socket, short event, std::int64_t end_ns) {
  while (true) {
    const std::int64_t left_ms = (end_ns - steady_now_ns()) / 1'000'000;
    if (left_ms <= 0) return false;
    pollfd one{socket, event, 0};
    const int count = ::poll(&one, 1, static_cast<int>(std::min<std::int64_t>(left_ms, 60'000)));
    if (count > 0) return true;
    if (count < 0 && errno != EINTR) return false;
  }
}

/// A socket whose reads and writes all end at one time.
class TimedStream : public httplib::Stream {
 public:
  TimedStream(int socket, std::int64_t end_ns) : socket_(socket), end_ns_(end_ns) {}

  bool is_readable() const override { return at_ < filled_ || ready(socket_, POLLIN, end_ns_); }
  bool is_writable() const override { return ready(socket_, POLLOUT, end_ns_); }
  ssize_t read(char* bytes, size_t size) override {
    if (at_ == filled_) {
      if (!is_readable()) return -1;
      const ssize_t got = ::recv(socket_, buffer_.data(), buffer_.size(), 0);
      if (got <= 0) return got;
      at_ = 0;
      filled_ = static_cast<std::size_t>(got);
    }
    const std::size_t count = std::min(size, filled_ - at_);
    std::copy_n(buffer_.data() + at_, count, bytes);
    at_ += count;
    return static_cast<ssize_t>(count);
  }
  ssize_t write(const char* bytes, size_t size) override {
    if (!is_writable()) return -1;
    return ::send(socket_, bytes, size, MSG_NOSIGNAL | MSG_DONTWAIT);
  }
  void get_remote_ip_and_port(std::string& ip, int& port) const override {
    name(&::getpeername, ip, port);
  }
  void get_local_ip_and_port(std::string& ip, int& port) const override {
    name(&::getsockname, ip, port);
  }
  socket_t socket() const override { return socket_; }
  void end_at(std::int64_t end_ns) { end_ns_ = end_ns; }

 private:
  template <typename Fn>
  void name(Fn ask, std::string& ip, int& port) const {
    sockaddr_storage address{};
    socklen_t size = sizeof address;
    std::array<char, INET6_ADDRSTRLEN> text{};
    if (ask(socket_, reinterpret_cast<sockaddr*>(&address), &size) != 0) return;
    const bool six = address.ss_family == AF_INET6;
    const auto* four_at = reinterpret_cast<const sockaddr_in*>(&address);
    const auto* six_at = reinterpret_cast<const sockaddr_in6*>(&address);
    const void* from = six ? static_cast<const void*>(&six_at->sin6_addr) : &four_at->sin_addr;
    if (inet_ntop(address.ss_family, from, text.data(), text.size()) != nullptr) ip = text.data();
    port = ntohs(six ? six_at->sin6_port : four_at->sin_port);
  }

  int socket_;
  std::int64_t end_ns_;
  std::array<char, 4096> buffer_{};
  std::size_t at_ = 0, filled_ = 0;
};

/// Threads for so many connections; one more is refused.
class Pool : public httplib::TaskQueue {
 public:
  explicit Pool(std::size_t most) : most_(most), threads_(most) {}
  void enqueue(std::function<void()> connection) override {
    if (open_.load() >= most_) {
      refuse = true;
      connection();
      refuse = false;
      return;
    }
    ++open_;
    threads_.enqueue([this, connection = std::move(connection)] {
      connection();
      --open_;
    });
  }
  void shutdown() override { threads_.shutdown(); }

 private:
  std::size_t most_;
  std::atomic<std::size_t> open_ = 0;
  httplib::ThreadPool threads_;
};

std::int64_t from_now(int ms) { return steady_now_ns() + std::int64_t{1'000'000} * ms; }

}  // namespace

BoundedServer::BoundedServer(const Limits& limits) : limits_(limits) {
  new_task_queue = [this] { return new Pool(limits_.connections); };
}

bool BoundedServer::process_and_close_socket(socket_t socket) {
  bool served = false;
  if (!refuse) {
    TimedStream stream(socket, 0);
    for (int left = limits_.requests; left > 0; --left) {
      const std::int64_t idle_end = from_now(limits_.idle_ms);
      do {  // in slices: a server that stops does not wait for a browser
        stream.end_at(std::min(idle_end, from_now(kSliceMs)));
      } while (!stream.is_readable() && is_running() && steady_now_ns() < idle_end);
      stream.end_at(from_now(kSliceMs));
      if (!stream.is_readable()) break;
      stream.end_at(from_now(limits_.request_ms));
      bool closed = false;
      served = process_request(stream, left == 1 || !is_running(), closed, nullptr);
      if (!served || closed) break;
    }
  }
  ::shutdown(socket, SHUT_RDWR);
  ::close(socket);
  return served;
}

std::string plain_address(const std::string& address) {
  const bool bracketed = address.size() > 2 && address.front() == '[' && address.back() == ']';
  return bracketed ? address.substr(1, address.size() - 2) : address;
}

std::string address_in_url(const std::string& address) {
  const std::string plain = plain_address(address);
  return plain.find(':') == std::string::npos ? plain : "[" + plain + "]";
}

}  // namespace omentum
