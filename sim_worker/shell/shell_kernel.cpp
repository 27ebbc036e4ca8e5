// Compiled once per width. The includes keep their order.
// clang-format off
#include "sim_worker/shell/shell_kernel.h"
#include "sim_worker/lanes/lanes.h"
#include "sim_worker/shell/shell_kernel.inl"
#include "sim_worker/shell/shell_contact.inl"
// clang-format on

namespace {

const omentum::ShellKernel<Real> kKernel = {kLanes,
                                            start_substep,
                                            find_residual,
                                            subtract_solution,
                                            hold_patch,
                                            place_contacts,
                                            unsettled_contacts,
                                            sweep_contacts,
                                            load_contact_change,
                                            take_contact_change,
                                            take_surface_change,
                                            drop_far_contacts,
                                            remember_effects,
                                            start_springs,
                                            take_response,
                                            advance_springs,
                                            load_solution,
                                            finish_substep};

}  // namespace

template <>
const omentum::ShellKernel<Real>& omentum::kernel_of<omentum::ShellKernel<Real>, kLanes>() {
  return kKernel;
}
