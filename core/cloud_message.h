#pragma once

#include <cstdint>

#include "proto/foxglove.pb.h"

namespace omentum {

/// x y z as FLOAT32 [m].
inline constexpr std::uint32_t kCloudPointBytes = 12;

/// Points in W, x y z interleaved [m], 3 x `points` numbers, as viewers show them; `time_ns`
/// goes to its timestamp.
foxglove::PointCloud make_cloud(const float* positions, std::uint32_t points,
                                std::uint64_t time_ns);

}  // namespace omentum
