// Compiled once per width. The includes keep their order.
// clang-format off
#include "sim_worker/solid/solid_kernel.h"
#include "sim_worker/lanes/lanes.h"
#include "sim_worker/solid/solid_kernel.inl"
// clang-format on

namespace {

const omentum::SolidKernel<Real> kKernel = {kLanes,           start_substep,     start_effects,
                                            remember_effects, find_residual,     find_reaction,
                                            multiply_hessian, keep_free,         dot_product,
                                            add_scaled,       advance_direction, finish_substep};

}  // namespace

template <>
const omentum::SolidKernel<Real>& omentum::kernel_of<omentum::SolidKernel<Real>, kLanes>() {
  return kKernel;
}
