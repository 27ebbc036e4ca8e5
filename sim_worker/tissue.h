#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/types.h"
#include "sim_worker/cooker.h"
#include "sim_worker/kernel.h"
#include "sim_worker/scene.h"

namespace omentum {

/// The immutable half of the cluster model: everything lanes share. Made once per scene, safe to
/// share by threads.
struct TissueModel {
  TissueBody body;
  Clusters clusters;  ///< the global cluster, when configured, is the last one
  std::vector<Eigen::Vector3d>
      rest;  ///< r0_B of each membership, relative to the mean of the final members [m]
  std::vector<double> cluster_weight;  ///< stiffness relative to the common one
  std::vector<std::array<int, 2>>
      links;  ///< particle pairs, first < second (each counts twice, as FleX cooks them)
  std::vector<double> link_rest;  ///< [m]
  pb::ClusterModel parameters;
  double control_period = 0.02;  ///< [s]
  double static_friction = 0, dynamic_friction = 0;
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< in W [m/s^2]
  std::vector<RigidShape> contact_bodies;  ///< what particles collide with, the tool apart
  bool tool_contact = false;
  double tool_radius = 0, tool_start = 0,
         tool_length = 0;  ///< capsule along the shaft, behind the tip [m]
  Eigen::Vector3d shaft_axis = Eigen::Vector3d::UnitZ();  ///< from the tip up the shaft, in W
  // Skinning of a surface that is not made of particles: 4 clusters per vertex.
  std::vector<std::int32_t> skin_cluster;
  std::vector<double> skin_weight;
  std::vector<Eigen::Vector3d> skin_offset;

  double substep() const { return control_period / parameters.substeps(); }
};

/// Cooks the scene's tissue; throws Error on orphans (policy reject). Notes about ties and loose
/// groups are appended to `warnings`.
std::shared_ptr<const TissueModel> make_tissue_model(const Scene& scene, double control_period,
                                                     std::vector<std::string>& warnings);

/// What the tool does to one lane during a control step: the tip moves on a straight line, p_WT
/// [m].
struct ToolMotion {
  Eigen::Vector3d from = Eigen::Vector3d::Zero();
  Eigen::Vector3d to = Eigen::Vector3d::Zero();
};

/// Parameters that may differ between lanes (domain randomisation). Factors on the scene's values.
struct LaneParameters {
  double stiffness_scale = 1;
  double gravity_scale = 1;
  double damping_scale = 1;
  double friction_scale = 1;
};

/// A batch of environments of the same tissue, one per SIMD lane. Lane k of a batch equals a batch
/// of one, bit for bit, at every width: tests/physics. Real is float in the product and double as
/// oracle. One thread at a time.
template <typename Real>
class Tissue {
 public:
  Tissue(std::shared_ptr<const TissueModel> model, const Kernel<Real>& kernel);

  int lanes() const { return kernel_.lanes; }
  int particles() const { return static_cast<int>(model_->body.particles.size()); }
  const TissueModel& model() const { return *model_; }

  /// Rest shape moved by `offset` in W [m], velocity zero, nothing held.
  void reset(int lane, const Eigen::Vector3d& offset);
  void set_parameters(int lane, const LaneParameters& parameters);

  /// Advances every lane by one control step (tissue.md section 4). `motion` has lanes() entries.
  void step(std::span<const ToolMotion> motion);

  /// Holds particles at `offset` from the tip until release. Fixed particles cannot be held.
  void hold(int lane, std::span<const int> particles, std::span<const Eigen::Vector3d> offsets);
  void release(int lane);
  std::span<const std::int32_t> held(int lane) const {
    return held_[static_cast<std::size_t>(lane)].particles;
  }
  /// Moves the held patch relative to the tip (slip) [m].
  void shift_held(int lane, const Eigen::Vector3d& by);
  /// Force of the tissue on the tool through the grasp at the end of the last step, in W [N].
  Eigen::Vector3d held_force(int lane) const;

  Eigen::Vector3d position(int lane, int particle) const;
  Eigen::Vector3d velocity(int lane, int particle) const;
  void set_position(int lane, int particle, const Eigen::Vector3d& p);
  void set_velocity(int lane, int particle, const Eigen::Vector3d& v);

  struct Nearest {
    int particle = 0;
    double distance = 0;  ///< [m]
  };
  /// Nearest particle to a point of each lane; ties go to the lower index.
  void find_nearest(std::span<const Eigen::Vector3d> points, std::span<Nearest> nearest) const;

  /// Vertices of the drawn surface in W [m] for all lanes, [vertex][xyz][lane]; valid until the
  /// next call.
  const Real* surface_positions();
  int surface_vertices() const;
  const Kernel<Real>& kernel() const { return kernel_; }

  /// True while every number of the lane is finite.
  bool healthy(int lane) const;

  /// Whole state of a lane, canonical: particle order, independent of lane and width. load()
  /// refuses, changing nothing, bytes of another size or with a non-finite number or an index out
  /// of range.
  void save(int lane, Bytes& out) const;
  Result<std::size_t> load(int lane, std::span<const std::byte> state);
  std::uint64_t hash(int lane) const;

 private:
  struct Held {
    std::vector<std::int32_t> particles;
    std::vector<std::array<Real, 3>> offsets;  ///< from the tip, in W
  };

  Real& at(std::vector<Real>& v, int i, int axis, int lane) const {
    return v[static_cast<std::size_t>((3 * i + axis) * kernel_.lanes + lane)];
  }
  void place_held(std::span<const ToolMotion> motion, double share);
  void accumulate_links();
  void find_self_contacts();
  void accumulate_self_contacts();

  std::shared_ptr<const TissueModel> model_;
  const Kernel<Real>& kernel_;
  KernelArgs<Real> args_{};

  // Model in the kernel's precision.
  std::vector<Real> rest_, rest_sum_, cluster_weight_, particle_rest_, particle_weight_,
      particle_scale_, link_rest_;
  std::vector<std::int32_t> particle_begin_, particle_cluster_, particle_membership_;

  // State and scratch, per lane.
  std::vector<Real> x_, v_, xs_, q_, goal_, plastic_rest_, extra_;
  std::vector<std::uint32_t> free_mask_, held_mask_, candidates_, candidate_any_;
  std::vector<Held> held_;
  std::vector<Real> held_force_, capsule_, capsule_motion_, capsule_sweep_;
  std::vector<Real> stiffness_, gravity_, keep_, static_friction_, dynamic_friction_;

  std::vector<std::vector<std::array<std::int32_t, 2>>>
      self_pairs_;  ///< per lane, this substep's candidates

  // Skinned surface.
  std::vector<Real> skin_weight_, skin_offset_, surface_;
};

extern template class Tissue<float>;
extern template class Tissue<double>;

/// Widest kernel this CPU runs, or the one of the asked width (1, 8, 16; 0 = widest). Throws Error
/// if it cannot.
const Kernel<float>& choose_kernel(unsigned width);

}  // namespace omentum
