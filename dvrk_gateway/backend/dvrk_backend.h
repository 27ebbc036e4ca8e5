#pragma once

#include <string>

#include "dvrk_gateway/backend/arm_guide.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {

/// A robot behind a simulated scene, as the rollout sees it: what all modes share. Segments are
/// tagged kDvrk; a stop of the safety function ends the episode with its reason and keeps the
/// steps.
class DvrkBackend : public Backend {
 public:
  int lanes() const override { return 1; }
  int observation_size() const override { return scene_.observation_size(); }
  void observe(int lane, std::span<float> observation) const override {
    scene_.observe(lane, observation);
  }
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

 protected:
  /// Aborts unless `scene` has one lane; it must outlive this object.
  explicit DvrkBackend(SimBackend& scene);

  /// False, with the reason kept, when the arm was stopped.
  bool went(const Result<void>& result);
  bool stopped() const { return !stop_.empty(); }
  /// The outcome of a step that did not take place.
  static void refuse_step(std::span<StepOutcome> outcomes);

  SimBackend& scene_;
  std::string stop_;  ///< why the arm was stopped in this episode; empty: it was not
};

/// Mode `twin`, as in the paper: the policy acts in the simulated scene and observes it, the robot
/// follows its tool one period behind, and the jaw is closed while the simulated one holds tissue.
/// A rollout is that of the simulation, number for number, as long as nothing stops the arm.
class TwinBackend final : public DvrkBackend {
 public:
  /// `guide` outlives this object.
  TwinBackend(SimBackend& scene, ArmGuide& guide) : DvrkBackend(scene), guide_(guide) {}

  /// Leads the arm to the start; where it was stopped on the way the first step says so.
  void reset(int lane, const EpisodeStart& start) override;
  void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) override;
  Snapshots* snapshots() override { return scene_.snapshots(); }

 private:
  ArmGuide& guide_;
};

/// Mode `measured`: the policy observes where the robot measures its tip. The scene's tool follows
/// that place and supplies what no sensor of the robot gives: grasp, exposure, reward. No state to
/// save: half of it is the robot's.
class MeasuredBackend final : public DvrkBackend {
 public:
  /// `guide` outlives this object; the scene follows the robot from here on.
  MeasuredBackend(SimBackend& scene, ArmGuide& guide);

  void reset(int lane, const EpisodeStart& start) override;
  void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) override;

 private:
  ArmGuide& guide_;
};

/// Mode `teach`: an operator moves the robot, this program sends nothing. The measured motion is
/// put into the actions of the task; the scene's tool follows it.
class TaughtBackend final : public DvrkBackend {
 public:
  /// `asks_begin` and `asks_end` tell once whether the operator asked since the last call; all
  /// outlive this object. The jaw counts as closed below `jaw_closed_below_rad`.
  TaughtBackend(SimBackend& scene, ArmGuide& guide, std::function<bool()> asks_begin,
                std::function<bool()> asks_end, double jaw_closed_below_rad);

  /// Waits until the robot tells valid poses and the operator begins.
  void reset(int lane, const EpisodeStart& start) override;
  void step(std::span<const Action> actions, std::span<StepOutcome> outcomes) override;
  /// Waits for the motion of the next decision; the action nearest to it. For the rollout's script.
  Action next_action();
  /// Largest distance between the measured tip and the sum of the actions in this episode [m].
  double lag_m() const { return lag_m_; }

 private:
  ArmGuide& guide_;
  std::function<bool()> asks_begin_, asks_end_;
  double jaw_closed_below_rad_;
  std::vector<Eigen::Vector3d> tips_;  ///< of the control periods of the next decision, in order
  std::size_t tip_ = 0;
  double lag_m_ = 0;
  bool ended_ = false;
};

}  // namespace omentum
