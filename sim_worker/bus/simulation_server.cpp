#include "sim_worker/bus/simulation_server.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "core/clock.h"
#include "core/hash.h"
#include "core/log.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;
constexpr std::int64_t kKeepResultNs = 30 * kS;  // for an asker, as a segment for a learner
constexpr std::size_t kMostWaiting = 64;
constexpr std::size_t kMostOfAsker =
    8;  // an asker grants two, and those that lapsed may be here yet
constexpr std::size_t kMostAskers = 16;

}  // namespace

std::string SimulationServer::reason_to_decline(const SimulationGrant& grant) const {
  if (!simulate_) return "this worker simulates no recordings";
  if (grant.worker_id != worker_id_) return "it is meant for another worker";
  if (grant.format != kSimulationFormat) {
    return fmt::format("format {} of the task is not this worker's {}", grant.format,
                       kSimulationFormat);
  }
  if (grant.build_id != build_id_) {
    return fmt::format("build {:016x} differs from the asker's {:016x}", build_id_, grant.build_id);
  }
  if (hash_state(grant.payload) != grant.task_hash) return "the task does not match its hash";
  if (waiting_.size() >= kMostWaiting) return "too many tasks wait";
  return {};
}

void SimulationServer::take(Arrival<SimulationGrant>&& arrival, WorkerBus& bus,
                            std::int64_t now_ns) {
  SimulationGrant& grant = arrival.record;
  if (!arrival.info.valid) return withdraw(grant.asker_id, grant.task);
  ++counts_.received;
  if (const std::string reason = reason_to_decline(grant); !reason.empty())
    return decline(grant, reason, bus);
  // Made now, so that it has found its reader when the result is there.
  const auto waiting = std::ranges::count(waiting_, grant.asker_id, &SimulationGrant::asker_id);
  if (waiting >= static_cast<std::ptrdiff_t>(kMostOfAsker) ||
      writer_to(grant.asker_id, bus) == nullptr) {
    ++counts_.abandoned;  // a flood of one, or too many who ask
    return;
  }
  if (told_.insert(grant.asker_id).second)
    log().info("event=simulates_for asker={} {}", grant.asker_id, grant.asker);
  const auto same = std::ranges::find_if(waiting_, [&](const SimulationGrant& other) {
    return other.asker_id == grant.asker_id && other.task == grant.task;
  });
  if (same != waiting_.end()) {
    ++counts_.abandoned;  // an earlier grant of the same task
    waiting_.erase(same);
  }
  grant.granted_at_ns = now_ns;
  waiting_.push_back(std::move(grant));
}

void SimulationServer::withdraw(std::uint32_t asker_id, std::uint32_t task) {
  counts_.abandoned += std::erase_if(waiting_, [=](const SimulationGrant& grant) {
    return grant.asker_id == asker_id && grant.task == task;
  });
  counts_.abandoned += std::erase_if(outbox_, [=](const Outgoing& out) {
    return out.head.declined.empty() && out.head.asker_id == asker_id && out.head.task == task;
  });
  if (running_ && running_->grant.asker_id == asker_id && running_->grant.task == task)
    running_->wanted = false;
}

SimulationPart SimulationServer::answer_to(const SimulationGrant& grant) const {
  SimulationPart part;
  part.asker_id = grant.asker_id;
  part.task = grant.task;
  part.grant = grant.grant;
  part.worker_id = worker_id_;
  part.task_hash = grant.task_hash;
  return part;
}

/// The learner of the run hears nothing of it: a stranger's tasks must not bar a worker there.
void SimulationServer::decline(const SimulationGrant& grant, const std::string& reason,
                               WorkerBus& bus) {
  ++counts_.abandoned;
  if (declines_ >= kMostWaiting || writer_to(grant.asker_id, bus) == nullptr) return;  // a flood
  log().info("event=simulation_declined asker={} reason=\"{}\"", grant.asker_id, reason);
  ++declines_;
  Outgoing& out = outbox_.emplace_back();
  out.head = answer_to(grant);
  out.head.declined = reason;
  out.at_ns = steady_now_ns();
}

void SimulationServer::decline_all(const std::string& reason, WorkerBus& bus) {
  for (const SimulationGrant& grant : waiting_) decline(grant, reason, bus);
  waiting_.clear();
}

bool SimulationServer::is_found(std::uint32_t asker_id) const {
  const auto writer = writers_.find(asker_id);
  return writer != writers_.end() && writer->second->matched() > 0;
}

bool SimulationServer::can_begin() const {
  const auto found = [this](std::uint32_t asker_id) { return is_found(asker_id); };
  return std::ranges::any_of(waiting_, found, &SimulationGrant::asker_id) &&
         std::ranges::none_of(outbox_, [this](const Outgoing& out) {
           return out.head.declined.empty() && is_found(out.head.asker_id);
         });
}

void SimulationServer::run_next(const std::function<bool()>& stop) {
  const auto next = std::ranges::find_if(
      waiting_, [this](const SimulationGrant& grant) { return is_found(grant.asker_id); });
  if (next == waiting_.end()) return;
  running_ = Running{std::move(*next), true};
  waiting_.erase(next);
  bool stopped = false;
  const double begin = thread_seconds();
  Bytes result = simulate_(running_->grant.payload, [&] {
    stopped = stopped || stop() || !running_->wanted;
    return stopped;
  });
  const double took = thread_seconds() - begin;
  const bool wanted = running_->wanted;
  SimulationGrant grant = std::move(running_->grant);
  running_.reset();
  if (!wanted) {
    ++counts_.abandoned;
    return;
  }
  if (stopped) {
    waiting_.push_front(std::move(grant));
    return;
  }
  counts_.steps += grant.steps;
  Outgoing out;
  out.head = answer_to(grant);
  out.head.parts = static_cast<std::uint32_t>(count_parts(result.size()));
  out.head.result_bytes = result.size();
  out.head.result_crc32c = crc32c(result);
  out.head.compute_time_ns = static_cast<std::int64_t>(1e9 * took);
  out.result = std::move(result);
  out.at_ns = steady_now_ns();
  outbox_.push_back(std::move(out));
}

void SimulationServer::flush(WorkerBus& bus, std::int64_t now_ns) {
  counts_.abandoned += std::erase_if(waiting_, [&](const SimulationGrant& grant) {
    return now_ns - grant.granted_at_ns > kKeepResultNs && !is_found(grant.asker_id);
  });
  std::erase_if(outbox_, [&](Outgoing& out) {
    const bool done = send(out, bus, now_ns);
    if (done && !out.head.declined.empty()) --declines_;
    return done;
  });
}

/// True when it is done with: sent, or given up.
bool SimulationServer::send(Outgoing& out, WorkerBus& bus, std::int64_t now_ns) {
  BusWriter<SimulationPart>* writer = writer_to(out.head.asker_id, bus);
  if (writer == nullptr || writer->matched() == 0) {
    // A volatile writer without readers drops silently: keep the result for a while.
    if (now_ns - out.at_ns <= kKeepResultNs) return false;
    counts_.abandoned += out.head.declined.empty() ? 1 : 0;
    return true;
  }
  // No part is left to send of what was declined: it was counted.
  if (!out.head.declined.empty()) return writer->write(out.head) || !writer->timed_out();
  for (; out.head.part < out.head.parts; ++out.head.part) {
    const auto begin =
        out.result.begin() + static_cast<std::ptrdiff_t>(std::size_t{out.head.part} * kPartBytes);
    const std::uint64_t size = size_of_part(out.head.result_bytes, out.head.part);
    out.head.payload.assign(begin, begin + static_cast<std::ptrdiff_t>(size));
    const Result<void> written = writer->write(out.head);
    if (written) continue;
    if (writer->timed_out()) {
      ++counts_.timeouts;  // nothing was stored: the same part again, after a look at stop
      return false;
    }
    log().warn("event=result_not_sent reason=\"{}\"", written.error());
    ++counts_.abandoned;
    return true;
  }
  ++counts_.published;
  return true;
}

BusWriter<SimulationPart>* SimulationServer::writer_to(std::uint32_t asker_id, WorkerBus& bus) {
  const auto found = writers_.find(asker_id);
  if (found != writers_.end()) return found->second.get();
  if (writers_.size() >= kMostAskers) {
    // Of those that are gone and for whom nothing is done any more.
    std::erase_if(writers_, [&](const auto& entry) {
      const auto is_its = [&](std::uint32_t id) { return id == entry.first; };
      return entry.second->matched() == 0 &&
             std::ranges::none_of(waiting_, is_its, &SimulationGrant::asker_id) &&
             std::ranges::none_of(outbox_,
                                  [&](const Outgoing& out) { return is_its(out.head.asker_id); });
    });
    std::erase_if(told_, [&](std::uint32_t id) { return !writers_.contains(id); });
  }
  if (writers_.size() >= kMostAskers) return nullptr;
  try {
    return writers_.emplace(asker_id, bus.make_result_writer(asker_id)).first->second.get();
  } catch (const Error& error) {  // a role that may not, a certificate that has ended
    log().warn("event=no_result_writer reason=\"{}\"", error.what());
    return nullptr;
  }
}

}  // namespace omentum
