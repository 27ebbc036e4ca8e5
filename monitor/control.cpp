#include "monitor/control.h"

#include <fmt/core.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <random>
#include <thread>

#include "core/clock.h"
#include "core/printable.h"

namespace omentum {
namespace {

constexpr double kRepeatS = 1;
constexpr std::int64_t kLookNs = 50'000'000;  // a signal does not wake the wait set

std::string issuer_name() {
  std::array<char, 256> host{};
  if (gethostname(host.data(), host.size() - 1) != 0) host[0] = '\0';
  return fmt::format("omentum control, {} pid {}", host.data(), getpid());
}

std::uint64_t new_request() {
  std::random_device device;
  return (std::uint64_t{device()} << 32) | device();
}

}  // namespace

Operator::Operator(const dds::Participant& participant, const std::string& run,
                   const std::string& issuer)
    : run_(run),
      issuer_(issuer),
      commands_(participant, public_partitions(run), "operator-commands"),
      replies_(participant, tool_partitions(run), "operator-replies"),
      waitset_(participant) {
  waitset_.attach(replies_.raw());
}

bool Operator::wait_for_reader(double timeout_s) {
  const std::int64_t began = steady_now_ns();
  // Commands and replies are volatile: the reply must find this reader matched as well.
  while (commands_.matched() == 0 || replies_.raw().matched() == 0) {
    if (stop_requested() || seconds_since(began) > timeout_s) return false;
    std::this_thread::sleep_for(std::chrono::nanoseconds(kLookNs));  // there is no event for it
  }
  return true;
}

Result<std::uint64_t> Operator::send(ControlCommand command) {
  command.run_id = run_;
  command.issuer = issuer_;
  if (command.request == 0) command.request = new_request();
  command.sent_at_ns = wall_now_ns();
  if (Result<void> written = commands_.write(command); !written) return Failure{written.error()};
  return command.request;
}

std::optional<ControlReply> Operator::wait_for_reply(std::uint64_t request, double timeout_s) {
  std::optional<ControlReply> reply;
  const std::int64_t began = steady_now_ns();
  while (!reply && !stop_requested() && seconds_since(began) <= timeout_s) {
    waitset_.wait(kLookNs);
    const Result<int> taken = replies_.take(64, [&](Arrival<ControlReply>&& arrival) {
      if (arrival.info.valid && arrival.record.run_id == run_ && arrival.record.request == request)
        reply = std::move(arrival.record);
    });
    if (!taken) break;
  }
  return reply;
}

int run_control(const ControlOptions& options) {
  catch_stop_signals();
  const std::unique_ptr<dds::Participant> participant = join_run(options.tool, "omentum-control");
  if (!participant) return 1;
  Operator from(*participant, options.tool.run, issuer_name());
  const std::int64_t began = steady_now_ns();
  const auto left = [&] { return std::max(0.0, options.timeout_s - seconds_since(began)); };
  if (!from.wait_for_reader(left())) {
    fmt::print(stderr, "no answer: nobody of run {} reads commands on domain {}\n",
               options.tool.run, options.tool.domain);
    return 1;
  }
  ControlCommand command = options.command;
  std::optional<ControlReply> reply;
  do {
    const Result<std::uint64_t> request = from.send(command);
    if (!request) {
      fmt::print(stderr, "not sent: {}\n", request.error());
      return 1;
    }
    command.request = request.value();
    // Again with the same number: whom we see need not see us yet, and would not hear us.
    reply = from.wait_for_reply(command.request, std::min(kRepeatS, left()));
  } while (!reply && left() > 0 && !stop_requested());
  if (!reply) {
    fmt::print(stderr, "no answer within {} s\n", options.timeout_s);
    return 1;
  }
  const std::string who = reply->worker_id == 0
                              ? reply->program
                              : fmt::format("{} {}", reply->program, reply->worker_id);
  fmt::print("{}: {}\n", reply->done ? "done" : "refused",
             printable(fmt::format("{}: {}", who, reply->text)));
  return reply->done ? 0 : 1;
}

}  // namespace omentum
