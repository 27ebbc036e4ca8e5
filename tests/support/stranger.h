#pragma once

#include <atomic>
#include <map>
#include <memory>
#include <string>
#include <thread>

#include "core/hash.h"
#include "core/policy.h"
#include "core/segment_fields.h"
#include "core/simulation_records.h"
#include "core/wire.h"
#include "tests/support/domain.h"

namespace omentum::test {

/// A participant that copies what it sees and sends it with other content.
class Stranger {
 public:
  Stranger(std::uint32_t domain, std::string run)
      : run_(std::move(run)), participant_(domain, loopback_profile().uri, "stranger") {
    thread_ = std::jthread([this](const std::stop_token& stop) { forge(stop); });
  }
  int sent() const { return sent_; }

 private:
  void forge(const std::stop_token& stop) {
    BusReader<RolloutSegment> segments(participant_, run_partition(run_), "s1");
    BusReader<PolicyWeights> weights(participant_, run_partition(run_), "s2");
    BusReader<WorkerStatus> workers(participant_, run_partition(run_), "s3");
    BusReader<RunManifest> manifests(participant_, run_partition(run_), "s4");
    BusWriter<RolloutSegment> forged_segments(participant_, run_partition(run_), "f1");
    BusWriter<PolicyWeights> forged_weights(participant_, run_partition(run_), "f2");
    BusWriter<RunManifest> forged_manifest(participant_, run_partition(run_), "f3");
    std::map<std::uint32_t, std::unique_ptr<BusWriter<RolloutTask>>> tasks;
    BusReader<SimulationGrant> grants(participant_, {run_ + "/*"}, "s5");
    std::map<std::uint32_t, std::unique_ptr<BusWriter<SimulationGrant>>> simulations;
    std::map<std::uint32_t, std::unique_ptr<BusWriter<SimulationPart>>> results;
    std::uint64_t build = 0;
    std::uint32_t epoch = 1;
    while (!stop.stop_requested()) {
      (void)workers.take(100, [&](Arrival<WorkerStatus>&& arrival) {
        const std::uint32_t id = arrival.record.worker_id;
        if (arrival.info.valid && !tasks.contains(id)) {
          tasks[id] = std::make_unique<BusWriter<RolloutTask>>(participant_,
                                                               worker_partition(run_, id), "f4");
          simulations[id] = std::make_unique<BusWriter<SimulationGrant>>(
              participant_, worker_partition(run_, id), "f5");
          build = arrival.record.build_id;
        }
      });
      (void)manifests.take(10, [&](Arrival<RunManifest>&& arrival) {
        if (arrival.record.config_text.empty()) return;
        epoch = arrival.record.learner_epoch;
        arrival.record.learner_epoch = epoch + 1000;
        if (forged_manifest.write(arrival.record)) ++sent_;
      });
      (void)segments.take(100, [&](Arrival<RolloutSegment>&& arrival) {
        if (!arrival.info.valid) return;
        for (float& reward : arrival.record.rewards) reward = 1;
        arrival.record.payload_crc32c = segment_crc(arrival.record);
        if (forged_segments.write(arrival.record)) ++sent_;
      });
      (void)weights.take(100, [&](Arrival<PolicyWeights>&& arrival) {
        if (!arrival.info.valid || arrival.record.learner_epoch != epoch) return;
        PolicyWeights forged = arrival.record;
        for (float& parameter : forged.parameters) parameter += 0.25F;
        forged.weights_hash = hash_weights(forged.parameters, forged.obs_mean, forged.obs_inv_std);
        if (forged_weights.write(forged)) ++sent_;  // valid, other weights
        forged.learner_epoch += 1000;
        forged.weights_hash[0] = static_cast<std::uint8_t>(~forged.weights_hash[0]);
        if (forged_weights.write(forged)) ++sent_;  // high epoch, wrong hash
      });
      for (auto& [id, writer] : tasks) {
        RolloutTask task;
        task.worker_id = id;
        task.slot = static_cast<std::uint32_t>(sent_ % 6);
        task.learner_epoch = epoch;
        task.steps = 32;
        task.config_hash = 1;
        task.reset = true;
        if (writer->write(task)) ++sent_;
      }
      for (auto& [id, writer] : simulations) {
        SimulationGrant grant;
        grant.asker_id = kAskerId;
        grant.task = static_cast<std::uint32_t>(sent_);
        grant.worker_id = id;
        grant.build_id = build;
        grant.steps = 1;
        grant.payload.assign(100, std::byte{7});  // no task, and rightly told to be it
        grant.task_hash = hash_state(grant.payload);
        if (writer->write(grant)) ++sent_;
      }
      (void)grants.take(100, [&](Arrival<SimulationGrant>&& arrival) {
        const SimulationGrant& grant = arrival.record;
        if (!arrival.info.valid || grant.asker_id == kAskerId) return;
        auto& writer = results[grant.asker_id];
        if (!writer) {
          writer = std::make_unique<BusWriter<SimulationPart>>(
              participant_, asker_partition(run_, grant.asker_id), "f6");
        }
        SimulationPart part;  // the whole result
        part.asker_id = grant.asker_id;
        part.task = grant.task;
        part.grant = grant.grant;
        part.worker_id = grant.worker_id;
        part.task_hash = grant.task_hash;
        part.parts = 1;
        part.payload.assign(64, std::byte{9});
        part.result_bytes = part.payload.size();
        part.result_crc32c = crc32c(part.payload);
        for (int k = 0; k < 100 && writer->matched() == 0; ++k)
          std::this_thread::sleep_for(std::chrono::milliseconds(1));
        if (writer->write(part)) ++sent_;
      });
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }

  static constexpr std::uint32_t kAskerId = 4;

  std::string run_;
  dds::Participant participant_;
  std::atomic<int> sent_{0};
  std::jthread thread_;
};

}  // namespace omentum::test
