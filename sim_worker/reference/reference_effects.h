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
/// ground (anchors, adhesion), lubrication by air, drag. A batch is Pack::kLanes bricks.
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
  /// Calls fn(node, energy, gradient, stiffness) for every force on a node at positions x.
  void for_each_force(
      const Nodes& x,
      const std::function<void(int node, double energy, const Eigen::Vector3d& gradient,
                               const Eigen::Matrix3d& stiffness)>& fn) const;
  /// End of an implicit step at x. `shape_of`: the bricks of a batch there.
  void remember(const Nodes& x, const std::function<HexShape(std::size_t batch)>& shape_of);

  /// Memory as numbers of the state, which follow the values themselves.
  void save(std::vector<double>& out) const;
  std::size_t saved_size(const EffectValues& values) const;
  void load(std::span<const double> in);

 private:
  bool bonds(const EffectValues& v) const;
  double bond_stiffness(std::size_t node) const;

  std::shared_ptr<const ReferenceTissueModel> model_;
  EffectValues values_;
  double step_ = 0;
  std::vector<HexEffects> material_;
  std::vector<HexMemory> memory_;
  Nodes bond_place_;                  ///< fixed end of the spring in W [m]
  std::vector<double> bond_longest_;  ///< longest stretch so far [m], -1 = no spring
  Nodes start_;                       ///< positions at the start of the step
  Nodes drag_origin_;
  std::vector<double> drag_;         ///< [N/m] of this step
  std::vector<double> lubrication_;  ///< [N/m] of this step
  Nodes lubrication_normal_;
};

}  // namespace omentum
