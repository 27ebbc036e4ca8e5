#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/aligned.h"
#include "sim_worker/solid/solid_kernel.h"
#include "sim_worker/solid/solid_lane_effects.h"
#include "sim_worker/solid/solid_model.h"
#include "sim_worker/tissue/implicit_tissue.h"

namespace omentum {

/// A batch of elastic solids, one per SIMD lane (tissue.h has the contract).
template <typename Real>
class SolidTissue final : public ImplicitTissue<Real> {
 public:
  using LaneTissue<Real>::lanes, LaneTissue<Real>::particles, LaneTissue<Real>::position;

  SolidTissue(std::shared_ptr<const SolidTissueModel> model, const LaneKernel<Real>& kernel);

  const SolidTissueModel& model() const override { return *model_; }

  void reset(int lane, const Eigen::Vector3d& offset) override;
  void set_parameters(int lane, const LaneParameters& parameters) override;
  void begin_step(std::span<const ToolMotion> motion) override;
  void begin_substep(std::span<const ToolMotion> motion, int substep) override;
  void solve_substep() override { solve_lanes(~0U); }
  void end_substep(bool last) override;
  void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override;
  void release(int lane) override;
  std::span<const std::int32_t> held(int lane) const override { return held_[lane].nodes; }
  void shift_held(int lane, const Eigen::Vector3d& by) override;
  void stop_clock(int lane, bool stopped) override { effects_.stop_clock(lane, stopped); }
  void set_position(int lane, int particle, const Eigen::Vector3d& p) override;
  void save(int lane, Bytes& out) const override;
  Result<std::size_t> load(int lane, std::span<const std::byte> state) override;

  // For what moves together with other bodies (soft_contact.h).

  /// solve_substep() of the given lanes only, under the present load.
  void solve_lanes(std::uint32_t active);
  /// Forces from outside on every node [N], [node][xyz][lane], until the next call; null = none.
  /// The array must stay.
  void set_load(const Real* load);
  /// Displacement of the nodes under a change of the load [N] by the preconditioner, which is right
  /// to a factor of two; per lane `work` gets force x response and `cross` force x direction [N m].
  /// take_response() makes the direction this response + `beta` times the direction before and
  /// moves the nodes by `step_length` times it in the given lanes; solve_lanes() then puts right
  /// what is left.
  void response(const Real* force, Real* work, Real* cross);
  void take_response(const Real* beta, const Real* step_length, std::uint32_t active);
  /// Force of the body on what its anchor is fixed to at the end of the last step, in W [N].
  Eigen::Vector3d anchor_force(int lane) const;
  /// Gradient of the elastic energy at the present positions, of all nodes [N], and its change with
  /// a displacement of all nodes [m] to first order: what the solver uses. For tests.
  std::vector<Eigen::Vector3d> elastic_gradient(int lane);
  std::vector<Eigen::Vector3d> elastic_change(int lane, std::span<const Eigen::Vector3d> direction);

 private:
  using Base = ImplicitTissue<Real>;
  using Base::b_, Base::body_, Base::candidate_any_, Base::contact_force_, Base::d_,
      Base::free_mask_, Base::gravity_, Base::held_force_, Base::is_free, Base::kernel_,
      Base::slipped_, Base::stiffness_, Base::tip_, Base::v_, Base::x_;
  using typename Base::SavedLane;

  struct Held {
    std::vector<std::int32_t> nodes;
    std::vector<std::array<Real, 3>> offsets;  ///< from the tip, in W
    std::vector<Real> weights;                 ///< covered part of the node's volume, (0, 1]
    std::array<Real, 3>
        deflection{};             ///< of a patch on a spring, from where rigid jaws have it [m]
    std::size_t leader = 0;       ///< of such a patch: number of the node on the spring
    std::array<Real, 3> start{};  ///< scratch: its displacement when the substep began
  };
  /// One number per lane, as the kernel reads it.
  struct alignas(64) PerLane : std::array<Real, 16> {};

  void set_effects(int lane, const EffectValues& effects);
  bool allows(const EffectValues& effects) const override;
  Result<Held> read_grasp(StateReader& state) const;
  void find_contacts(std::span<const ToolMotion> motion);
  void load_model();
  void find_residual(PerLane& size);
  void find_newton_step(PerLane rz, std::uint32_t active);
  void precondition();
  void multiply_hessian();
  void apply_hold(int lane);
  void slip_grasps();
  void place_held();
  void find_held_force();
  template <typename Function>
  void for_each_compliant(Function&& fn);
  void begin_compliant_patches();
  void gather_residual();
  void gather_product();
  void follow_leaders(LaneArray<Real>& vector);
  void end_compliant_patches();

  std::shared_ptr<const SolidTissueModel> model_;
  const SolidKernel<Real>& solid_;
  SolidArgs<Real> args_{};
  LaneFactor<Real> factor_;  ///< of the preconditioner

  // Model in the kernel's precision.
  std::vector<std::int32_t> tetrahedron_;
  AlignedVector<Real> gradient_, volume_, mass_, mass_over_step2_, contact_gain_;

  // State and scratch, per lane.
  LaneArray<Real> step_, z_, p_, hp_, contact_next_, contact_normal_, contact_slide_,
      hold_stiffness_, hold_target_;
  std::vector<std::uint32_t> touches_, contact_mask_;
  std::vector<std::int32_t> contact_node_;
  std::vector<Held> held_;
  std::uint32_t compliant_ = 0;  ///< lanes whose patch hangs on a spring (effect grasp_compliance)
  SolidLaneEffects<Real> effects_;
  PerLane rest_energy_{};         ///< residuals below it are rounding [J]
  double model_rest_energy_ = 0;  ///< the same of the law alone [J]
  PerLane enough_{};  ///< residual at which a substep is solved; negative = not known yet
};

extern template class SolidTissue<float>;
extern template class SolidTissue<double>;

}  // namespace omentum
