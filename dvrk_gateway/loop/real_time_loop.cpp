#include "dvrk_gateway/loop/real_time_loop.h"

#include <fmt/core.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <future>
#include <utility>

namespace omentum {
namespace {

constexpr int kPriority = 80;  // above threaded interrupts (50), below the kernel's own (99)
constexpr std::int64_t kLateNs = 5'000'000;

/// 0, or the error number.
int raise_this_thread(int priority) {
  sched_param wanted{};
  wanted.sched_priority = priority;
  return pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);
}

}  // namespace

bool raise_deciding_thread() { return raise_this_thread(kPriority - 1) == 0; }

RealTimeLoop::RealTimeLoop(ControlLoop& loop, Clock& clock, const OperatorEvents& events)
    : loop_(loop), clock_(clock), events_(events), watched_(kWatched) {}

RealTimeLoop::~RealTimeLoop() { stop(); }

std::vector<std::string> RealTimeLoop::start() {
  std::vector<std::string> warnings;
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
    warnings.push_back(
        fmt::format("memory is not locked ({}): a period may wait for the disk; raise `ulimit -l`",
                    std::strerror(errno)));  // NOLINT(concurrency-mt-unsafe): one thread so far
  }
  // The thread raises itself before its first period, which on a busy machine would begin late.
  std::promise<int> raised;
  std::future<int> outcome = raised.get_future();
  thread_ = std::thread([this, raised = std::move(raised)]() mutable {
    raised.set_value(raise_this_thread(kPriority));
    run();
  });
  if (const int code = outcome.get(); code != 0) {
    warnings.push_back(
        fmt::format("SCHED_FIFO was refused ({}): periods begin late on a busy "
                    "machine; run as root or raise `ulimit -r` to {}",
                    std::strerror(code), kPriority));  // NOLINT(concurrency-mt-unsafe)
  }
  return warnings;
}

void RealTimeLoop::stop() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
}

void RealTimeLoop::run() {
  pthread_setname_np(pthread_self(), "control-loop");
  const std::int64_t period_ns = loop_.setup().period_ns;
  std::int64_t next_ns = clock_.now_ns() + period_ns;
  const auto events = [this] { return events_.now(); };
  while (!stop_) {
    if (sleep_looking(loop_, clock_, next_ns, events)) {
      // Also where the look itself came late, as on a machine that stood still.
      const std::int64_t late_ns = std::max<std::int64_t>(0, loop_.period().began_ns - next_ns);
      if (late_ns > 0) count_begin(late_ns);
      times_.missed += static_cast<std::uint64_t>(late_ns / period_ns);
      leave_to_watcher(loop_.period(), late_ns);
      next_ns = loop_.period().began_ns + period_ns;
      continue;
    }
    const Period& period = loop_.receive();
    const std::int64_t late_ns = period.began_ns - next_ns;
    count_begin(late_ns);
    began_.next() = {period, requests_.value().number};
    began_.publish();
    begun_.post();
    PolicyRequest request;
    if (wait_for_request(period)) request = requests_.value().request;
    loop_.send(request, events());

    if (period.sent_ns != 0) {
      times_.latency.add(period.sent_ns - period.began_ns);
      times_.state_age.add(period.sent_ns - period.state_ns);
    }
    leave_to_watcher(period, late_ns);
    next_ns += period_ns;
    for (const std::int64_t now = clock_.now_ns(); next_ns < now; next_ns += period_ns)
      ++times_.missed;
  }
  ended_ = true;
  begun_.post();
}

void RealTimeLoop::count_begin(std::int64_t late_ns) noexcept {
  ++times_.periods;
  times_.jitter.add(late_ns);
  if (late_ns > kLateNs) ++times_.late;
}

/// Whether a request came that had not been taken; of several the newest.
bool RealTimeLoop::wait_for_request(const Period& period) noexcept {
  const SafetyMemory& memory = period.judgement.memory;
  // Only an armed arm waits to be led; a hold leaves at once.
  if (memory.phase != SafetyPhase::kActive) {
    requested_.drain();  // before looking: a request that came in between would be lost
    return requests_.refresh();
  }
  const bool last = !memory.holding && memory.missed + 1 >= loop_.setup().limits.missed_actions();
  const double share = last ? kLastRequestShare : kRequestShare;
  const std::int64_t until_ns =
      period.began_ns +
      static_cast<std::int64_t>(share * static_cast<double>(loop_.setup().period_ns));
  while (!requests_.refresh()) {
    if (loop_.is_alarmed(events_.now())) return false;
    const std::int64_t now_ns = clock_.now_ns();
    if (now_ns >= until_ns) return requests_.refresh();
    requested_.wait_until(std::min(until_ns, now_ns + kLookInterval_ns));
  }
  return true;
}

const Period& RealTimeLoop::exchange(const PolicyRequest& request) {
  requests_.next() = {request, ++asked_};
  requests_.publish();
  requested_.post();
  while (began_.value().taken < asked_ && !ended_) {
    begun_.wait();
    began_.refresh();
  }
  return began_.value().period;
}

void RealTimeLoop::leave_to_watcher(const Period& period, std::int64_t late_ns) noexcept {
  const std::uint64_t written = written_.load(std::memory_order_relaxed);
  if (written - read_.load(std::memory_order_acquire) >= kWatched) {
    ++times_.unwatched;
    return;
  }
  Period& watched = watched_[written % kWatched];
  watched = period;
  watched.late_ns = late_ns;
  watched.late = times_.late;
  watched.missed = times_.missed;
  watched.unwatched = times_.unwatched;
  written_.store(written + 1, std::memory_order_release);
}

bool RealTimeLoop::watch(Period& period) {
  const std::uint64_t read = read_.load(std::memory_order_relaxed);
  if (read == written_.load(std::memory_order_acquire)) return false;
  period = watched_[read % kWatched];
  read_.store(read + 1, std::memory_order_release);
  return true;
}

}  // namespace omentum
