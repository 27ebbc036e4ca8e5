#pragma once

#include <memory>
#include <span>
#include <vector>

#include "sim_worker/coupled/soft_contact.h"
#include "sim_worker/shell/shell_tissue.h"

// coupled/ joins an elastic sheet and a deformable body under it (docs/decisions/0020): each stage
// of a step is that of both bodies, and the contact between them is found in the contact solver of
// the sheet (soft_contact.h).

namespace omentum {

/// Immutable half of a sheet with a deformable body under it. `body` is the sheet.
struct CoupledTissueModel : TissueModel, std::enable_shared_from_this<CoupledTissueModel> {
  std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const override;
  std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const override;
  std::uint32_t substeps() const override { return sheet->substeps(); }

  std::shared_ptr<const ShellTissueModel> sheet;
  std::shared_ptr<const SolidTissueModel> solid;
};

/// Makes both of the scene. Throws Error as make_shell_model() and make_soft_body_model() do.
std::shared_ptr<const CoupledTissueModel> make_coupled_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>& warnings);

/// An elastic sheet and a deformable body that feel each other, in lanes; see Tissue. Particles are
/// the nodes of the sheet, then those of the body. Stiffness and damping of LaneParameters and the
/// offset of reset() are the sheet's, gravity and friction of both. hold() takes the sheet,
/// hold_body() the body; the jaws then move both, and slip on both.
template <typename Real>
class CoupledTissue final : public Tissue<Real> {
 public:
  CoupledTissue(std::shared_ptr<const CoupledTissueModel> model, const LaneKernel<Real>& kernel);

  const CoupledTissueModel& model() const override { return *model_; }
  ShellTissue<Real>& sheet() { return sheet_; }
  const SoftContact<Real>& contact() const { return contact_; }
  SolidTissue<Real>& solid() { return contact_.solid(); }

  int lanes() const override { return sheet_.lanes(); }
  int particles() const override { return sheet_.particles() + contact_.solid().particles(); }
  const LaneKernel<Real>& kernel() const override { return sheet_.kernel(); }

  void reset(int lane, const Eigen::Vector3d& offset) override;
  void set_parameters(int lane, const LaneParameters& parameters) override;
  void begin_step(std::span<const ToolMotion> motion) override;
  void begin_substep(std::span<const ToolMotion> motion, int substep) override;
  void solve_substep() override;
  void end_substep(bool last) override;
  void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override;
  double distance_to_body(int lane, const Eigen::Vector3d& p) override {
    return contact_.distance(lane, p);
  }
  void hold_body(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override {
    solid().hold(lane, tip, radius, collapse);
  }
  void release(int lane) override;
  /// Valid until the next call for this lane.
  std::span<const std::int32_t> held(int lane) const override;
  void shift_held(int lane, const Eigen::Vector3d& by) override;
  void stop_clock(int lane, bool stopped) override { sheet_.stop_clock(lane, stopped); }
  Eigen::Vector3d held_force(int lane) const override {
    return sheet_.held_force(lane) + contact_.solid().held_force(lane);
  }
  Eigen::Vector3d position(int lane, int particle) const override;
  Eigen::Vector3d velocity(int lane, int particle) const override;
  void set_position(int lane, int particle, const Eigen::Vector3d& p) override;
  void set_velocity(int lane, int particle, const Eigen::Vector3d& v) override;
  /// Of the sheet only: the tissue of the task.
  void find_nearest(std::span<const Eigen::Vector3d> points,
                    std::span<Nearest> nearest) const override {
    sheet_.find_nearest(points, nearest);
  }
  const Real* surface_positions() override;
  int surface_vertices() const override { return particles(); }
  bool healthy(int lane) const override { return sheet_.healthy(lane) && contact_.healthy(lane); }
  void save(int lane, Bytes& out) const override;
  Result<std::size_t> load(int lane, std::span<const std::byte> state) override;
  std::uint64_t hash(int lane) const override;

 private:
  std::shared_ptr<const CoupledTissueModel> model_;
  ShellTissue<Real> sheet_;
  SoftContact<Real> contact_;
  AlignedVector<Real> surface_;
  mutable std::vector<std::vector<std::int32_t>> held_;  ///< per lane: what held() gave
};

extern template class CoupledTissue<float>;
extern template class CoupledTissue<double>;

}  // namespace omentum
