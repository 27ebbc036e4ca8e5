#pragma once

// The smallest back ends: a point on a line that is rewarded for coming near zero. Tutorial,
// template for further back ends, and stand-in where a test is about the loop and not about tissue.
// DummyBackend cannot save its state, like a robot; DummySimulation can.

#include <cmath>
#include <cstring>
#include <vector>

#include "core/backend.h"
#include "core/hash.h"
#include "core/rng.h"

namespace omentum::test {

class DummyBackend : public Backend {
 public:
  static constexpr std::uint32_t kEpisodeLimit = 50;

  explicit DummyBackend(int lanes) : lanes_(static_cast<std::size_t>(lanes)) {
    for (int lane = 0; lane < lanes; ++lane) reset(lane, {});
  }

  int lanes() const override { return static_cast<int>(lanes_.size()); }
  int observation_size() const override { return 12; }

  void reset(int lane, const EpisodeStart& start) override {
    State s{};
    const PhiloxWords words =
        random_words(start.run_seed, start.slot, Purpose::kReset, 0, start.episode, 0);
    s.x = uniform_24(words[0]) * 2 - 1;
    s.start = s.x;
    s.episode = start.episode;
    s.limit = start.episode_limit != 0 ? start.episode_limit : kEpisodeLimit;
    lanes_[static_cast<std::size_t>(lane)] = s;
  }

  void observe(int lane, std::span<float> observation) const override {
    std::fill(observation.begin(), observation.end(), 0.0F);
    observation[0] = lanes_[static_cast<std::size_t>(lane)].x;
    observation[1] = 1;
  }

  void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) override {
    for (std::size_t k = 0; k < lanes_.size(); ++k) {
      State& s = lanes_[k];
      outcomes[k] = {};
      outcomes[k].reward = -std::fabs(s.x);
      s.total += static_cast<double>(outcomes[k].reward);
      s.x += 0.1F * (static_cast<float>(actions[k].branch[0]) - 1.0F);
      ++s.step;
      outcomes[k].truncated = s.step >= s.limit;
    }
  }

  EpisodeFacts facts(int lane) const override { return clock(lane); }
  EpisodeFacts clock(int lane) const override {
    const State& s = lanes_[static_cast<std::size_t>(lane)];
    EpisodeFacts facts;
    facts.episode = s.episode;
    facts.episode_step = s.step;
    facts.episode_limit = s.limit;
    facts.episode_return = s.total;
    facts.start_position[0] = static_cast<double>(s.start);
    return facts;
  }
  bool at_target(int lane) const override {
    return std::fabs(lanes_[static_cast<std::size_t>(lane)].x) < 0.1F;
  }
  Action hold_action(int lane) const override {
    Action action;
    const float x = lanes_[static_cast<std::size_t>(lane)].x;
    action.branch = {static_cast<std::uint8_t>(x > 0.05F ? 0 : x < -0.05F ? 2 : 1), 1, 1, 1};
    return action;
  }
  bool healthy(int lane) const override {
    return std::isfinite(lanes_[static_cast<std::size_t>(lane)].x);
  }
  std::uint32_t ticks_per_step() const override { return 1; }

 protected:
  struct State {
    float x;
    float start;
    std::uint32_t step;
    std::uint32_t limit;
    std::uint64_t episode;
    double total;
  };
  std::vector<State> lanes_;
};

class DummySimulation : public DummyBackend, public Snapshots {
 public:
  using DummyBackend::DummyBackend;

  Snapshots* snapshots() override { return this; }
  std::uint32_t state_format() const override { return kSimStateFormat; }

  Bytes save(int lane) const override {
    Bytes bytes(sizeof(State));
    std::memcpy(bytes.data(), &lanes_[static_cast<std::size_t>(lane)], sizeof(State));
    return bytes;
  }

  Result<void> load(int lane, std::span<const std::byte> state) override {
    State s{};
    if (state.size() != sizeof s) return Failure{"wrong size"};
    std::memcpy(&s, state.data(), sizeof s);
    if (!std::isfinite(s.x) || s.limit == 0) return Failure{"not a state"};
    lanes_[static_cast<std::size_t>(lane)] = s;
    return {};
  }

  void positions(int lane, std::vector<float>& out) const override {
    out = {lanes_[static_cast<std::size_t>(lane)].x, 0, 0};
  }
};

}  // namespace omentum::test
