#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "core/aligned.h"
#include "sim_worker/shell/shell_jaws.h"
#include "sim_worker/shell/shell_kernel.h"
#include "sim_worker/shell/shell_lane_effects.h"
#include "sim_worker/shell/shell_model.h"
#include "sim_worker/shell/yielding_surface.h"
#include "sim_worker/tissue/grasp_patch.h"
#include "sim_worker/tissue/implicit_tissue.h"

namespace omentum {

/// The elastic shell in lanes; see Tissue. Lanes may differ in every LaneParameters field; lanes
/// whose stiffness needs another factor share a batch and cost one more solve per distinct factor
/// key.
///
/// Grasp: the jaws hold the mean position and slopes of the disc of tissue in them (SheetPatch,
/// docs/tissue.md 8); its radius is such that the sphere of `radius` about the tip goes through
/// its rim. held() are the free nodes inside; they do not collide while held. `collapse` pulls the
/// mean position onto the tip. Jaws that turn, or a pad (Grip), are ShellJaws.
template <typename Real>
class ShellTissue final : public ImplicitTissue<Real> {
 public:
  using LaneTissue<Real>::lanes, LaneTissue<Real>::particles, LaneTissue<Real>::position;

  ShellTissue(std::shared_ptr<const ShellTissueModel> model, const LaneKernel<Real>& kernel);

  const ShellTissueModel& model() const override { return *model_; }

  void reset(int lane, const Eigen::Vector3d& offset) override;
  void set_parameters(int lane, const LaneParameters& parameters) override;
  void begin_step(std::span<const ToolMotion> motion) override;
  void begin_substep(std::span<const ToolMotion> motion, int substep) override;
  void solve_substep() override;
  void end_substep(bool last) override;
  void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override;
  void release(int lane) override;
  std::span<const std::int32_t> held(int lane) const override { return held_[lane].patch.inside; }
  void shift_held(int lane, const Eigen::Vector3d& by) override;
  void stop_clock(int lane, bool stopped) override { effects_.stop_clock(lane, stopped); }
  void save(int lane, Bytes& out) const override;
  Result<std::size_t> load(int lane, std::span<const std::byte> state) override;

  /// From now on the sheet lies on this surface too; it must stay. The model has `on_soft_body`.
  void lie_on(YieldingSurface<Real>& surface);

  /// Gradient of the energy at the present positions, of all nodes [N]: what the solver uses. For
  /// tests; fixed nodes are left out (zero).
  std::vector<Eigen::Vector3d> elastic_gradient(int lane);

 private:
  using Base = ImplicitTissue<Real>;
  using Base::b_, Base::body_, Base::candidate_any_, Base::candidates_, Base::contact_force_,
      Base::d_, Base::free_mask_, Base::gravity_, Base::held_force_, Base::kernel_,
      Base::parameters_, Base::slipped_, Base::stiffness_, Base::tip_, Base::v_, Base::x_;
  using typename Base::SavedLane;
  using Targets = Eigen::Matrix<double, 3, kPatchRows>;

  struct Held {
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< of the disc at rest, p_B [m]
    double radius = 0;                                 ///< of the disc [m]; 0 = nothing is held
    Targets target = Targets::Zero();  ///< of the rows in W [m]; the first is from the tip on
    SheetPatch patch;
    // Of a pad: places of its nodes from its centre, in W [m]; the first target is the way from the
    // tip to the centre.
    Eigen::Matrix3Xd arm;
    std::optional<ShellJaws> jaws;  ///< in the place of the kernel's grasp
  };
  /// One factor in the kernel's precision.
  struct Factor {
    std::shared_ptr<const PanelFactor> shared;
    LaneFactor<Real> lanes;
  };
  struct KeyGroup {
    const Factor* factor = nullptr;
    std::uint32_t lanes = 0;
  };

  void load_mesh();
  void load_stencils();
  const Factor& factor_of(int key);
  void group_lanes();
  void update_key(int lane);
  void slip_grasps();
  void solve_with_springs();
  Eigen::Vector3d point_of_sheet(int lane, const Eigen::Vector2d& X) const;
  /// Place at rest, p_B [m], of the point of the sheet nearest to the tip, and their distance [m].
  std::pair<Eigen::Vector3d, double> nearest_point(int lane, const Eigen::Vector3d& tip) const;
  void grip(int lane, Held held);
  bool allows(const EffectValues& effects) const override;
  Result<Held> read_grasp(StateReader& state) const;
  void make_room(int count);
  void make_patch(int lane);
  ShellJaws make_jaws(int lane) const;
  void hold_jaws(int lane);
  void take_pad(int lane, const Eigen::Vector3d& tip, bool collapse, Held& held) const;
  void clear_patch(int lane);
  void prepare_contacts();
  void set_contact_stiffness(int lane);
  void find_contacts(std::span<const ToolMotion> motion);
  void iterate();
  void solve_for(std::uint32_t active, void (*take)(const ShellArgs<Real>&));
  void hold_for(std::uint32_t active);
  void resolve_contacts();

  std::shared_ptr<const ShellTissueModel> model_;
  const ShellKernel<Real>& shell_;
  YieldingSurface<Real>* surface_ = nullptr;
  ShellArgs<Real> args_{};

  // Model in the kernel's precision.
  AlignedVector<Real> mass_, preconditioner_;
  std::vector<MeshTriangle<Real>> mesh_;
  std::vector<BendStencil<Real>> stencil_;
  std::vector<BendEntry<Real>> bend_entry_;
  std::map<int, Factor> factors_;
  std::vector<int> key_;  ///< per lane
  std::vector<KeyGroup> groups_;

  // State and scratch, per lane.
  LaneArray<Real> keep_b_;
  ShellLaneEffects<Real> effects_;
  std::vector<Held> held_;
  std::uint32_t held_lanes_ = 0;  ///< by the kernel
  std::uint32_t jaw_lanes_ = 0;   ///< by their ShellJaws
  LaneArray<std::int32_t> patch_node_;
  LaneArray<Real> patch_weight_, patch_offset_, patch_inverse_, patch_response_, patch_force_,
      patch_compliance_;

  // Contact.
  std::vector<std::uint32_t> contact_lanes_, near_surface_;
  std::vector<std::int32_t> preconditioner_middle_, plane_begin_, plane_shape_;
  AlignedVector<Real> plane_;
  LaneArray<Real> own_stiffness_, own_compliance_, key_stiffness_, contact_motion_,
      contact_before_sum_, contact_face_, contact_displacement_, contact_before_;
};

extern template class ShellTissue<float>;
extern template class ShellTissue<double>;

}  // namespace omentum
