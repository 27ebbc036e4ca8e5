#pragma once

#include <cstdint>
#include <span>

#include "sim_worker/lanes/lane_array.h"
#include "sim_worker/shell/shell_kernel.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// A deformable body as the elastic sheet meets it: a deformable surface (docs/decisions/0020).
/// The forces between the two are found in the sheet's contact solver; who steps both calls the
/// stages of both (CoupledTissue). All arrays are [node of the sheet][xyz][lane] in W.
template <typename Real>
class YieldingSurface {
 public:
  YieldingSurface() = default;
  YieldingSurface(const YieldingSurface&) = delete;
  YieldingSurface& operator=(const YieldingSurface&) = delete;
  virtual ~YieldingSurface() = default;

  virtual const SurfaceArgs<Real>& args() const = 0;
  /// The body, which the jaws may hold beside the sheet.
  virtual Tissue<Real>& body() = 0;
  /// By how much the force on the jaws falls when the body slips out of them, about [N/m].
  virtual double held_stiffness() const = 0;
  /// Start of a control step: sets, for every node of the sheet at x with velocity v, the lanes of
  /// `free` in which it may touch during the step.
  virtual void find_near(const LaneArray<Real>& x, const LaneArray<Real>& v,
                         std::span<const std::uint32_t> free, std::span<std::uint32_t> near) = 0;
  /// Finds the near points of the sheet at x + d in the given lanes.
  virtual void place(const LaneArray<Real>& x, const LaneArray<Real>& d, std::uint32_t lanes) = 0;
  /// In the given lanes: the response of the body to the change of the forces since place().
  virtual void response(std::uint32_t lanes) = 0;
  /// Moves by the step length along the response that the contact solver has chosen.
  virtual void take(std::uint32_t lanes) = 0;
};

}  // namespace omentum
