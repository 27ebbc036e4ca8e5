#define OMENTUM_LANES 8
#define OMENTUM_REAL float
// clang-format off
#include "sim_worker/elastic_kernel.h"
#include "sim_worker/lanes.h"
#include "sim_worker/elastic_kernel.inl"
// clang-format on

extern const omentum::ElasticKernel<Real> omentum::kElasticKernelF32x8;
const omentum::ElasticKernel<Real> omentum::kElasticKernelF32x8 = {kLanes,
                                                                   start_substep,
                                                                   find_residual,
                                                                   solve,
                                                                   subtract_solution,
                                                                   hold_patch,
                                                                   load_contacts,
                                                                   guess_contact_forces,
                                                                   sweep_contacts,
                                                                   load_contact_change,
                                                                   drop_far_contacts,
                                                                   remember_effects,
                                                                   start_springs,
                                                                   take_answer,
                                                                   advance_springs,
                                                                   load_solution,
                                                                   finish_substep};
