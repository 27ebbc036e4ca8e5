#pragma once

#include <vector>

#include "proto/scene.pb.h"
#include "sim_worker/lanes/lane_args.h"
#include "sim_worker/tissue/lane_tissue.h"

namespace omentum {

/// What shell and solid share: implicit steps by backward Euler or BDF2 (lanes/implicit_step.inl)
/// and forces of contact on their nodes. One thread at a time.
template <typename Real>
class ImplicitTissue : public LaneTissue<Real> {
 public:
  using LaneTissue<Real>::lanes, LaneTissue<Real>::particles;

  void set_velocity(int lane, int particle, const Eigen::Vector3d& v) final;

  /// Force of the surroundings on a node at the end of the last step, in W [N].
  Eigen::Vector3d contact_force(int lane, int node) const {
    return contact_force_.vector(node, lane);
  }
  /// Positions at the start of the substep and displacements since, [node][xyz][lane] [m].
  const LaneArray<Real>& substep_positions() const { return this->x_; }
  const LaneArray<Real>& substep_displacements() const { return d_; }

 protected:
  using LaneTissue<Real>::v_, LaneTissue<Real>::x_;

  /// `model` must outlive the tissue; effective_step is h, or 2 h / 3 for BDF2 [s].
  ImplicitTissue(const TissueModel& model, const LaneKernel<Real>& kernel, double effective_step,
                 pb::Integrator integrator);

  ImplicitArgs<Real> implicit_args();
  /// Damping and stiffness of a lane; damping is that of the material [1/s].
  void set_material(int lane, const LaneParameters& parameters, double damping);
  std::vector<const LaneArray<Real>*> watched_arrays() const final;
  std::vector<const LaneArray<Real>*> saved_arrays() const final;

  LaneArray<Real> v_old_, d_old_, d_, moved_, b_, contact_force_;  ///< see ImplicitArgs

 private:
  const double effective_step_;
  const bool second_order_;
};

extern template class ImplicitTissue<float>;
extern template class ImplicitTissue<double>;

}  // namespace omentum
