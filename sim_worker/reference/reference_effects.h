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

/// Effects of one reference tissue that need more than a number: memory of the material, springs to
/// ground (anchors, adhesion), air film, drag. Bricks are handled four at a time, as in
/// ReferenceTissue.
class ReferenceEffects {
 public:
  using Nodes = std::vector<Eigen::Vector3d>;

  explicit ReferenceEffects(std::shared_ptr<const ReferenceTissueModel> model);

  const EffectValues& values() const { return values_; }
  /// Throws Error where the values do not fit: they differ from the scene's in what is part of the
  /// mesh.
  void set(const EffectValues& values);
  bool fits(const EffectValues& values) const;
  void reset(const Eigen::Vector3d& offset);

  /// Start of an implicit step of length h, from x and v; in it velocity is (x - x_tilde) / beta.
  void begin(double h, const Nodes& x, const Nodes& v, const Nodes& x_tilde, double beta);
  /// Of the material of a batch; null where there is none.
  const HexEffects* of_batch(std::size_t batch) const {
    return material_.empty() ? nullptr : &material_[batch];
  }
  /// Calls fn(node, energy, gradient, stiffness) for every force on a node at positions x.
  void for_each_force(
      const Nodes& x,
      const std::function<void(int node, double energy, const Eigen::Vector3d& gradient,
                               const Eigen::Matrix3d& stiffness)>& fn) const;
  /// End of an implicit step that converged. `shape_of` gives the bricks of a batch.
  void remember(const Nodes& x, const std::function<HexShape(std::size_t batch)>& shape_of);

  /// Numbers that go into the state after the values themselves.
  void save(std::vector<double>& out) const;
  std::size_t saved_size(const EffectValues& values) const;
  void load(std::span<const double> in);

 private:
  bool remembers(const EffectValues& v) const;
  bool bonds(const EffectValues& v) const;
  double bond_stiffness(std::size_t node) const;

  std::shared_ptr<const ReferenceTissueModel> model_;
  EffectValues values_;
  double step_ = 0;
  std::vector<HexEffects> material_;
  std::vector<HexMemory> memory_;
  Nodes bond_place_;                  ///< [m]
  std::vector<double> bond_longest_;  ///< [m], -1 = no spring
  Nodes start_;                       ///< positions at the start of the step
  Nodes drag_origin_;
  std::vector<double> drag_;  ///< [N/m] of this step
  std::vector<double> film_;  ///< [N/m] of this step
  Nodes film_normal_;
};

}  // namespace omentum
