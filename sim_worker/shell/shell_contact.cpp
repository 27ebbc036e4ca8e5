// Contact of the elastic shell: the host's part. The method is in shell_contact.inl.
#include <algorithm>

#include "core/check.h"
#include "sim_worker/shell/shell_tissue.h"

namespace omentum {
namespace {

// Of each substep, which starts from the forces of the last. More of either costs time and does not
// converge sooner (measured in docs/decisions/0012).
constexpr int kPasses = 2;
constexpr int kSweeps = 4;
// On a deformable surface, which the sweeps take for rigid: with too few passes the forces
// oscillate from substep to substep (docs/decisions/0020). Settled lanes stop before.
constexpr int kPassesOnSurface = 4;
constexpr int kSweepsOnSurface = 3;

// A contact is settled when its force changes by less than a twentieth of the node's weight [N/kg].
// A bound in metres would depend on the stiffness: 0.15 um are ten times the weight at 300 kPa.
constexpr double kContactTolerance = 0.5;

}  // namespace

template <typename Real>
void ShellTissue<Real>::prepare_contacts() {
  const int W = lanes();
  const int n = particles();
  contact_lanes_.assign(free_mask_.size(), 0);
  plane_begin_.assign(free_mask_.size() + 1, 0);
  for (const double v : model_->preconditioner) preconditioner_.push_back(static_cast<Real>(v));
  args_.plane_begin = plane_begin_.data();
  const NodeMatrix& rows = model_->structure.bending;
  for (int i = 0; i < n; ++i) {
    const auto after = std::upper_bound(rows.node.begin() + rows.begin[i],
                                        rows.node.begin() + rows.begin[i + 1], i);
    preconditioner_middle_.push_back(static_cast<std::int32_t>(after - rows.node.begin()));
  }
  args_.preconditioner_begin = rows.begin.data();
  args_.preconditioner_middle = preconditioner_middle_.data();
  args_.preconditioner_node = rows.node.data();
  args_.preconditioner = preconditioner_.data();
  args_.key_stiffness = key_stiffness_.assign(1, 1, W, Real{1});
  args_.own_stiffness = own_stiffness_.assign(n, 1, W);
  args_.own_compliance = own_compliance_.assign(n, 1, W);
  args_.contact_lanes = contact_lanes_.data();
  args_.contact_motion = contact_motion_.assign(n, 3, W);
  args_.contact_before_sum = contact_before_sum_.assign(n, 3, W);
  args_.contact_face = contact_face_.assign(n, 3, W);
  args_.contact_displacement = contact_displacement_.assign(n, 3, W);
  args_.contact_before = contact_before_.assign(n, 3, W);
  args_.contact_tolerance = static_cast<Real>(kContactTolerance);
}

template <typename Real>
void ShellTissue<Real>::lie_on(YieldingSurface<Real>& surface) {
  OMENTUM_CHECK(args_.has_contact && args_.shapes < kMaxShapes, "{} shapes", args_.shapes);
  surface_ = &surface;
  args_.surface = surface.args();
  near_surface_.assign(free_mask_.size(), 0);
}

template <typename Real>
void ShellTissue<Real>::set_contact_stiffness(int lane) {
  const int key = key_[lane];
  const double stiffness = ShellTissueModel::key_stiffness(key);
  const double step = model_->effective_step();
  key_stiffness_[lane] = static_cast<Real>(stiffness);
  const double density = model_->key_density(key);
  for (int i = 0; i < particles(); ++i) {
    const double own = model_->mass_at(i, density) / (step * step) +
                       stiffness * model_->preconditioner_diagonal[i];
    own_stiffness_(i, lane) = static_cast<Real>(own);
    own_compliance_(i, lane) = static_cast<Real>(1 / own);
  }
}

// Candidates of the whole step, once; forces of nodes that cannot touch any more are dropped.
template <typename Real>
void ShellTissue<Real>::find_contacts(std::span<const ToolMotion> motion) {
  this->find_candidates(motion, free_mask_);
  if (surface_ != nullptr) {
    surface_->find_near(x_, v_, free_mask_, near_surface_);
    for (std::size_t i = 0; i < near_surface_.size(); ++i) {
      candidates_[i * kMaxShapes + static_cast<std::size_t>(args_.shapes)] = near_surface_[i];
      if (near_surface_[i] != 0) candidate_any_[i] |= 1U << args_.shapes;
    }
  }
  shell_.drop_far_contacts(args_);
  plane_shape_.clear();
  for (std::size_t i = 0; i < candidate_any_.size(); ++i) {
    for (int k = 0; k < args_.shapes + (surface_ != nullptr ? 1 : 0); ++k) {
      if ((candidate_any_[i] >> k & 1U) != 0) plane_shape_.push_back(k);
    }
    plane_begin_[i + 1] = static_cast<std::int32_t>(plane_shape_.size());
  }
  const std::size_t values = 4 * plane_shape_.size() * static_cast<std::size_t>(lanes());
  if (plane_.size() < values) plane_.resize(values);
  args_.plane_shape = plane_shape_.data();
  args_.plane = plane_.data();
}

// A lane takes part until it is settled and then stays as it is, to the last bit.
template <typename Real>
void ShellTissue<Real>::resolve_contacts() {
  std::uint32_t unsettled = ~0U;
  const int passes = surface_ != nullptr ? kPassesOnSurface : kPasses;
  const int sweeps = surface_ != nullptr ? kSweepsOnSurface : kSweeps;
  const auto take = surface_ != nullptr ? shell_.take_surface_change : shell_.take_contact_change;
  for (int pass = 0; pass < passes; ++pass) {
    if (surface_ != nullptr) surface_->place(x_, d_, unsettled);
    args_.lanes = unsettled;
    shell_.place_contacts(args_);
    args_.surface.follows = pass > 0;
    unsettled = shell_.unsettled_contacts(args_);
    if (unsettled == 0) return;
    args_.lanes = unsettled;
    for (int sweep = 0; sweep < sweeps && args_.lanes != 0; ++sweep) {
      args_.lanes = shell_.sweep_contacts(args_, sweep);
    }
    shell_.load_contact_change(args_);
    if (surface_ != nullptr) surface_->response(unsettled);
    if (effects_.has_springs()) {
      solve_with_springs();
      args_.lanes = unsettled;
      take(args_);
    } else {
      solve_for(unsettled, take);
    }
    if (surface_ != nullptr) surface_->take(unsettled);
    hold_for(unsettled);
  }
}

#define OMENTUM_INSTANTIATE(Real)                                              \
  template void ShellTissue<Real>::prepare_contacts();                         \
  template void ShellTissue<Real>::lie_on(YieldingSurface<Real>&);             \
  template void ShellTissue<Real>::set_contact_stiffness(int);                 \
  template void ShellTissue<Real>::find_contacts(std::span<const ToolMotion>); \
  template void ShellTissue<Real>::resolve_contacts()
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
