#pragma once

// The learner side of the bus without its learning, and workers for it.

#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/clock.h"
#include "learner/bus.h"
#include "tests/learner/fake_worker.h"
#include "tests/support/process.h"

namespace omentum::test {

inline constexpr std::int64_t kMs = 1'000'000;
inline constexpr std::int64_t kS = 1'000 * kMs;

inline TaskBookConfig loop_config(std::uint32_t slots, std::uint32_t lead) {
  TaskBookConfig config;
  config.run_seed = 7;
  config.config_hash = kFakeConfigHash;
  config.slots = slots;
  config.steps = 20;
  config.lead = lead;
  config.episode_decisions = 50;
  config.state_format = kFakeStateFormat;
  config.shape = fake_shape();
  return config;
}

inline std::uint64_t content_hash(const std::vector<RolloutSegment>& batch) {
  std::uint64_t hash = kFnvOffset;
  for (const RolloutSegment& segment : batch) {
    hash = fnv1a64(std::as_bytes(std::span(segment.observations)), hash);
    hash ^= hash_state(segment.end_state);
  }
  return hash;
}

/// A learner that counts instead of learning.
class Loop {
 public:
  Loop(std::uint32_t domain, TaskBookConfig config, std::uint32_t epoch = 1,
       const DdsProfile& profile = loopback_profile())
      : config_(std::move(config)), bus_(options(domain, epoch, profile)) {
    config_.learner_epoch = epoch;
    book = std::make_unique<TaskBook>(config_);
  }

  void start(std::uint64_t version = 0) {
    RunManifest manifest;
    manifest.config_text = "fake";
    manifest.config_hash = config_.config_hash;
    manifest.layout_hash = fake_shape().layout_hash();
    manifest.build_id = kFakeBuild;
    manifest.slots = config_.slots;
    manifest.steps_per_segment = config_.steps;
    manifest.lead = config_.lead;
    manifest.state_format = config_.state_format;
    ASSERT_TRUE(bus_.publish_manifest(manifest));
    publish(version);
  }

  void publish(std::uint64_t version) {
    const PolicyWeights weights = fake_weights(version);
    ASSERT_TRUE(bus_.publish_weights(weights));
    book->announce_weights(version, weights.weights_hash);
  }

  // Serves until done() or the deadline; true when done.
  bool serve_until(const std::function<bool()>& done, std::int64_t timeout_ns = 30 * kS) {
    const std::int64_t end = steady_now_ns() + timeout_ns;
    while (!done()) {
      if (steady_now_ns() > end) return false;
      bus_.serve(*book, steady_now_ns());
      const Result<void> ok = book->check_balance();
      EXPECT_TRUE(ok) << ok.error();
      if (!done()) bus_.wait(20 * kMs);
    }
    return true;
  }

  // Collects `count` batches; returns their content hashes.
  std::vector<std::uint64_t> collect(int count) {
    std::vector<std::uint64_t> hashes;
    for (int i = 0; i < count; ++i) {
      if (!serve_until([this] { return book->batch_complete(); })) {
        ADD_FAILURE() << "batch " << book->batch() << " has " << book->admitted_in_batch() << " of "
                      << config_.slots;
        return hashes;
      }
      hashes.push_back(content_hash(book->take_batch()));
      publish(book->batch());
    }
    return hashes;
  }

  LearnerBus& bus() { return bus_; }
  std::unique_ptr<TaskBook> book;

 private:
  LearnerBusOptions options(std::uint32_t domain, std::uint32_t epoch,
                            const DdsProfile& profile) const {
    LearnerBusOptions options;
    options.run = "loop";
    options.domain = domain;
    options.profile = profile;
    options.learner_epoch = epoch;
    options.slots = config_.slots;
    return options;
  }

  TaskBookConfig config_;
  LearnerBus bus_;
};

/// What the same batches contain without any bus.
inline std::vector<std::uint64_t> expected(TaskBookConfig config, int count) {
  TaskBook book(std::move(config));
  book.worker_joined(1, 1000);
  book.announce_weights(0, fake_weights(0).weights_hash);
  std::vector<std::uint64_t> hashes;
  for (std::int64_t now = 1; static_cast<int>(hashes.size()) < count; ++now) {
    for (const RolloutTask& task : book.grant(now)) book.receive(fake_rollout(task), now);
    if (!book.batch_complete()) continue;
    hashes.push_back(content_hash(book.take_batch()));
    book.announce_weights(hashes.size(), fake_weights(hashes.size()).weights_hash);
  }
  return hashes;
}

inline FakeWorker worker_in(const PrivateDomain& domain, int lanes, std::int64_t group_ms = 0) {
  FakeWorker fake;
  fake.domain = domain.id();
  fake.lanes = lanes;
  fake.group_ms = group_ms;
  return fake;
}

inline Process worker_process(const PrivateDomain& domain, int lanes, int group_ms) {
  return Process({this_executable(), "--worker", std::to_string(domain.id()), "loop",
                  std::to_string(lanes), std::to_string(group_ms)});
}

}  // namespace omentum::test
