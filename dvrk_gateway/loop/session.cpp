#include "dvrk_gateway/loop/session.h"

#include <chrono>
#include <utility>

#include "core/log.h"
#include "dvrk_gateway/protocol/codec.h"

namespace omentum {
namespace {

/// The arm is held three times (docs/dvrk.md 7.1) before the periods end.
constexpr auto kHoldTime = std::chrono::milliseconds(100);

}  // namespace

GatewaySession::GatewaySession(const UdpAddress& robot, std::uint16_t port,
                               const SafetySetup& safety, bool dry_run)
    : socket_(port, kMaxCommandBytes),
      control_(socket_, clock_, safety, robot.ipv4, dry_run),
      real_time_(control_, clock_, events_) {
  for (const std::string& warning : real_time_.start()) log().warn("{}", warning);
}

GatewaySession::~GatewaySession() { end(); }

void GatewaySession::attend(std::function<OperatorWishes()> wishes,
                            std::vector<GatewayObserver*> observers) {
  observers_ = std::move(observers);
  attendant_ = std::thread([this, wishes = std::move(wishes)] {
    while (!end_) {
      const OperatorWishes asked = wishes();
      take(asked);
      tell();
      if (asked.end) end_ = true;
    }
    events_.stop_ns = clock_.now_ns();
    std::this_thread::sleep_for(kHoldTime);
    real_time_.stop();
    tell();
  });
}

void GatewaySession::take(const OperatorWishes& wishes) {
  const std::int64_t now_ns = clock_.now_ns();
  if (wishes.arm) events_.arm_ns = now_ns;
  if (wishes.held) events_.held_ns = now_ns;
  if (wishes.stop) events_.stop_ns = now_ns;
  if (wishes.acknowledge) events_.acknowledge_ns = now_ns;
}

void GatewaySession::tell() {
  for (Period period; real_time_.watch(period);) {
    for (GatewayObserver* observer : observers_) observer->on_period(period);
  }
}

void GatewaySession::end() {
  end_ = true;
  if (attendant_.joinable()) attendant_.join();
  real_time_.stop();
}

}  // namespace omentum
