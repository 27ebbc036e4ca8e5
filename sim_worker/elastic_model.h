#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/elastic_kernel.h"
#include "sim_worker/tissue.h"

namespace omentum {

/// Off-diagonal entries of a symmetric matrix over nodes whose rows sum to zero, by rows,
/// ascending.
struct NodeMatrix {
  std::vector<std::int32_t> begin;  ///< nodes + 1
  std::vector<std::int32_t> node;
  std::vector<double> value;
};

/// Cholesky factor of A = M/h^2 + membrane metric + bending on the free nodes, shared by all lanes
/// of one factor key (tissue.md section 7).
struct ElasticFactor {
  std::vector<FactorPanel> panels;
  std::vector<std::int32_t> panel_node;
  std::vector<double> panel_value;

  /// Replaces every row of b (any x nodes) by A^-1 of it; fixed nodes are left alone.
  void solve(Eigen::MatrixXd& b) const;
};

/// Immutable half of the elastic shell: corotated triangles on the grid sheet with alternating
/// diagonals, finite-difference plate bending, material in SI units that does not depend on the
/// step (tissue.md section 6). Safe to share by threads.
struct ElasticTissueModel : TissueModel, std::enable_shared_from_this<ElasticTissueModel> {
  std::unique_ptr<Tissue<float>> make_tissue(const Kernel<float>& kernel) const override;
  std::unique_ptr<Tissue<double>> make_tissue(const Kernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return parameters.substeps(); }

  pb::Material material;
  pb::ElasticModel parameters;
  int count_x = 0, count_y = 0;  ///< nodes; index = count_y ix + iy
  double pitch = 0;              ///< [m]
  std::vector<double> mass;      ///< per node: rho t A / 3 of each of its triangles [kg]
  NodeMatrix bending;            ///< gradient of the bending energy [N/m], nominal E
  /// A without its mass, at nominal E [N/m]: entries as those of `bending`, and the diagonal; zero
  /// at fixed nodes.
  std::vector<double> metric, metric_diagonal;
  double shear = 0;  ///< 2 mu t a_T / pitch^2 [N/m], nominal E
  double area = 0;   ///< lambda t a_T / pitch^2 [N/m], nominal E, plane stress
  /// Spring of a node that the jaw covers half [N/m]; infinite: all or nothing.
  double grasp_stiffness = 0;
  double static_friction = 0, dynamic_friction = 0;
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< in W [m/s^2]
  std::vector<RigidShape> contact_bodies;             ///< what nodes collide with, the tool apart
  bool tool_contact = false;
  double tool_radius = 0, tool_start = 0,
         tool_length = 0;  ///< capsule along the shaft, behind the tip [m]
  Eigen::Vector3d shaft_axis = Eigen::Vector3d::UnitZ();  ///< from the tip up the shaft, in W

  int nodes() const { return count_x * count_y; }
  double substep() const { return control_period / parameters.substeps(); }
  /// Step of the implicit equation: h, or 2 h / 3 for BDF2 [s].
  double effective_step() const;
  bool has_contact() const { return !contact_bodies.empty() || tool_contact; }

  /// Factor key of a lane: the number of the smallest step of a geometric grid of moduli that is
  /// not below E. It depends on the lane's own parameters only (tissue.md section 8).
  static int factor_key(double stiffness_scale);
  /// E of a key's factor / nominal E.
  static double key_stiffness(int key);
  /// Factor of a key; made once, then shared.
  std::shared_ptr<const ElasticFactor> factor(int key) const;

 private:
  mutable std::mutex mutex_;
  mutable std::map<int, std::shared_ptr<const ElasticFactor>> factors_;  // guarded by mutex_
};

/// Makes the shell of the scene's grid sheet. Throws Error for a volume, or another law than
/// corotated.
std::shared_ptr<const ElasticTissueModel> make_elastic_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>& warnings);

/// exp(-x) for x >= 0 by our own series: the same bits on every machine, unlike libm's.
double decay(double x);

/// Elastic energy of node positions p [m] at nominal stiffness [J]: membrane and bending apart. For
/// tests of the forces.
struct ElasticEnergy {
  double membrane = 0, bending = 0;
};
ElasticEnergy elastic_energy(const ElasticTissueModel& model, std::span<const Eigen::Vector3d> p);

}  // namespace omentum
