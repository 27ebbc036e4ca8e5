#include "dvrk_gateway/loop/control_loop.h"

#include <string_view>
#include <utility>

#include "dvrk_gateway/protocol/codec.h"

namespace omentum {
namespace {

// A robot sends 16 datagrams in a period; a flood must not hold up the command.
constexpr int kMostDatagrams = 512;

}  // namespace

ControlLoop::ControlLoop(Link& link, Clock& clock, const SafetySetup& setup,
                         std::uint32_t robot_ipv4, bool dry_run)
    : link_(link),
      clock_(clock),
      setup_(setup),
      robot_ipv4_(robot_ipv4),
      dry_run_(dry_run),
      rehearsed_(setup) {
  period_.dry_run = dry_run;
}

void ControlLoop::begin() noexcept {
  ++period_.number;
  period_.began_ns = clock_.now_ns();
  period_.state_ns = period_.robot.measured_cp.arrival_ns;
}

const Period& ControlLoop::receive() noexcept {
  begin();
  take_in();
  period_.state_ns = period_.robot.measured_cp.arrival_ns;
  return period_;
}

void ControlLoop::take_in() noexcept {
  if (std::exchange(judged_, false)) heard_.gap_s = 0;
  for (int i = 0; i < kMostDatagrams; ++i) {
    const std::optional<Link::Received> received = link_.receive(memory_);
    if (!received) break;
    if (received->cut) {
      ++period_.cut;
      continue;
    }
    if (!heard_.has_source && robot_ipv4_ != 0 && received->source.ipv4 != robot_ipv4_) {
      ++heard_.foreign;
      heard_.foreign_source = received->source;
      continue;
    }
    take_datagram(heard_, std::string_view(memory_.data(), received->size), clock_.now_ns(),
                  received->source);
  }
  period_.robot = heard_;
  if (dry_run_ && period_.judgement.memory.phase == SafetyPhase::kActive)
    rehearsed_.show(period_.robot);
}

void ControlLoop::follow_restart(const GatewayEvents& events) noexcept {
  if (std::exchange(acknowledged_ns_, events.acknowledge_ns) == events.acknowledge_ns) return;
  if (period_.judgement.memory.phase == SafetyPhase::kActive || !moved_to_another_port(heard_))
    return;
  heard_.source = heard_.foreign_source;
  heard_.source_ns = heard_.foreign_ns;
}

bool ControlLoop::is_alarmed(const GatewayEvents& events) noexcept {
  take_in();
  return static_cast<bool>(
      must_hold(setup_, period_.judgement.memory, period_.robot, events, clock_.now_ns()));
}

bool ControlLoop::look(const GatewayEvents& events) noexcept {
  if (!is_alarmed(events)) return false;
  // Nothing more is taken in: it might end the alarm, and a period without a request is no look.
  begin();
  send({}, events);
  return true;
}

const Period& ControlLoop::send(const PolicyRequest& request,
                                const GatewayEvents& events) noexcept {
  const SafetyPhase before = period_.judgement.memory.phase;
  period_.judgement =
      judge(setup_, period_.judgement.memory, period_.robot, request, events, clock_.now_ns());
  judged_ = true;
  period_.sent_ns = 0;
  period_.sent_bytes = 0;
  follow_restart(events);
  if (dry_run_ && before != SafetyPhase::kActive) rehearsed_.begin(period_.robot);
  if (!period_.judgement.send) return period_;
  if (dry_run_) {
    rehearsed_.obey(period_.judgement.command);
    return period_;
  }
  std::array<char, kMaxCommandBytes> command{};
  const std::size_t size = encode_command(period_.judgement.command, command);
  const bool sent = size > 0 && link_.send(std::string_view(command.data(), size),
                                           period_.robot.source) == SendOutcome::kSent;
  if (sent) {
    period_.sent_ns = clock_.now_ns();
    period_.sent_bytes = size;
  } else {
    ++period_.unsent;
  }
  return period_;
}

}  // namespace omentum
