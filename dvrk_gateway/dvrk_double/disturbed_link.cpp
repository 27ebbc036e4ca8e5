#include "dvrk_gateway/dvrk_double/disturbed_link.h"

#include <algorithm>
#include <array>
#include <utility>

namespace omentum {
namespace {

std::int64_t to_ns(double seconds) { return static_cast<std::int64_t>(seconds * 1e9); }

constexpr auto kLater = [](const auto& a, const auto& b) {
  return std::pair(a.due_ns, a.number) > std::pair(b.due_ns, b.number);
};

}  // namespace

DisturbedLink::DisturbedLink(Link& under, Clock& clock, const Disturbance& out,
                             const Disturbance& in, std::uint64_t seed)
    : under_(under), clock_(clock), out_(out), in_(in), random_(seed, 0, Purpose::kDynamics, 0) {}

bool DisturbedLink::chance(double share) {
  return share > 0 && uniform_between(random_.next(), 0, 1) < share;
}

void DisturbedLink::put(Queue& queue, const Disturbance& disturbance, const Waiting& datagram) {
  if (chance(disturbance.loss)) {
    ++lost_;
    return;
  }
  const bool twice = chance(disturbance.duplication);
  if (twice) ++repeated_;
  for (int copy = 0; copy < (twice ? 2 : 1); ++copy) {
    double delay_s = disturbance.delay_s;
    if (disturbance.jitter_s > 0)
      delay_s += uniform_between(random_.next(), 0, disturbance.jitter_s);
    if (chance(disturbance.reordering)) delay_s += disturbance.reordering_s;
    queue.push_back(datagram);
    queue.back().due_ns = clock_.now_ns() + to_ns(delay_s);
    queue.back().number = count_++;
    std::push_heap(queue.begin(), queue.end(), kLater);
  }
}

DisturbedLink::Waiting DisturbedLink::take(Queue& queue) {
  std::pop_heap(queue.begin(), queue.end(), kLater);
  Waiting next = std::move(queue.back());
  queue.pop_back();
  return next;
}

void DisturbedLink::flush() noexcept {
  while (!outgoing_.empty() && outgoing_.front().due_ns <= clock_.now_ns()) {
    const Waiting next = take(outgoing_);
    if (under_.send(next.text, next.address) != SendOutcome::kSent) ++failed_;
  }
}

SendOutcome DisturbedLink::send(std::string_view datagram, const UdpAddress& to) noexcept {
  put(outgoing_, out_, {0, 0, to, std::string(datagram), false});
  flush();
  return SendOutcome::kSent;
}

std::optional<Link::Received> DisturbedLink::receive(std::span<char> memory) noexcept {
  flush();
  std::array<char, 65536> buffer;  // NOLINT(cppcoreguidelines-pro-type-member-init): written below
  while (const auto received = under_.receive(buffer)) {
    put(incoming_, in_,
        {0, 0, received->source, std::string(buffer.data(), received->size), received->cut});
  }
  if (incoming_.empty() || incoming_.front().due_ns > clock_.now_ns()) return std::nullopt;
  const Waiting next = take(incoming_);
  const std::size_t size = next.text.copy(memory.data(), memory.size());
  return Received{size, next.address, next.cut || size < next.text.size()};
}

}  // namespace omentum
