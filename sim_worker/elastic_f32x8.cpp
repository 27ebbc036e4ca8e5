#define OMENTUM_LANES 8
#define OMENTUM_REAL float
// clang-format off
#include "sim_worker/elastic_kernel.h"
#include "sim_worker/lanes.h"
#include "sim_worker/elastic_kernel.inl"
#include "sim_worker/elastic_contact.inl"
// clang-format on

extern const omentum::ElasticKernel<Real> omentum::kElasticKernelF32x8;
const omentum::ElasticKernel<Real> omentum::kElasticKernelF32x8 = {kLanes,
                                                                   start_substep,
                                                                   find_residual,
                                                                   solve,
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
                                                                   take_answer,
                                                                   advance_springs,
                                                                   load_solution,
                                                                   finish_substep};
