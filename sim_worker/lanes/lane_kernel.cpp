// Compiled once per width. The includes keep their order.
// clang-format off
#include "sim_worker/lanes/lane_kernel.h"
#include "sim_worker/lanes/lanes.h"
#include "sim_worker/lanes/lane_kernel.inl"
// clang-format on

namespace {

const omentum::LaneKernel<Real> kKernel = {
    kLanes,       kLaneName,       find_candidates,     nearest_particle,
    skin_surface, project_surface, solve_panels<Lane3>, solve_panels<Lane>};

}  // namespace

template <>
const omentum::LaneKernel<Real>& omentum::kernel_of<omentum::LaneKernel<Real>, kLanes>() {
  return kKernel;
}
