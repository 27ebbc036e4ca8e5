#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>

#include "sim_worker/backend/sim_setup.h"

namespace omentum {

/// Simulated tissue under the jaw of a robot: follows its true tip, is taken when the jaw closes on
/// it and pulls at the arm. What holds and what slips is the grasp of the configuration
/// (docs/grasp.md). One environment; one thread.
class AttachedTissue {
 public:
  /// Lays the tissue. Precondition: `setup` has a scene, a tissue and a grasp that go together.
  explicit AttachedTissue(std::shared_ptr<const SimSetup> setup);

  /// Lays the tissue anew: at rest, out of the jaw, as an operator does between two trials.
  void lay();

  /// One control period: the tip moves in a straight line to `p_WT` [m], the jaw to `jaw_rad`.
  /// The first call after the construction places the tip.
  /// Returns the force on the tool through the grasp, in W [N].
  Eigen::Vector3d step(const Eigen::Vector3d& p_WT, double jaw_rad);

  /// Time that a step() lasts [s].
  double control_period_s() const { return setup_->config.task().control_period_s(); }
  /// How far held tissue lets the jaw close [rad]: it is pressed by a fifth of its thickness. Below
  /// every jaw's range while nothing is held.
  double jaw_stop_rad() const;
  bool holds() const { return !tissue_->held(0).empty(); }
  std::uint64_t pinches() const { return pinches_; }  ///< attempts
  std::uint64_t grasps() const { return grasps_; }
  std::uint64_t losses() const { return losses_; }  ///< slipped out
  Tissue<float>& tissue() { return *tissue_; }

 private:
  void pinch(double jaw_deg);
  void slip();

  std::shared_ptr<const SimSetup> setup_;
  std::unique_ptr<Tissue<float>> tissue_;
  Eigen::Vector3d tip_ = Eigen::Vector3d::Zero();
  bool placed_ = false;
  double jaw_deg_ = 0;
  double slip_ = 0;  ///< of the present grasp [m]
  std::uint64_t pinches_ = 0, grasps_ = 0, losses_ = 0;
};

}  // namespace omentum
