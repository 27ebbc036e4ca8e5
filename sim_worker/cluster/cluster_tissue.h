#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/aligned.h"
#include "sim_worker/cluster/cluster_kernel.h"
#include "sim_worker/cluster/cooker.h"
#include "sim_worker/tissue/lane_effects.h"
#include "sim_worker/tissue/lane_tissue.h"

namespace omentum {

/// Particles and shape-matching clusters (docs/tissue.md 2, 3, 4, 5).
struct ClusterTissueModel : TissueModel, std::enable_shared_from_this<ClusterTissueModel> {
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const override;
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return parameters.substeps(); }
  bool can_turn() const override { return true; }

  Clusters clusters;                      ///< the global cluster, when configured, is the last one
  std::vector<Eigen::Vector3d> rest;      ///< r0_B per membership, from the mean of the members [m]
  std::vector<double> cluster_weight;     ///< stiffness relative to the common one
  std::vector<std::array<int, 2>> links;  ///< particle pairs, first < second
  std::vector<double> link_rest;          ///< [m]
  pb::ClusterModel parameters;
  double areal_density = 0;             ///< of the sheet [kg/m^2]
  std::vector<std::uint8_t> is_anchor;  ///< per particle: none hangs on a spring of the clamp
  // Skinning of a surface that is not made of particles: 4 clusters per vertex.
  std::vector<std::int32_t> skin_cluster;
  std::vector<double> skin_weight;
  std::vector<Eigen::Vector3d> skin_offset;
};

/// Model of the scene's tissue; throws Error on orphans (policy reject) and on effects the model
/// lacks. Appends notes about ties and loose groups to `warnings`.
std::shared_ptr<const ClusterTissueModel> make_cluster_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>& warnings);

/// Effects of the lanes of clusters that have a memory: adhesion. See LaneEffects.
template <typename Real>
class ClusterLaneEffects final : public LaneEffects<Real> {
 public:
  ClusterLaneEffects(std::shared_ptr<const ClusterTissueModel> model, int lanes);

  /// For the kernel; valid until the next call of set().
  const LaneEffectArgs<Real>& args() const { return this->common_; }
  void set(int lane, const EffectValues& values) {
    this->set_common(lane, values, model_->substep(), {});
  }
  void reset(int lane) { this->reset_common(lane, Eigen::Vector3d::Zero()); }

 private:
  using typename LaneEffects<Real>::NodePart;
  static std::vector<NodePart> node_parts(const ClusterTissueModel& model);

  std::shared_ptr<const ClusterTissueModel> model_;
};

/// The cluster model in lanes; see Tissue and, for the equations, cluster_kernel.inl.
template <typename Real>
class ClusterTissue final : public LaneTissue<Real> {
 public:
  using LaneTissue<Real>::lanes, LaneTissue<Real>::particles, LaneTissue<Real>::position;

  ClusterTissue(std::shared_ptr<const ClusterTissueModel> model, const LaneKernel<Real>& kernel);

  const ClusterTissueModel& model() const override { return *model_; }

  void reset(int lane, const Eigen::Vector3d& offset) override;
  void set_parameters(int lane, const LaneParameters& parameters) override;
  void begin_step(std::span<const ToolMotion> motion) override;
  void begin_substep(std::span<const ToolMotion> motion, int substep) override;
  void solve_substep() override;
  void end_substep(bool /*last*/) override {}  // the last iteration does it
  void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override;
  void release(int lane) override;
  std::span<const std::int32_t> held(int lane) const override { return held_[lane].particles; }
  void shift_held(int lane, const Eigen::Vector3d& by) override;
  void turn_held(int lane, const Eigen::Matrix3d& R) override;
  Eigen::Vector3d held_force(int lane) const override;
  const Real* surface_positions() override;
  int surface_vertices() const override;
  void save(int lane, Bytes& out) const override;
  Result<std::size_t> load(int lane, std::span<const std::byte> state) override;

 private:
  using Base = LaneTissue<Real>;
  using Base::candidate_any_, Base::capsule_, Base::capsule_motion_, Base::dynamic_friction_,
      Base::free_mask_, Base::gravity_, Base::held_force_, Base::keep_, Base::kernel_,
      Base::shapes_, Base::static_friction_, Base::stiffness_, Base::tip_, Base::v_, Base::x_;
  using typename Base::SavedLane;

  struct Held {
    std::vector<std::int32_t> particles;
    std::vector<std::array<Real, 3>> offsets;  ///< from the tip, in W
  };

  void load_model();
  void order_memberships();
  void list_near();
  std::vector<const LaneArray<Real>*> saved_arrays() const override;
  bool allows(const EffectValues& effects) const override;
  Result<Held> read_grasp(StateReader& state) const;
  void take(int lane, Held held);
  // Pairs of particles that act on each other beside the clusters (cluster_pairs.cpp).
  void find_self_contacts();
  void add_pair_corrections();
  void add_links();
  void add_self_contacts();
  double self_distance(int lane) const;
  template <typename Scale>
  void add_pair(int i, int j, int lane, Real count, Scale&& scale_of);

  std::shared_ptr<const ClusterTissueModel> model_;
  const ClusterKernel<Real>& clusters_;
  ClusterLaneEffects<Real> effects_;
  ClusterArgs<Real> args_{};

  // Model in the kernel's precision.
  std::vector<Real> rest_, rest_sum_, cluster_weight_, particle_memberships_, particle_weight_,
      particle_scale_, link_rest_;
  std::vector<std::int32_t> turn_, turn_begin_, loose_, near_, near_count_;
  bool last_ = false;  ///< substep of the control step

  // State and scratch, per lane.
  LaneArray<Real> xs_, q_, goal_, goal_sum_, plastic_rest_, pair_sum_;
  LaneArray<Real> bond_gain_;  ///< of ClusterArgs
  std::vector<std::uint32_t> held_mask_;
  std::vector<Held> held_;
  std::vector<std::vector<std::array<std::int32_t, 2>>> self_pairs_;  ///< of this substep, per lane

  // Skinned surface.
  AlignedVector<Real> skin_weight_, skin_offset_;
  LaneArray<Real> surface_;
};

extern template class ClusterTissue<float>;
extern template class ClusterTissue<double>;

}  // namespace omentum
