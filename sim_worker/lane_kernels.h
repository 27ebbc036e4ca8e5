#pragma once

#include "sim_worker/elastic_kernel.h"
#include "sim_worker/kernel.h"
#include "sim_worker/solid_kernel.h"

namespace omentum {

/// The elastic kernels of the same width and precision as a lane kernel.
inline const ElasticKernel<float>& elastic_kernel_for(const Kernel<float>& kernel) {
  if (kernel.lanes == 16) return kElasticKernelF32x16;
  return kernel.lanes == 8 ? kElasticKernelF32x8 : kElasticKernelF32x1;
}
inline const ElasticKernel<double>& elastic_kernel_for(const Kernel<double>&) {
  return kElasticKernelF64x1;
}

inline const SolidKernel<float>& solid_kernel_for(const Kernel<float>& kernel) {
  if (kernel.lanes == 16) return kSolidKernelF32x16;
  return kernel.lanes == 8 ? kSolidKernelF32x8 : kSolidKernelF32x1;
}
inline const SolidKernel<double>& solid_kernel_for(const Kernel<double>&) {
  return kSolidKernelF64x1;
}

}  // namespace omentum
