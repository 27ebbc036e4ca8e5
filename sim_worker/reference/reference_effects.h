#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "sim_worker/reference/hexahedron.h"
#include "sim_worker/reference/reference_model.h"

namespace omentum {

/// Effects of one reference tissue with state of their own: memory of the material, springs to
/// ground (anchors, adhesion), lubrication by air, drag, the local force. A batch is Pack::kLanes
/// bricks.
class ReferenceEffects {
 public:
  using Nodes = std::vector<Eigen::Vector3d>;

  explicit ReferenceEffects(std::shared_ptr<const ReferenceTissueModel> model);

  const EffectValues& values() const { return values_; }
  /// Throws Error unless the values fit.
  void set(const EffectValues& values);
  /// Whether they are those of the scene where they are part of the mesh.
  bool fits(const EffectValues& values) const;
  void reset(const Eigen::Vector3d& offset);

  /// Start of an implicit step of length h [s] from x and v; its end velocity is (x - x_tilde) /
  /// beta.
  void begin(double h, const Nodes& x, const Nodes& v, const Nodes& x_tilde, double beta);
  /// Effects in the material of a batch; null where there are none.
  const HexEffects* of_batch(std::size_t batch) const {
    return material_.empty() ? nullptr : &material_[batch];
  }
  /// Present stiffness of a point of the clamp's bed [N/m].
  double bed_stiffness(std::size_t point) const;
  /// Calls fn(node, energy, gradient, stiffness) for every force on a node at positions x; the
  /// stiffness of the bed, which couples nodes, is none of a node's.
  void for_each_force(
      const Nodes& x,
      const std::function<void(int node, double energy, const Eigen::Vector3d& gradient,
                               const Eigen::Matrix3d& stiffness)>& fn) const;
  /// Calls fn(node, stiffness) for every damper: its force is that times x - x_tilde.
  void for_each_damper(const std::function<void(int node, double stiffness)>& fn) const;
  /// What fades with time stays as it is from here on, or goes on fading.
  void stop_clock(bool stopped) { clock_stopped_ = stopped; }
  /// End of an implicit step at x. `shape_of`: the bricks of a batch there.
  void remember(const Nodes& x, const std::function<HexShape(std::size_t batch)>& shape_of);

  /// Memory as numbers of the state, which follow the values themselves.
  void save(std::vector<double>& out) const;
  std::size_t saved_size(const EffectValues& values) const;
  void load(std::span<const double> in);

 private:
  /// A node in the disc of the local force.
  struct Pulled {
    int node = 0;
    double share = 0;
    Eigen::Vector3d place = Eigen::Vector3d::Zero();  ///< where its string is made fast, in W [m]
  };

  bool bonds(const EffectValues& v) const;
  void place_pull();
  double bond_stiffness(std::size_t node) const;
  Eigen::Vector3d bed_stretch(std::size_t point, const Nodes& x) const;

  std::shared_ptr<const ReferenceTissueModel> model_;
  EffectValues values_;
  double step_ = 0;
  std::vector<HexEffects> material_;
  std::vector<HexMemory> memory_;
  Nodes bond_place_;                  ///< fixed end of the spring in W [m]
  std::vector<double> bond_longest_;  ///< longest stretch so far [m], -1 = no spring
  Nodes bed_place_;                   ///< of each point of the bed at rest, in W [m]
  std::vector<double> bed_longest_;   ///< longest stretch so far [m]
  Nodes start_;                       ///< positions at the start of the step
  std::vector<double> sticking_;      ///< per node: share of it that adheres; empty = all of all
  std::vector<Pulled> pulled_;
  double push_left_ = 1, push_now_ = 1;  ///< share of the push, before and at the end of the step
  bool clock_stopped_ = false;
  double beta_ = 1;  ///< of this step, see begin() [s]
  Nodes drag_origin_;
  std::vector<double> drag_;         ///< [N/m] of this step
  std::vector<double> lubrication_;  ///< [N/m] of this step
  Nodes lubrication_normal_;
};

}  // namespace omentum
