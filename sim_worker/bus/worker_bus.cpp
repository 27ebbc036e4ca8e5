#include "sim_worker/bus/worker_bus.h"

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "core/hash.h"
#include "core/log.h"
#include "core/policy.h"
#include "core/scheduling.h"

namespace omentum {
namespace {

constexpr std::int64_t kReceiveNs = 500'000'000;  // stop flag, if a wake got lost
// Samples that a reader keeps beside those of a stranger who writes to the same instances.
constexpr std::int32_t kWeightsDepth = 64;
constexpr std::int32_t kTaskDepth = 8;
constexpr std::int32_t kCommandDepth = 64;
// Beyond these only a flood keeps a topic from being taken out in time.
constexpr std::size_t kMostWeights = 64;
constexpr std::size_t kMostOthers = 4096;
constexpr std::size_t kMostSimulations = 64;
constexpr std::ptrdiff_t kMostOfAsker =
    8;  // it grants two at a time; a flood pushes out no other's

template <typename Record>
void keep(std::vector<Arrival<Record>>& kept, Arrival<Record>&& arrival, std::size_t most,
          std::uint64_t& dropped) {
  if (kept.size() >= most) {
    kept.erase(kept.begin());
    ++dropped;
  }
  kept.push_back(std::move(arrival));
}

/// Takes what has arrived.
template <typename Record, typename Fn>
bool take_all(BusReader<Record>& reader, Fn&& fn) {
  constexpr int kLimit = 4096;
  const Result<int> taken = reader.take(kLimit, fn);
  if (!taken) log().error("event=take_failed reason=\"{}\"", taken.error());
  return taken && taken.value() > 0;
}

}  // namespace

WorkerBus::WorkerBus(const WorkerBusOptions& options)
    : run_(options.run),
      uri_(options.profile.uri),
      policy_id_(static_cast<std::uint32_t>(fnv1a64(options.run))),
      on_weights_(options.on_weights),
      participant_(options.domain, uri_, "omentum-worker"),
      discovery_(participant_),
      learner_reader_(participant_, run_partition(run_), "worker-learner"),
      manifest_reader_(participant_, run_partition(run_), "worker-manifest"),
      weights_reader_(participant_, run_partition(run_), "worker-weights", kWeightsDepth),
      task_reader_(participant_, worker_partition(run_, options.worker_id), "worker-tasks",
                   kTaskDepth),
      command_reader_(participant_, run_partition(run_), "worker-commands", kCommandDepth),
      segment_writer_(participant_, public_partitions(run_), "worker-segments"),
      status_writer_(participant_, public_partitions(run_), "worker-status"),
      reply_writer_(participant_, public_partitions(run_), "worker-replies"),
      frame_writer_(participant_, public_partitions(run_), "worker-frames"),
      waitset_(participant_) {
  waitset_.attach(learner_reader_.raw());
  waitset_.attach(manifest_reader_.raw());
  waitset_.attach(weights_reader_.raw());
  waitset_.attach(task_reader_.raw());
  waitset_.attach(command_reader_.raw());
  try {
    simulation_reader_.emplace(participant_, worker_partition(run_, options.worker_id),
                               "worker-simulations");
    waitset_.attach(simulation_reader_->raw());
  } catch (const Error& error) {
    // Certificates older than these tasks: rollouts need none of it.
    log().warn("event=no_simulations reason=\"{}\"", error.what());
  }
  receive_ = std::jthread([this](const std::stop_token& stop) { receive(stop); });
}

WorkerBus::~WorkerBus() {
  receive_.request_stop();
  waitset_.wake();
  receive_.join();
}

void WorkerBus::receive(const std::stop_token& stop) {
  pthread_setname_np(pthread_self(), "bus-receive");
  const ShortSlices of_this_thread;
  const auto put = [this](auto member, auto&& arrival, std::size_t most) {
    const std::lock_guard lock(mutex_);
    keep(inbox_.*member, std::move(arrival), most, inbox_.dropped);
  };
  while (!stop.stop_requested()) {
    waitset_.wait(kReceiveNs);
    // Manifests first: what follows them belongs to them.
    bool any = take_all(manifest_reader_, [&](Arrival<RunManifest>&& arrival) {
      if (arrival.record.run_id == run_)
        put(&WorkerInbox::manifests, std::move(arrival), kMostOthers);
    });
    any |= take_all(learner_reader_, [&](Arrival<LearnerStatus>&& arrival) {
      if (arrival.record.run_id == run_)
        put(&WorkerInbox::learners, std::move(arrival), kMostOthers);
    });
    any |= take_all(weights_reader_, [&](Arrival<PolicyWeights>&& arrival) {
      const PolicyWeights& weights = arrival.record;
      if (!arrival.info.valid || weights.policy_id != policy_id_) return;
      if (hash_weights(weights.parameters, weights.obs_mean, weights.obs_inv_std) !=
          weights.weights_hash) {
        const std::lock_guard lock(mutex_);
        ++inbox_.wrong_weights;
      } else {
        if (on_weights_) on_weights_(weights);
        put(&WorkerInbox::weights, std::move(arrival), kMostWeights);
      }
    });
    any |= take_all(task_reader_, [&](Arrival<RolloutTask>&& arrival) {
      if (arrival.info.valid) put(&WorkerInbox::tasks, std::move(arrival), kMostOthers);
    });
    any |= take_all(command_reader_, [&](Arrival<ControlCommand>&& arrival) {
      if (arrival.info.valid && arrival.record.run_id == run_)
        put(&WorkerInbox::commands, std::move(arrival), kMostOthers);
    });
    if (simulation_reader_) {
      any |= take_all(*simulation_reader_, [&](Arrival<SimulationGrant>&& arrival) {
        keep_simulation(std::move(arrival));
      });
    }
    if (!any) continue;
    arrived_.store(true, std::memory_order_release);
    // Under the mutex, or a wait() that is about to sleep would miss it.
    { const std::lock_guard lock(mutex_); }
    something_.notify_one();
  }
}

void WorkerBus::keep_simulation(Arrival<SimulationGrant>&& arrival) {
  const std::lock_guard lock(mutex_);
  const auto of_asker = std::ranges::count_if(inbox_.simulations, [&](const auto& other) {
    return other.record.asker_id == arrival.record.asker_id;
  });
  if (arrival.info.valid && of_asker >= kMostOfAsker) {
    ++inbox_.dropped;
    return;
  }
  keep(inbox_.simulations, std::move(arrival), kMostSimulations, inbox_.dropped);
}

std::unique_ptr<BusWriter<SimulationPart>> WorkerBus::make_result_writer(
    std::uint32_t asker_id) const {
  return std::make_unique<BusWriter<SimulationPart>>(participant_, asker_partition(run_, asker_id),
                                                     "worker-results");
}

void WorkerBus::wait(std::int64_t timeout_ns) {
  std::unique_lock lock(mutex_);
  something_.wait_for(lock, std::chrono::nanoseconds(timeout_ns),
                      [this] { return has_arrivals(); });
}

WorkerInbox WorkerBus::take() {
  const std::lock_guard lock(mutex_);
  arrived_.store(false, std::memory_order_release);
  return std::exchange(inbox_, {});
}

}  // namespace omentum
