// Compiled once per width. The includes keep their order.
// clang-format off
#include "sim_worker/cluster/cluster_kernel.h"
#include "sim_worker/lanes/lanes.h"
#include "sim_worker/cluster/cluster_kernel.inl"
// clang-format on

namespace {

const omentum::ClusterKernel<Real> kKernel = {kLanes, predict, pull_bonds, match_clusters};

}  // namespace

template <>
const omentum::ClusterKernel<Real>& omentum::kernel_of<omentum::ClusterKernel<Real>, kLanes>() {
  return kKernel;
}
