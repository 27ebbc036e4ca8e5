#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sim_worker/lanes/lane_args.h"
#include "sim_worker/lanes/lane_array.h"
#include "sim_worker/tissue/kernel_shape.h"
#include "sim_worker/tissue/state_bytes.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// What the tissue models in lanes share: positions and velocities, parameters of the lanes, the
/// tool, the search for contacts, and the bytes of a saved state. One thread at a time.
template <typename Real>
class LaneTissue : public Tissue<Real> {
 public:
  int lanes() const final { return kernel_.lanes; }
  int particles() const final { return static_cast<int>(body_.particles.size()); }
  const LaneKernel<Real>& kernel() const final { return kernel_; }

  Eigen::Vector3d position(int lane, int particle) const final { return x_.vector(particle, lane); }
  Eigen::Vector3d velocity(int lane, int particle) const final { return v_.vector(particle, lane); }
  void set_position(int lane, int particle, const Eigen::Vector3d& p) override;
  void set_velocity(int lane, int particle, const Eigen::Vector3d& v) override;
  void find_nearest(std::span<const Eigen::Vector3d> points,
                    std::span<Nearest> nearest) const final;
  Eigen::Vector3d held_force(int lane) const override;
  double thickness_scale(int lane) const final { return parameters_[lane].thickness_scale; }
  const Real* surface_positions() override { return x_.data(); }
  int surface_vertices() const override { return particles(); }
  bool healthy(int lane) const final;
  std::uint64_t hash(int lane) const final;

 protected:
  /// `model` must outlive the tissue.
  LaneTissue(const TissueModel& model, const LaneKernel<Real>& kernel);

  /// Rest shape moved by `offset` in W [m], velocity zero; every particle that is not fixed is
  /// free.
  void place_at_rest(int lane, const Eigen::Vector3d& offset);
  /// Gravity and friction of a lane under these effects; remembers both for the state.
  void set_surroundings(int lane, const LaneParameters& parameters, const EffectValues& effects);
  /// Effects of a lane as set_surroundings() got them.
  const EffectValues& effects_of(int lane) const { return *parameters_[lane].effects; }

  /// For the kernels; valid as long as the tissue.
  LaneArgs<Real> lane_args();

  /// Start of a control step: particles that a rigid shape may touch in it, of those that
  /// `free_mask` sets free.
  void find_candidates(std::span<const ToolMotion> motion,
                       const std::vector<std::uint32_t>& free_mask);
  /// Tip and capsule at the end of a substep.
  void place_tool(std::span<const ToolMotion> motion, int substep);

  void set_free(int particle, int lane, bool free) { set_bit(free_mask_[particle], lane, free); }
  bool is_free(int particle, int lane) const { return (free_mask_[particle] >> lane & 1U) != 0; }
  bool is_fixed(int particle) const { return body_.fixed[particle] != 0; }
  static void set_bit(std::uint32_t& mask, int lane, bool on) {
    mask = on ? mask | 1U << lane : mask & ~(1U << lane);
  }

  // The saved state of a lane: these arrays, the scales of its parameters, a word of StateParts;
  // then, where they follow, the thickness, effects with the slip of the grasp so far, the grasp,
  // and the memory of the effects. Model by model, what results from these is made again by load().
  struct SavedLane {
    std::vector<Real> numbers;
    LaneParameters parameters;  ///< effects given
    double slipped = 0;         ///< slip of the patch, summed [m]
    bool has_grasp = false;
  };
  virtual std::vector<const LaneArray<Real>*> saved_arrays() const = 0;
  /// Arrays whose numbers are finite in a healthy lane.
  virtual std::vector<const LaneArray<Real>*> watched_arrays() const { return {&x_, &v_}; }
  /// Numbers of those arrays changed: what healthy() found before counts no more.
  void forget_health() { health_known_ = false; }
  /// Whether a saved lane may have these effects in this scene.
  virtual bool allows(const EffectValues& effects) const = 0;
  void save_lane(int lane, bool has_grasp, StateWriter& state) const;
  Result<SavedLane> read_lane(StateReader& state) const;
  /// Takes over the numbers of saved_arrays(), nothing else.
  void load_lane(int lane, const SavedLane& saved);

  const TissueBody& body_;
  const Surroundings& surroundings_;
  const double control_period_;
  const int substeps_;
  const LaneKernel<Real>& kernel_;
  KernelShapes<Real> shapes_;

  LaneArray<Real> x_, v_;                   ///< [m], [m/s]
  std::vector<std::uint32_t> free_mask_;    ///< per particle: lanes in which it moves by itself
  LaneArray<Real> held_force_;              ///< on the tool [xyz][lane] [N]
  std::vector<LaneParameters> parameters_;  ///< per lane, effects given
  std::vector<double> slipped_;             ///< per lane: slip of the patch, summed [m]
  LaneArray<Real> stiffness_;               ///< of the lane over the nominal one
  LaneArray<Real> keep_;     ///< part of the velocity that damping leaves per substep
  LaneArray<Real> gravity_;  ///< [xyz][lane] [m/s^2]
  LaneArray<Real> static_friction_, dynamic_friction_;
  LaneArray<Real> radius_;  ///< collision distance [m]

  LaneArray<Real> tip_;             ///< of the tool at the end of the substep [xyz][lane] [m]
  LaneArray<Real> capsule_;         ///< foot [m] and direction of the shaft's axis [xyz][lane]
  LaneArray<Real> capsule_motion_;  ///< of the foot in a substep [xyz][lane] [m]
  LaneArray<Real> capsule_sweep_;   ///< longest way of a point in the control step [lane] [m]
  mutable bool health_known_ = false;
  mutable std::uint32_t healthy_lanes_ = 0;   ///< if known
  std::vector<std::uint32_t> candidates_;     ///< [particle][shape] lane masks
  std::vector<std::uint32_t> candidate_any_;  ///< per particle, bit per shape
};

extern template class LaneTissue<float>;
extern template class LaneTissue<double>;

}  // namespace omentum
