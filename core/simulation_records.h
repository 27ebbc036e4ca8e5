#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/types.h"

// The records of simulations of recordings that one program asks others for (docs/wire.md 10).

namespace omentum {

/// What the wire holds of one of them, as in idl/omentum.idl (core/wire.cpp compares).
inline constexpr std::size_t kMaxTaskBytes = std::size_t{1} << 24;
inline constexpr std::size_t kPartBytes = std::size_t{1} << 20;
inline constexpr std::uint32_t kMaxParts = 1024;
inline constexpr std::size_t kMaxResultBytes = kPartBytes * kMaxParts;

/// Of SimulationGrant::payload and of the payload of the parts. A change of their messages that
/// another build would misread counts it up.
inline constexpr std::uint32_t kSimulationFormat = 1;

/// One grant of a pure function call: bytes of the task -> bytes of the result.
struct SimulationGrant {
  std::uint32_t asker_id = 0;  ///< hash of host, process and start time
  std::uint32_t task = 0;      ///< chosen by the asker
  std::string asker;           ///< program, host and process, for the log
  std::uint32_t grant = 0;
  std::uint32_t worker_id = 0;
  std::uint32_t format = kSimulationFormat;
  std::uint64_t build_id = 0;   ///< of the asker
  std::uint64_t task_hash = 0;  ///< hash_state() of the payload
  std::uint32_t steps = 0;      ///< control steps, for rates
  Bytes payload;
  std::int64_t granted_at_ns = 0;
};

/// A piece of its result, or why there will be none. All pieces but the last are of kPartBytes.
struct SimulationPart {
  std::uint32_t asker_id = 0;
  std::uint32_t task = 0;
  std::uint32_t grant = 0;
  std::uint32_t worker_id = 0;
  std::uint64_t task_hash = 0;
  std::uint32_t part = 0;
  std::uint32_t parts = 0;
  std::uint64_t result_bytes = 0;   ///< of all parts
  std::uint32_t result_crc32c = 0;  ///< of all parts
  Bytes payload;
  std::int64_t compute_time_ns = 0;  ///< of the processor; no part of the result
  std::string declined;              ///< why the worker does not do it; then there are no parts
};

/// Pieces of a result of so many bytes.
constexpr std::uint64_t count_parts(std::uint64_t result_bytes) {
  return (result_bytes + kPartBytes - 1) / kPartBytes;
}

/// Bytes of one of its pieces. Precondition: part < count_parts(result_bytes).
constexpr std::uint64_t size_of_part(std::uint64_t result_bytes, std::uint64_t part) {
  return std::min<std::uint64_t>(kPartBytes, result_bytes - part * kPartBytes);
}

}  // namespace omentum
