#include "granting/simulation_book.h"

#include <fmt/format.h>

#include <span>

#include "core/check.h"
#include "core/hash.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;
constexpr std::size_t kRecent = 256;  // results remembered, to tell duplicates from strangers

// A simulation takes seconds to minutes, and the next one may take a hundred times as long: age
// tells little. Workers that die are found by their lease.
constexpr GrantRules kRules = {
    .slots = 1, .ahead = 1, .min_task_age_ns = 60 * kS, .first_task_age_ns = 300 * kS};

}  // namespace

SimulationBook::SimulationBook(std::uint32_t asker_id, std::string asker, std::uint64_t build_id)
    : asker_id_(asker_id), asker_(std::move(asker)), build_id_(build_id), grants_(kRules) {}

std::uint32_t SimulationBook::ask(Bytes task, std::uint32_t steps) {
  OMENTUM_CHECK(!task.empty() && task.size() <= kMaxTaskBytes && steps >= 1);
  const std::uint32_t number = next_task_++;
  Task& wanted = tasks_[number];
  wanted.hash = hash_state(task);
  wanted.bytes = std::move(task);
  wanted.steps = steps;
  grants_.open(number, {.steps = steps});
  return number;
}

void SimulationBook::worker_left(std::uint32_t worker_id) {
  grants_.worker_left(worker_id);
  std::erase_if(assemblies_, [=](const auto& entry) { return entry.first.second == worker_id; });
}

std::vector<SimulationGrant> SimulationBook::grant(std::int64_t now_ns) {
  // When nothing waits any more, idle workers take what the others are late with.
  const auto late = grants_.all_granted() ? std::optional<std::uint64_t>(0) : std::nullopt;
  std::vector<SimulationGrant> grants;
  for (const NewGrant& given : grants_.grant(now_ns, late)) {
    Task& task = tasks_.at(given.task);
    task.holders.push_back(given.worker_id);
    SimulationGrant& grant = grants.emplace_back();
    grant.asker_id = asker_id_;
    grant.task = given.task;
    grant.asker = asker_;
    grant.grant = given.number;
    grant.worker_id = given.worker_id;
    grant.build_id = build_id_;
    grant.task_hash = task.hash;
    grant.steps = task.steps;
    grant.payload = task.bytes;
    grant.granted_at_ns = now_ns;
  }
  return grants;
}

void SimulationBook::refuse(const SimulationPart& part, const std::string& reason,
                            std::int64_t now_ns) {
  assemblies_.erase({part.task, part.worker_id});
  ++grants_.counts().received;
  ++grants_.counts().invalid;
  last_refusal_ = fmt::format("task={} worker={}: {}", part.task, part.worker_id, reason);
  grants_.refuse(part.task, part.worker_id, reason, now_ns);
}

/// Of a result that nobody waits for the last piece counts for all.
void SimulationBook::count_unwanted(const SimulationPart& part) {
  if (part.part + 1 != part.parts || !part.declined.empty()) return;
  ++grants_.counts().received;
  const auto first = recent_.find(part.task);
  if (first == recent_.end() || first->second.first != part.task_hash) {
    ++grants_.counts().stale;
    return;
  }
  ++grants_.counts().duplicate;
  if (first->second.second != part.result_crc32c) ++grants_.counts().audit_mismatch;
}

void SimulationBook::receive(SimulationPart part, std::int64_t now_ns) {
  grants_.worker_answered(part.worker_id);
  const auto wanted = tasks_.find(part.task);
  if (part.asker_id != asker_id_ || wanted == tasks_.end() || wanted->second.hash != part.task_hash)
    return count_unwanted(part);
  if (!part.declined.empty()) {
    grants_.worker_declined(part.worker_id, "declines: " + part.declined, now_ns);
    declined_.emplace_back(part.worker_id, part.declined);
    return;
  }
  const Key key(part.task, part.worker_id);
  if (part.part == 0) {
    // A second grant to the same worker begins anew.
    Assembly fresh;
    fresh.grant = part.grant;
    fresh.first = part;
    fresh.first.payload.clear();
    assemblies_[key] = std::move(fresh);
  }
  const auto found = assemblies_.find(key);
  if (found == assemblies_.end()) return refuse(part, "its beginning is missing", now_ns);
  Assembly& assembly = found->second;
  const SimulationPart& first = assembly.first;
  if (part.part != assembly.next || part.parts != first.parts || part.grant != first.grant ||
      part.result_bytes != first.result_bytes || part.result_crc32c != first.result_crc32c)
    return refuse(part, "its pieces do not fit together", now_ns);
  // Room grows with what has come, not with what was announced.
  assembly.bytes.insert(assembly.bytes.end(), part.payload.begin(), part.payload.end());
  if (++assembly.next < part.parts) return;
  Assembly whole = std::move(assembly);
  assemblies_.erase(found);
  if (whole.bytes.size() != part.result_bytes || crc32c(whole.bytes) != part.result_crc32c)
    return refuse(part, "CRC", now_ns);
  admit(part, std::move(whole), now_ns);
}

void SimulationBook::admit(const SimulationPart& last, Assembly whole, std::int64_t now_ns) {
  ++grants_.counts().received;
  ++admitted_;
  grants_.settle(last.task, last.worker_id, last.grant, now_ns, true);
  recent_[last.task] = {last.task_hash, last.result_crc32c};
  if (recent_.size() > kRecent) recent_.erase(recent_.begin());
  const auto task = tasks_.find(last.task);
  done_.push_back({.task = last.task,
                   .result = std::move(whole.bytes),
                   .compute_time_ns = last.compute_time_ns,
                   .holders = std::move(task->second.holders)});
  tasks_.erase(task);
  std::erase_if(assemblies_, [&](const auto& entry) { return entry.first.first == last.task; });
}

void SimulationBook::foreign(std::uint64_t parts) {
  grants_.counts().received += parts;
  grants_.counts().foreign += parts;
}

void SimulationBook::refused(std::uint64_t parts) {
  grants_.counts().received += parts;
  grants_.counts().invalid += parts;
}

}  // namespace omentum
