#include "dvrk_gateway/bus/gateway_bus.h"

#include <pthread.h>
#include <sched.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstring>
#include <optional>
#include <thread>
#include <utility>

#include "core/check.h"
#include "core/clock.h"
#include "core/log.h"
#include "core/topics.h"

namespace omentum {
namespace {

constexpr std::int64_t kAskNs = 1'000'000'000;

/// On a thread of its own that is no real-time thread, whatever the calling one is: those that it
/// makes are as urgent as itself, and none of the bus may hold up the control loop.
Result<void> on_ordinary_thread(const std::function<Result<void>()>& work) {
  Result<void> done;
  std::thread([&] {
    const sched_param none{};
    const int code = pthread_setschedparam(pthread_self(), SCHED_OTHER, &none);
    done = code == 0 ? work() : Failure{fmt::format("SCHED_OTHER was refused: error {}", code)};
  }).join();
  return done;
}

}  // namespace

void add_bus_options(CLI::App& app, BusOptions& options) {
  app.add_option(
      "--run", options.run,
      "Name of the run on whose DDS topics the robot's state is published; default: none is");
  app.add_option("--domain", options.domain, "DDS domain of the run, 0 ... 230")
      ->check(CLI::Range(0, 230))
      ->capture_default_str();
  app.add_option("--arm", options.arm, "Name of the arm in topics and messages")
      ->capture_default_str();
  app.add_flag("--ros", options.ros,
               "Also publish rt/ARM/measured_cp and rt/ARM/operating_state, as ROS 2 reads them");
  add_dds_options(app, options.dds);
}

void check_bus_options(const BusOptions& options) {
  // A token of a ROS name.
  const std::string& arm = options.arm;
  const auto allowed = [](unsigned char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  };
  const bool digit_first = !arm.empty() && arm.front() >= '0' && arm.front() <= '9';
  if (arm.empty() || arm.size() > 63 || digit_first ||
      !std::all_of(arm.begin(), arm.end(), allowed))
    throw_error("--arm \"{}\": 1 to 63 of A-Z a-z 0-9 _, no digit first", arm);
  if (!options.run.empty()) {
    check_run_name(options.run);
  } else if (options.ros) {
    throw_error("--ros: needs --run, the name of the run on the bus");
  }
}

GatewayBus::GatewayBus(std::uint32_t domain, DdsProfile profile)
    : domain_(domain), profile_(std::move(profile)), deaf_(static_cast<std::uint32_t>(getpid())) {
  make_participant();
}

void GatewayBus::make_participant() {
  participant_ = std::make_unique<dds::Participant>(domain_, profile_.uri, "omentum-gateway");
  discovery_.emplace(*participant_);
  deaf_.joined(steady_now_ns());
}

void GatewayBus::watch(std::int64_t now_ns, std::int64_t late_ns) {
  if (!participant_) return;
  deaf_.watch(now_ns, late_ns, [this] {
    const dds::Discovery::Count count = discovery_->count();
    return Deafness::Around{count.found, count.known, waited_for_core_ns()};
  });
}

bool GatewayBus::is_deaf(std::int64_t heard_ns, bool lacks, std::int64_t now_ns) {
  if (participant_) {
    deaf_.heard(heard_ns);
    if (heard_ns > deaf_.joined_ns() && !lacks) deaf_.helped();
    if (!lacks && !deaf_.is_too_long(heard_ns, now_ns)) return false;
    if (!deaf_.may_join_anew(now_ns)) return false;
  }
  if (now_ns - asked_ns_ < kAskNs) return false;
  asked_ns_ = now_ns;
  return !participant_ || participant_->sees("omentum-learner");
}

Result<void> GatewayBus::join_anew(std::span<BusMember* const> members) {
  log().info("event=rejoin reason=\"a learner is there and is not heard\"");
  deaf_.gives_up();
  const auto leave = [&] {
    for (BusMember* member : members) member->leave();
    discovery_.reset();
    participant_.reset();  // first: the participants of a process share what they know of others
  };
  return on_ordinary_thread([&]() -> Result<void> {
    leave();
    try {
      make_participant();
      for (BusMember* member : members) member->join(*participant_);
    } catch (const Error& error) {
      leave();
      return Failure{error.what()};
    }
    return {};
  });
}

std::unique_ptr<GatewayBus> join_bus(const BusOptions& options, const std::function<bool()>& stop) {
  if (options.run.empty()) return nullptr;
  const std::optional<DdsProfile> profile =
      wait_for_dds_profile(options.dds, DdsRole::kOther, options.domain, 0, 0, stop);
  if (!profile) return nullptr;
  return std::make_unique<GatewayBus>(options.domain, *profile);
}

}  // namespace omentum
