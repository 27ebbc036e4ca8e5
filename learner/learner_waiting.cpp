// What the learner does while no worker serves it.
#include <fmt/format.h>

#include "core/build_id.h"
#include "core/clock.h"
#include "core/log.h"
#include "learner/learner.h"

namespace omentum {
namespace {

// Workers that refuse are waited for this long: another may not have reported yet [ns].
constexpr std::int64_t kRefusalNs = 3'000'000'000;
// What waits is told of at this interval [s].
constexpr double kTellS = 60;
// Workers that were started together with the learner join within this time [s].
constexpr double kJoinS = 2;

}  // namespace

// Without workers the learner says at once and every minute what to start, and what the workers
// that are there have refused.
void Learner::tell_while_alone() {
  if (bus_->workers_ready() > 0) {
    alone_since_ns_ = 0;
    return;
  }
  const std::int64_t now = steady_now_ns();
  const bool first = alone_since_ns_ == 0;
  if (first) alone_since_ns_ = now;
  if (options_.max_wait_s > 0 && seconds_since(alone_since_ns_) > options_.max_wait_s) {
    log().error("no worker for {:.0f} s (--max-wait)", options_.max_wait_s);
    waited_too_long_ = true;
    return;
  }
  // Workers that are about to join need a moment.
  if (seconds_since(alone_since_ns_) < kJoinS) return;
  if (alone_told_ns_ > alone_since_ns_ && seconds_since(alone_told_ns_) < kTellS) return;
  alone_told_ns_ = now;
  std::string refusals;
  int starting = 0;
  for (const WorkerStatus& worker : bus_->worker_statuses()) {
    starting += worker.phase == WorkerPhase::kStarting && worker.warnings.empty() ? 1 : 0;
    if (!worker.warnings.empty())
      refusals += fmt::format("; worker of {} refuses: {}", worker.host, worker.warnings.back());
  }
  if (starting > 0 && refusals.empty()) {
    log().info("waiting for {} worker(s) that make their scene", starting);
    return;
  }
  log().warn("waiting for workers: start sim_worker --run {} --domain {}{}", config_.run().name(),
             config_.run().domain(), refusals);
}

// The scene is resolved by the workers. When this session has no result yet and every worker of
// this build reports that it cannot run the configuration, the run ends with their reason.
std::optional<std::string> Learner::refused_by_workers() {
  std::optional<std::string> reason;
  bool able = book_->ledger().received > 0 || bus_->workers_ready() > 0;
  if (!able) {
    for (const WorkerStatus& worker : bus_->worker_statuses()) {
      if (worker.build_id != build_id()) continue;
      const bool refuses = worker.learner_epoch == epoch_ && worker.lanes == 0 &&
                           worker.phase == WorkerPhase::kStarting && !worker.warnings.empty();
      able = able || !refuses;
      if (refuses) reason = worker.warnings.back();
    }
  }
  if (able || !reason) {
    refused_since_ns_ = 0;
    return std::nullopt;
  }
  const std::int64_t now = steady_now_ns();
  if (refused_since_ns_ == 0) refused_since_ns_ = now;
  if (now - refused_since_ns_ < kRefusalNs) return std::nullopt;
  return reason;
}

}  // namespace omentum
