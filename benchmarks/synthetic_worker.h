#pragma once

#include <cstdint>
#include <string>

#include "sim_worker/bus/bus_worker.h"

namespace omentum {

/// Simulates nothing: a segment of a task is ready at once, or as late as a real one would be. The
/// rest of the worker is the real one: DDS, weights, hashes, CRC, status.
struct SyntheticWorker {
  std::string run;
  std::uint32_t domain = 0;
  int lanes = 16;
  std::size_t state_bytes = 23'064;  ///< 961 particles
  double steps_per_s = 0;            ///< of its lanes together; 0 = as fast as it can
};

/// Options of a worker that serves any learner of this build: the configuration of its manifest, or
/// 11 numbers in an observation where that has none.
BusWorkerOptions synthetic_worker(const SyntheticWorker& worker);

/// The policy of a manifest without a configuration.
PolicyShape synthetic_shape();
inline constexpr std::uint64_t kSyntheticConfigHash = 1;

}  // namespace omentum
