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
#include "sim_worker/tissue/kernel_shape.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Particles and shape-matching clusters (tissue.md sections 2-5).
struct ClusterTissueModel : TissueModel, std::enable_shared_from_this<ClusterTissueModel> {
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const override;
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return parameters.substeps(); }

  Clusters clusters;  ///< the global cluster, when configured, is the last one
  std::vector<Eigen::Vector3d>
      rest;  ///< r0_B of each membership, relative to the mean of the final members [m]
  std::vector<double> cluster_weight;  ///< stiffness relative to the common one
  std::vector<std::array<int, 2>>
      links;  ///< particle pairs, first < second (each counts twice, as FleX cooks them)
  std::vector<double> link_rest;  ///< [m]
  pb::ClusterModel parameters;
  EffectValues effects;  ///< of the scene; those of kBasicEffects only
  // Skinning of a surface that is not made of particles: 4 clusters per vertex.
  std::vector<std::int32_t> skin_cluster;
  std::vector<double> skin_weight;
  std::vector<Eigen::Vector3d> skin_offset;

  double substep() const { return control_period / parameters.substeps(); }
};

/// Cooks the scene's tissue; throws Error on orphans (policy reject). Notes about ties and loose
/// groups are appended to `warnings`.
std::shared_ptr<const ClusterTissueModel> make_cluster_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>& warnings);

/// The cluster model in lanes; see Tissue.
template <typename Real>
class ClusterTissue : public Tissue<Real> {
 public:
  ClusterTissue(std::shared_ptr<const ClusterTissueModel> model, const LaneKernel<Real>& kernel);

  int lanes() const override { return kernel_.lanes; }
  int particles() const override { return static_cast<int>(model_->body.particles.size()); }
  const LaneKernel<Real>& kernel() const override { return kernel_; }
  const ClusterTissueModel& model() const { return *model_; }

  void reset(int lane, const Eigen::Vector3d& offset) override;
  void set_parameters(int lane, const LaneParameters& parameters) override;
  void step(std::span<const ToolMotion> motion) override;
  void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override;
  void release(int lane) override;
  std::span<const std::int32_t> held(int lane) const override {
    return held_[static_cast<std::size_t>(lane)].particles;
  }
  void shift_held(int lane, const Eigen::Vector3d& by) override;
  Eigen::Vector3d held_force(int lane) const override;
  Eigen::Vector3d position(int lane, int particle) const override;
  Eigen::Vector3d velocity(int lane, int particle) const override;
  void set_position(int lane, int particle, const Eigen::Vector3d& p) override;
  void set_velocity(int lane, int particle, const Eigen::Vector3d& v) override;
  void find_nearest(std::span<const Eigen::Vector3d> points,
                    std::span<Nearest> nearest) const override;
  const Real* surface_positions() override;
  int surface_vertices() const override;
  bool healthy(int lane) const override;
  void save(int lane, Bytes& out) const override;
  Result<std::size_t> load(int lane, std::span<const std::byte> state) override;
  std::uint64_t hash(int lane) const override;

 private:
  struct Held {
    std::vector<std::int32_t> particles;
    std::vector<std::array<Real, 3>> offsets;  ///< from the tip, in W
  };

  Real& at(AlignedVector<Real>& v, int i, int axis, int lane) const {
    return v[static_cast<std::size_t>((3 * i + axis) * kernel_.lanes + lane)];
  }
  void place_held(std::span<const ToolMotion> motion, double share);
  void accumulate_links();
  void find_self_contacts();
  void accumulate_self_contacts();

  std::shared_ptr<const ClusterTissueModel> model_;
  const LaneKernel<Real>& kernel_;
  const ClusterKernel<Real>& clusters_;
  ClusterArgs<Real> args_{};
  CandidateArgs<Real> candidate_args_{};
  KernelShapes<Real> shapes_;

  // Model in the kernel's precision.
  std::vector<Real> rest_, rest_sum_, cluster_weight_, particle_memberships_, particle_weight_,
      particle_scale_, link_rest_;
  std::vector<std::uint8_t> first_of_particle_;

  // State and scratch, per lane.
  AlignedVector<Real> x_, v_, xs_, q_, goal_, pull_, plastic_rest_, extra_;
  std::vector<std::uint32_t> free_mask_, held_mask_, candidates_, candidate_any_;
  std::vector<Held> held_;
  AlignedVector<Real> held_force_, capsule_, capsule_motion_, capsule_sweep_;
  AlignedVector<Real> stiffness_, gravity_, keep_, static_friction_, dynamic_friction_;

  std::vector<std::vector<std::array<std::int32_t, 2>>>
      self_pairs_;  ///< per lane, this substep's candidates

  // Skinned surface.
  AlignedVector<Real> skin_weight_, skin_offset_, surface_;
};

extern template class ClusterTissue<float>;
extern template class ClusterTissue<double>;

}  // namespace omentum
