#define OMENTUM_LANES 8
#define OMENTUM_REAL float
// clang-format off
#include "sim_worker/solid_kernel.h"
#include "sim_worker/lanes.h"
#include "sim_worker/solid_kernel.inl"
// clang-format on

extern const omentum::SolidKernel<Real> omentum::kSolidKernelF32x8;
const omentum::SolidKernel<Real> omentum::kSolidKernelF32x8 = {
    kLanes,         start_substep,    start_effects,   remember_effects, find_residual,
    find_reaction,  multiply_hessian, keep_free,       dot_product,      add_scaled,
    turn_direction, finish_substep,   solve_components};
