#pragma once

#include <array>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sim_worker/playback/mesh_error.h"
#include "sim_worker/playback/simulate.h"

namespace omentum {

/// The commands of a recording under a scene: all that its simulation depends on.
struct SimulationTask {
  pb::Scene scene;     ///< checked and filled in (load_scene)
  std::string folder;  ///< relative paths of the scene's meshes begin here
  ToolTrack commands;
  double period = 0.02;  ///< control step, by which states are recorded [s]
  GraspSettings grasp;
  std::string parameters;  ///< differentiated by, as parse_parameters(); TISSUE_REFERENCE only
  /// Exists, takes columns.npz; empty: the columns of `column_steps` are kept in memory.
  std::string columns_folder;
  std::vector<std::size_t> column_steps;  ///< control steps, ascending
  std::size_t stride = 1;       ///< control steps from one frame of the columns to the next
  bool from_rest = true;        ///< else from the shape that the scene gives the tissue
  bool estimate_error = false;  ///< of the mesh of the reference, by a coarser one
};

/// Surfaces and forces of a task; its columns are here or in their file.
struct Simulation {
  Scene scene;
  bool reference = false;      ///< TISSUE_REFERENCE: of two faces
  std::array<int, 3> cells{};  ///< of its mesh along x, y without the clamp, and z
  SimulatedRecording recording;
  std::size_t column_frames = 0;
  std::map<std::size_t, StateColumns> columns;  ///< of SimulationTask::column_steps
  std::optional<MeshError> mesh_error;  ///< none where the coarser mesh fails under the commands
  std::vector<std::string> warnings;    ///< a line each
  std::vector<std::string> model_warnings;  ///< beside those of the scene
};

/// A pure function of the task; any number of tasks at a time share nothing that changes. Throws
/// Error for a scene that cannot be, a parameter without a column, and a result that does not fit
/// into memory; tissue that fails on the way is no Error: the recording says so and ends there.
/// `stop`, asked now and then, ends it early: what it gives then is of no use.
Simulation simulate(const SimulationTask& task, const std::function<bool()>& stop = {});

/// Calls job(0) ... job(count - 1), each on one of so many threads; returns when all have ended.
/// The first exception in the order of the jobs is thrown again.
void run_parallel(std::size_t count, std::size_t threads,
                  const std::function<void(std::size_t)>& job);

}  // namespace omentum
