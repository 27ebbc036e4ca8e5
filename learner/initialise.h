#pragma once

#include <cstdint>
#include <vector>

#include "core/policy.h"
#include "proto/config.pb.h"

namespace omentum {

/// Fresh parameters in canonical order, a pure function of shape, settings and seed (counters of
/// purpose weights; normal numbers by core/activation.h, orthogonalisation in double with + - * /
/// sqrt only, so the same bits on every machine).
///   orthogonal        hidden sqrt(2), policy head 0.01, value head 1, biases 0
///   variance scaling  hidden truncated normal with variance 1 / fan-in, policy head 0.01 / fan-in,
///                     value head Glorot uniform, biases 0
/// The Gaussian head starts at log std = initial_log_std.
std::vector<float> initial_parameters(const PolicyShape& shape, const pb::Ppo& settings,
                                      std::uint64_t run_seed);

}  // namespace omentum
