#define OMENTUM_LANES 1
#define OMENTUM_REAL float
// clang-format off
#include "sim_worker/kernel.h"
#include "sim_worker/lanes.h"
#include "sim_worker/kernel.inl"
// clang-format on

extern const omentum::Kernel<Real> omentum::kKernelF32x1;
const omentum::Kernel<Real> omentum::kKernelF32x1 = {
    kLanes,         "f32x1",           find_candidates, predict,
    match_clusters, apply_corrections, finish_substep,  nearest_particle,
    skin_surface,   project_surface};
