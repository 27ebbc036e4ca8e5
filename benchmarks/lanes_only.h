#pragma once

#include "core/backend.h"

namespace omentum {

/// Lanes and a state format; nothing steps it.
class LanesOnly final : public Backend, public Snapshots {
 public:
  LanesOnly(int lanes, int observations, std::uint32_t state_format)
      : lanes_(lanes), observations_(observations), state_format_(state_format) {}
  int lanes() const override { return lanes_; }
  int observation_size() const override { return observations_; }
  Snapshots* snapshots() override { return this; }
  std::uint32_t state_format() const override { return state_format_; }
  void reset(int, const EpisodeStart&) override {}
  Result<void> load(int, std::span<const std::byte>) override { return {}; }
  Bytes save(int) const override { return {}; }
  void observe(int, std::span<float>) const override {}
  void step(std::span<const Action>, std::span<StepOutcome>) override {}
  EpisodeFacts facts(int) const override { return {}; }
  EpisodeFacts clock(int) const override { return {}; }
  bool at_target(int) const override { return false; }
  Action hold_action(int) const override { return {}; }
  bool healthy(int) const override { return true; }
  void positions(int, std::vector<float>&) const override {}
  std::uint32_t ticks_per_step() const override { return 1; }

 private:
  int lanes_, observations_;
  std::uint32_t state_format_;
};

}  // namespace omentum
