#include "granting/simulation_asker.h"

#include <fmt/format.h>
#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>

#include "core/check.h"
#include "core/clock.h"
#include "core/hash.h"
#include "core/scheduling.h"

namespace omentum {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kS = 1'000 * kMs;
constexpr std::int64_t kPeriodNs = 50 * kMs;     // ages, matches of new workers
constexpr std::int64_t kMatchNs = 5 * kMs;       // while one is awaited
constexpr std::int64_t kSilentNs = 2 * kS;       // deadline of worker status, docs/wire.md 3
constexpr std::int64_t kRetireNs = 5 * kS;       // a dead worker's reader is gone after the lease
constexpr std::int64_t kAloneNs = 5 * kS;        // without workers before it is told
constexpr std::int64_t kTellNs = 60 * kS;        // told again
constexpr std::int32_t kMostPartsWaiting = 256;  // a fuse: the thread never stops taking
constexpr int kTakenAtOnce = 64;
constexpr std::int64_t kLookNs = 1 * kS;  // whether workers are there
constexpr int kJoinTries = 60;
constexpr auto kJoinAgain = std::chrono::milliseconds(500);

std::string who(const std::string& program) {
  std::array<char, 256> host{};
  if (gethostname(host.data(), host.size() - 1) != 0) host.front() = '\0';
  return fmt::format("{} host={} pid={}", program, host.data(), getpid());
}

std::uint32_t make_asker_id(const std::string& asker) {
  const std::uint64_t hash = fnv1a64(fmt::format("{} {}", asker, wall_now_ns()));
  return std::max(std::uint32_t{1}, static_cast<std::uint32_t>(hash ^ (hash >> 32)));
}

SimulationAskerOptions checked(SimulationAskerOptions options) {
  check_run_name(options.run);
  OMENTUM_CHECK(options.tell != nullptr);
  return options;
}

}  // namespace

SimulationAsker::Link::Link(const SimulationAskerOptions& options, std::uint32_t id)
    : participant(options.domain, options.profile.uri, "omentum-asker"),
      discovery(participant),
      worker_reader(participant, run_partition(options.run), "asker-workers"),
      part_reader(participant, asker_partition(options.run, id), "asker-results",
                  kMostPartsWaiting),
      waitset(participant) {
  waitset.attach(worker_reader.raw());
  waitset.attach(part_reader.raw());
}

SimulationAsker::SimulationAsker(SimulationAskerOptions options)
    : options_(checked(std::move(options))),
      id_(make_asker_id(who(options_.program))),
      link_(std::make_unique<Link>(options_, id_)),
      book_(id_, who(options_.program), options_.build_id),
      deaf_(id_) {
  fine_ns_ = steady_now_ns();
  deaf_.joined(fine_ns_);
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

SimulationAsker::~SimulationAsker() {
  thread_.request_stop();
  wake();
  thread_.join();
  std::unique_lock lock(mutex_);
  answered_.wait(lock, [this] { return asking_ == 0; });
}

// ------------------------------------------------------------------------------------- any thread

Result<Bytes> SimulationAsker::ask(Bytes task, std::uint32_t steps) {
  const auto question = std::make_shared<Question>();
  question->task = std::move(task);
  question->steps = steps;
  std::unique_lock lock(mutex_);
  if (over_) return question->answer;
  ++asking_;
  questions_.push_back(question);
  if (link_) link_->waitset.wake();
  answered_.wait(lock, [&] { return question->answered; });
  --asking_;
  answered_.notify_all();
  return std::move(question->answer);
}

void SimulationAsker::wake() {
  const std::lock_guard lock(mutex_);
  if (link_) link_->waitset.wake();
}

AskerState SimulationAsker::state() const {
  const std::lock_guard lock(mutex_);
  return state_;
}

// ------------------------------------------------------------------------------------- its thread

void SimulationAsker::run(const std::stop_token& stop) {
  pthread_setname_np(pthread_self(), "asker");
  const ShortSlices of_this_thread;
  while (!stop.stop_requested() && link_ && !link_->participant.expired()) {
    const bool matching =
        std::ranges::any_of(served_, [](const auto& entry) { return !entry.second.joined; });
    wait(matching ? kMatchNs : kPeriodNs);
    const std::int64_t now = steady_now_ns();
    take_statuses(now);
    take_parts(now);
    take_questions();
    follow_matches(now);
    write_grants(now);
    publish_state();  // who has an answer finds it counted
    give_answers();
    tell_waiting(now);
    if (is_deaf(now)) join_anew(stop);
  }
  if (link_ && link_->participant.expired())
    options_.tell("the certificate has ended: no worker hears this any more");
  const std::lock_guard lock(mutex_);
  over_ = true;
  for (auto& [task, question] : asked_) questions_.push_back(std::move(question));
  for (const std::shared_ptr<Question>& question : questions_) question->answered = true;
  answered_.notify_all();
}

void SimulationAsker::wait(std::int64_t timeout_ns) {
  const std::int64_t began_ns = steady_now_ns();
  link_->waitset.wait(timeout_ns);
  const std::int64_t now_ns = steady_now_ns();
  deaf_.watch(now_ns, now_ns - began_ns - timeout_ns, [this] {
    const dds::Discovery::Count count = link_->discovery.count();
    return Deafness::Around{count.found, count.known, waited_for_core_ns()};
  });
}

/// Somebody simulates, can be asked, or leaves: then all is well.
bool SimulationAsker::somebody_is_busy_or_free(std::int64_t now_ns) {
  return std::ranges::any_of(served_, [&](const auto& entry) {
    const auto& [id, served] = entry;
    const ListedWorker* worker = workers_.find(id);
    if (worker == nullptr || now_ns - worker->at_ns > kSilentNs) return false;
    if (served.last.phase == WorkerPhase::kDraining) return true;
    return served.joined && (served.last.tasks_in_progress > 0 || book_.grants().live_of(id) == 0);
  });
}

/// Workers are there, and for long enough nothing came of what is asked, and nobody works on it.
bool SimulationAsker::is_deaf(std::int64_t now_ns) {
  if (asked_.empty() || somebody_is_busy_or_free(now_ns)) fine_ns_ = now_ns;
  if (!deaf_.is_too_long(fine_ns_, now_ns) || !deaf_.may_join_anew(now_ns)) return false;
  if (now_ns - looked_ns_ < kLookNs) return false;
  looked_ns_ = now_ns;
  return !link_->participant.expired() && link_->participant.sees("omentum-worker");
}

void SimulationAsker::join_anew(const std::stop_token& stop) {
  options_.tell("workers are there and nothing is heard of them: this joins the domain anew");
  deaf_.gives_up();
  for (const auto& [id, served] : served_) book_.worker_left(id);
  served_.clear();
  retired_.clear();
  workers_ = {};  // whom it knows by identities of the participant that goes
  refused_told_ = 0;
  std::unique_ptr<Link> made;
  {
    const std::lock_guard lock(mutex_);
    made.swap(link_);
  }
  made.reset();  // first: the participants of a process share what they know of others
  for (int tries = 0; !made && tries < kJoinTries && !stop.stop_requested(); ++tries) {
    try {
      made = std::make_unique<Link>(options_, id_);
    } catch (const Error& error) {  // what was free a moment ago will be again
      options_.tell(error.what());
      std::this_thread::sleep_for(kJoinAgain);
    }
  }
  fine_ns_ = steady_now_ns();
  deaf_.joined(fine_ns_);
  const std::lock_guard lock(mutex_);
  link_ = std::move(made);
}

void SimulationAsker::take_statuses(std::int64_t now_ns) {
  const Result<int> taken = link_->worker_reader.take(1024, [&](Arrival<WorkerStatus>&& arrival) {
    workers_.note(std::move(arrival), now_ns);
    deaf_.heard(now_ns);
  });
  if (!taken) options_.tell(taken.error());
  for (const auto& [id, worker] : workers_.take_changed()) follow(id, worker, now_ns);
}

void SimulationAsker::take_parts(std::int64_t now_ns) {
  const Ledger before = book_.ledger();
  // Never stops taking: a full reader would stall every topic of this process (docs/wire.md 5.1).
  const auto take = [&](Arrival<SimulationPart>&& arrival) {
    if (!arrival.info.valid) return;
    if (!workers_.is_process_of(arrival.record.worker_id, arrival.info.participant))
      return book_.foreign(1);
    fine_ns_ = now_ns;
    deaf_.helped();
    book_.receive(std::move(arrival.record), now_ns);
  };
  const Result<int> taken = link_->part_reader.take(kTakenAtOnce, take);
  if (!taken) options_.tell(taken.error());
  if (const std::uint64_t refused = link_->part_reader.refused(); refused > refused_told_) {
    book_.refused(refused - std::exchange(refused_told_, refused));
    options_.tell(fmt::format("a result was refused: {}", link_->part_reader.last_refusal()));
  }
  for (const auto& [id, reason] : book_.take_declined()) {
    const ListedWorker* worker = workers_.find(id);
    options_.tell(fmt::format("worker {} on {} declines: {}", id,
                              worker != nullptr ? worker->status.host : "?", reason));
  }
  const Ledger after = book_.ledger();
  if (after.invalid > before.invalid && !book_.last_refusal().empty())
    options_.tell("a result was refused: " + book_.last_refusal());
  if (after.audit_mismatch > before.audit_mismatch) {
    options_.tell(
        "two workers gave different results for one task: one of them computes wrongly "
        "(docs/trust.md 3)");
  }
}

void SimulationAsker::take_questions() {
  std::deque<std::shared_ptr<Question>> questions;
  {
    const std::lock_guard lock(mutex_);
    questions.swap(questions_);
  }
  for (std::shared_ptr<Question>& question : questions) {
    const std::uint32_t task = book_.ask(std::move(question->task), question->steps);
    asked_.emplace(task, std::move(question));
  }
}

void SimulationAsker::follow(std::uint32_t id, const ListedWorker& worker, std::int64_t now_ns) {
  const auto found = served_.find(id);
  const bool anew = found != served_.end() && found->second.speaks_as != worker.writer;
  if (found != served_.end() && (!worker.alive || anew)) {
    if (worker.crashed || anew)
      options_.tell(fmt::format("worker {} on {} is lost: what it did is given to another", id,
                                found->second.last.host));
    book_.worker_left(id);
    retire(std::move(found->second), now_ns);
    served_.erase(found);
  }
  if (!worker.alive) return;
  if (found == served_.end() || anew) {
    Served served;
    try {
      served.writer = std::make_unique<BusWriter<SimulationGrant>>(
          link_->participant, worker_partition(options_.run, id),
          fmt::format("asker-tasks-w{}", id));
    } catch (const Error& error) {  // with its next status it is tried again
      options_.tell(fmt::format("worker {} is not asked: {}", id, error.what()));
      return;
    }
    served.last = worker.status;
    served.speaks_as = worker.writer;
    served_.emplace(id, std::move(served));
    return;
  }
  Served& served = found->second;
  served.last = worker.status;
  if (served.joined && worker.status.phase == WorkerPhase::kDraining) {
    book_.worker_left(id);
    served.joined = false;
  }
}

/// A worker can be asked when its reader of tasks is found, and while it speaks.
void SimulationAsker::follow_matches(std::int64_t now_ns) {
  for (auto& [id, served] : served_) {
    if (!served.joined && served.last.phase != WorkerPhase::kDraining &&
        served.writer->matched() > 0) {
      served.joined = true;
      book_.grants().worker_joined(id, 1);
    }
    const ListedWorker* worker = workers_.find(id);
    const bool silent = served.joined && worker != nullptr && now_ns - worker->at_ns > kSilentNs;
    if (std::exchange(served.silent, silent) != silent) book_.grants().worker_silent(id, silent);
  }
  std::erase_if(retired_, [now_ns](const auto& entry) {
    return entry.first->matched() == 0 || now_ns > entry.second;
  });
}

void SimulationAsker::retire(Served served, std::int64_t now_ns) {
  // Deleting a writer waits for readers that have not acknowledged; a dead one never will.
  retired_.emplace_back(std::move(served.writer), now_ns + kRetireNs);
}

void SimulationAsker::write_grants(std::int64_t now_ns) {
  for (const SimulationGrant& grant : book_.grant(now_ns)) {
    const auto served = served_.find(grant.worker_id);
    const Result<void> ok = served == served_.end() ? Result<void>(Failure{"worker is unknown"})
                                                    : served->second.writer->write(grant);
    if (ok) continue;
    book_.undelivered(grant);
    options_.tell(fmt::format("a task was not written: {}", ok.error()));
  }
}

void SimulationAsker::give_answers() {
  for (SimulationDone& done : book_.take_done()) {
    // Over for everybody who holds it: whoever still simulates it stops.
    SimulationGrant over;
    over.asker_id = id_;
    over.task = done.task;
    for (const std::uint32_t worker : done.holders) {
      if (const auto served = served_.find(worker); served != served_.end()) {
        BusWriter<SimulationGrant>& writer = *served->second.writer;
        const Result<void> told = writer.dispose(over);
        const Result<void> left = writer.unregister(over);
        if (!told || !left) options_.tell(told ? left.error() : told.error());
      }
    }
    const auto asked = asked_.find(done.task);
    if (asked == asked_.end()) continue;
    const std::lock_guard lock(mutex_);
    ++state_.done;
    state_.steps += asked->second->steps;
    state_.compute_s += 1e-9 * static_cast<double>(done.compute_time_ns);
    asked->second->answer = std::move(done.result);
    asked->second->answered = true;
    asked_.erase(asked);
    answered_.notify_all();
  }
}

/// Without workers it says soon and every minute what to start.
void SimulationAsker::tell_waiting(std::int64_t now_ns) {
  const auto barred = book_.grants().barred(now_ns);
  const auto joined = std::ranges::count_if(
      served_, [](const auto& entry) { return entry.second.joined && !entry.second.silent; });
  if (asked_.empty() || joined > static_cast<std::ptrdiff_t>(barred.size())) {
    alone_since_ns_ = 0;
    return;
  }
  if (alone_since_ns_ == 0) alone_since_ns_ = now_ns;
  if (now_ns - alone_since_ns_ < kAloneNs) return;
  if (alone_told_ns_ > alone_since_ns_ && now_ns - alone_told_ns_ < kTellNs) return;
  alone_told_ns_ = now_ns;
  options_.tell(fmt::format("waiting for workers: start sim_worker --run {} --domain {}{}",
                            options_.run, options_.domain,
                            barred.empty() ? "" : "; of those there are: " + barred[0].reason));
}

void SimulationAsker::publish_state() {
  const auto joined = std::ranges::count_if(
      served_, [](const auto& entry) { return entry.second.joined && !entry.second.silent; });
  const Ledger ledger = book_.ledger();
  const std::lock_guard lock(mutex_);
  state_.workers = static_cast<std::uint32_t>(joined);
  state_.ledger = ledger;
}

}  // namespace omentum
