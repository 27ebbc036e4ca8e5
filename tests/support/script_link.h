#pragma once

#include <algorithm>
#include <deque>
#include <string>
#include <vector>

#include "dvrk_gateway/protocol/link.h"

namespace omentum::test {

/// Time that only a test moves.
class ScriptClock final : public Clock {
 public:
  std::int64_t now_ns() noexcept override { return time_ns; }
  void sleep_until(std::int64_t until_ns) noexcept override {
    time_ns = std::max(time_ns, until_ns);
  }
  std::int64_t time_ns = 0;
};

/// The network of a test: what was sent, when and where to, and what is to be received.
class ScriptLink final : public Link {
 public:
  struct Datagram {
    std::int64_t time_ns = 0;
    std::string text;
    UdpAddress address;  ///< it went to, or comes from
  };

  explicit ScriptLink(Clock& clock) : clock_(clock) {}

  /// Arrives at that moment; moments are given in order.
  void deliver(std::int64_t time_ns, std::string text, const UdpAddress& from) {
    arriving_.push_back({time_ns, std::move(text), from});
  }
  std::vector<Datagram> sent;

  std::optional<Received> receive(std::span<char> memory) noexcept override {
    if (arriving_.empty() || arriving_.front().time_ns > clock_.now_ns()) return std::nullopt;
    const Datagram next = std::move(arriving_.front());
    arriving_.pop_front();
    const std::size_t size = next.text.copy(memory.data(), memory.size());
    return Received{size, next.address, size < next.text.size()};
  }
  SendOutcome send(std::string_view datagram, const UdpAddress& to) noexcept override {
    sent.push_back({clock_.now_ns(), std::string(datagram), to});
    return SendOutcome::kSent;
  }

 private:
  Clock& clock_;
  std::deque<Datagram> arriving_;
};

}  // namespace omentum::test
