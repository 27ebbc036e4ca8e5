#pragma once

#include <Eigen/Core>

namespace omentum {

/// Makes Eigen cut dense products into the same blocks on every machine: sums over blocks are in
/// another order where they are cut by the caches of the processor, and the last bits with them. A
/// program that promises bits calls it before its first product. Sizes are those of a Zen 3.
inline void fix_product_blocks() {
  constexpr std::ptrdiff_t kLevel1 = 32 << 10, kLevel2 = 512 << 10, kLevel3 = 32 << 20;  // [bytes]
  Eigen::setCpuCacheSizes(kLevel1, kLevel2, kLevel3);
}

}  // namespace omentum
