#pragma once

#include <string>

#include "dvrk_gateway/backend/arm_guide.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {

/// Mode `twin`, as in the paper: the policy acts in the simulated scene and observes it; the robot
/// follows its tool one period behind, and the simulated command of the jaw moves the real one. A
/// rollout is that of the simulation, number for number, as long as nothing stops the arm.
class TwinBackend final : public Backend {
 public:
  /// One lane. Both must outlive it.
  TwinBackend(SimBackend& scene, ArmGuide& guide);

  int lanes() const override { return 1; }
  int observation_size() const override { return scene_.observation_size(); }
  /// Leads the arm to the start; where it was stopped on the way the first step says so.
  void reset(int lane, const EpisodeStart& start) override;
  void observe(int lane, std::span<float> observation) const override {
    scene_.observe(lane, observation);
  }
  void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) override;
  EpisodeFacts facts(int lane) const override { return scene_.facts(lane); }
  EpisodeFacts clock(int lane) const override { return scene_.clock(lane); }
  bool at_target(int lane) const override { return scene_.at_target(lane); }
  Action hold_action(int lane) const override { return scene_.hold_action(lane); }
  bool healthy(int lane) const override { return scene_.healthy(lane); }
  std::string failure(int lane) const override {
    return stop_.empty() ? scene_.failure(lane) : stop_;
  }
  std::uint32_t ticks_per_step() const override { return scene_.ticks_per_step(); }
  Source source() const override { return Source::kDvrk; }
  Snapshots* snapshots() override { return scene_.snapshots(); }

 private:
  SimBackend& scene_;
  ArmGuide& guide_;
  std::string stop_;  ///< why the arm was stopped in this episode; empty: it was not
};

}  // namespace omentum
