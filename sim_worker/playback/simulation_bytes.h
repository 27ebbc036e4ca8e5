#pragma once

#include <cstddef>
#include <functional>
#include <span>
#include <string>

#include "core/result.h"
#include "core/types.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {

/// Bytes of a task, with the contents of its mesh files. Fails where a mesh cannot be read or
/// elsewhere would be refused: numbers outside their ranges, more than kMaxTaskBytes.
Result<Bytes> task_bytes(const SimulationTask& task);

/// The task in bytes that anybody may have sent; its mesh files are written into `folder`, where
/// its columns go too. Equal to the one they were made from in all that decides the result. Fails
/// for what is no task: out of range, not finite, not in order, a mesh that it does not bring
/// along.
Result<SimulationTask> read_task(std::span<const std::byte> bytes, const std::string& folder);

/// The pure function that travels: simulate() on the bytes of a task. An error is a result as well.
/// `stop` as simulate()'s. At most kMaxResultBytes.
Bytes run_task_bytes(std::span<const std::byte> bytes, const std::function<bool()>& stop);

/// What came of a task, in bytes that anybody may have sent. Equal to simulate(task) bit for bit,
/// whose scene is made again and whose columns.npz is written into its columns_folder. Fails for
/// the reason that the result gives, and for bytes that cannot be a result of this task: nothing is
/// written then. Throws Error for a scene that cannot be.
Result<Simulation> read_result(std::span<const std::byte> bytes, const SimulationTask& task);

}  // namespace omentum
