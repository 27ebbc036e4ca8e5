#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/rng.h"
#include "dvrk_gateway/protocol/link.h"

namespace omentum {

/// What a network does to datagrams of one direction; all off by default. Shares are 0 ... 1, times
/// not below 0 [s].
struct Disturbance {
  double loss = 0;         ///< share that never arrives
  double duplication = 0;  ///< share that arrives twice
  double delay_s = 0;      ///< of every one
  double jitter_s = 0;     ///< uniform from 0, beside the delay
  double reordering = 0;   ///< share that is held back by `reordering_s`
  double reordering_s = 0.015;

  /// Whether it changes anything.
  bool any() const {
    return loss > 0 || duplication > 0 || delay_s > 0 || jitter_s > 0 || reordering > 0;
  }
};

/// A network between two Links: loses, repeats, delays and reorders, the same for the same seed and
/// the same datagrams. Allocates; for the double and for tests. One thread.
class DisturbedLink final : public Link {
 public:
  /// `under` and `clock` must outlive it. `out` is for what is sent, `in` for what is received.
  DisturbedLink(Link& under, Clock& clock, const Disturbance& out, const Disturbance& in,
                std::uint64_t seed);

  /// The next datagram that is due; nothing while none is. Of one that is longer than `memory` the
  /// beginning, with `cut`.
  std::optional<Received> receive(std::span<char> memory) noexcept override;
  /// Says kSent of what is lost as well, as a network does.
  SendOutcome send(std::string_view datagram, const UdpAddress& to) noexcept override;

  /// Sends what is due; call it at least as often as datagrams are to leave on time.
  void flush() noexcept;

  // Counts of both directions together.
  std::uint64_t lost() const { return lost_; }
  std::uint64_t repeated() const { return repeated_; }
  std::uint64_t failed() const { return failed_; }  ///< not taken by `under` when due

 private:
  struct Waiting {
    std::int64_t due_ns = 0;
    std::uint64_t number = 0;
    UdpAddress address;
    std::string text;
    bool cut = false;
  };
  using Queue = std::vector<Waiting>;  ///< heap, the next one first
  bool chance(double share);
  void put(Queue& queue, const Disturbance& disturbance, const Waiting& datagram);
  static Waiting take(Queue& queue);

  Link& under_;
  Clock& clock_;
  Disturbance out_, in_;
  RandomStream random_;
  Queue outgoing_, incoming_;
  std::uint64_t count_ = 0, lost_ = 0, repeated_ = 0, failed_ = 0;
};

}  // namespace omentum
