#include "sim_worker/playback/simulation_bytes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <new>
#include <set>
#include <utility>

#include "core/check.h"
#include "core/config.h"
#include "core/durable_file.h"
#include "core/hash.h"
#include "core/scene_files.h"
#include "core/scratch_folder.h"
#include "core/simulation_records.h"
#include "proto/simulation.pb.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

constexpr std::size_t kMostRows = 5'000'000;  // of a track
constexpr std::size_t kMostList = 100'000;    // characters that name parameters
constexpr std::size_t kMostSteps = 5'000'000;
constexpr const char* kColumnsFile = "columns.npz";

static_assert(sizeof(Vector3d) == 3 * sizeof(double));

/// Packs points one after the other.
void add(google::protobuf::RepeatedField<double>& values, const std::vector<Vector3d>& points) {
  if (points.empty()) return;
  const double* first = points.front().data();
  values.Add(first, first + 3 * points.size());
}

std::vector<Vector3d> points_of(const google::protobuf::RepeatedField<double>& values) {
  std::vector<Vector3d> points;
  points.reserve(static_cast<std::size_t>(values.size()) / 3);
  for (int k = 0; k + 2 < values.size(); k += 3)
    points.emplace_back(values[k], values[k + 1], values[k + 2]);
  return points;
}

template <typename T>
bool all_finite(const google::protobuf::RepeatedField<T>& values) {
  return std::all_of(values.begin(), values.end(), [](T x) { return std::isfinite(x); });
}

Bytes bytes_of(const google::protobuf::Message& message) {
  Bytes bytes(message.ByteSizeLong());
  OMENTUM_CHECK(message.SerializeToArray(bytes.data(), static_cast<int>(bytes.size())));
  return bytes;
}

bool parse(std::span<const std::byte> bytes, google::protobuf::Message& message) {
  return bytes.size() <= std::numeric_limits<int>::max() &&
         message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()));
}

/// As mesh files are called on their way: the number and the ending, which says what they are.
std::string mesh_name(std::size_t number, const std::string& path) {
  return fmt::format("mesh{}{}", number, fs::path(path).extension().string());
}

/// Whether a name is one of mesh_name(): no path leads out of a folder.
bool is_mesh_name(const std::string& name) {
  const std::size_t most = 24;
  return name.starts_with("mesh") && name.size() < most &&
         std::all_of(name.begin(), name.end(), [](char c) {
           return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                  c == '.';
         });
}

/// Throws Error for a task that simulate() must not be given.
void check_task(const pb::SimulationTask& task) {
  const auto rows = static_cast<std::size_t>(task.time_s_size());
  const auto require = [](bool good, const char* what) {
    if (!good) throw_error("task: {}", what);
  };
  require(rows >= 1 && rows <= kMostRows, "number of rows of the track");
  require(static_cast<std::size_t>(task.tip_size()) == 3 * rows, "length of tip");
  require(task.jaw_rad_size() == 0 || static_cast<std::size_t>(task.jaw_rad_size()) == rows,
          "length of jaw_rad");
  require(all_finite(task.time_s()) && all_finite(task.tip()) && all_finite(task.jaw_rad()),
          "a number that is none");
  for (std::size_t k = 1; k < rows; ++k) {
    const int row = static_cast<int>(k);
    require(task.time_s(row) > task.time_s(row - 1), "times are not in order");
  }
  require(task.period_s() >= 1e-4 && task.period_s() <= 1, "period_s");
  const double last = task.time_s(static_cast<int>(rows) - 1);
  require((last - task.time_s(0)) / task.period_s() <= static_cast<double>(kMostSteps),
          "number of control steps");
  require(task.patch_radius_m() >= 1e-5 && task.patch_radius_m() <= 1, "patch_radius_m");
  require(std::isfinite(task.closed_rad()), "closed_rad");
  require(task.parameters().size() <= kMostList, "length of parameters");
  require(std::is_sorted(task.column_step().begin(), task.column_step().end()),
          "column_step is not in order");
  require(task.stride() >= 1 && task.stride() <= kMostSteps, "stride");
}

pb::SimulationTask message_of(const SimulationTask& task) {
  pb::SimulationTask message;
  *message.mutable_scene() = task.scene;
  std::size_t meshes = 0;
  for_each_mesh(*message.mutable_scene(), [&](const std::string& knob, pb::MeshFile& mesh) {
    const Result<Bytes> content = read_whole(scene_file_path(mesh.path(), task.folder));
    if (!content) throw_error("{}.path: {}", knob, content.error());
    pb::MeshContent& file = *message.add_mesh();
    file.set_name(mesh_name(meshes++, mesh.path()));
    file.set_content(content.value().data(), content.value().size());
    mesh.set_path(file.name());
  });
  message.mutable_time_s()->Add(task.commands.time.begin(), task.commands.time.end());
  add(*message.mutable_tip(), task.commands.p_WT);
  message.mutable_jaw_rad()->Add(task.commands.jaw_rad.begin(), task.commands.jaw_rad.end());
  message.set_path(task.commands.path);
  message.set_period_s(task.period);
  message.set_patch_radius_m(task.grasp.patch_radius_m);
  message.set_closed_rad(task.grasp.closed_rad);
  message.set_parameters(task.parameters);
  for (const std::size_t step : task.column_steps) message.add_column_step(step);
  message.set_columns_file(!task.columns_folder.empty());
  message.set_stride(task.stride);
  message.set_from_rest(task.from_rest);
  message.set_estimate_error(task.estimate_error);
  return message;
}

SimulationTask task_of(pb::SimulationTask& message, const std::string& folder) {
  std::set<std::string> brought;
  for (const pb::MeshContent& file : message.mesh()) {
    if (!is_mesh_name(file.name())) throw_error("task: a mesh must not be called as this one is");
    brought.insert(file.name());
    const std::string path = folder + "/" + file.name();
    if (const Result<void> written = write_durably(path, file.content()); !written)
      throw_error("{}", written.error());
  }
  for_each_mesh(*message.mutable_scene(), [&](const std::string& knob, pb::MeshFile& mesh) {
    if (!brought.contains(mesh.path())) throw_error("{}.path: not brought along", knob);
  });
  override_scene(message.scene(), {});  // throws Error for what no file of a scene may hold
  SimulationTask task;
  task.scene = message.scene();
  task.folder = folder;
  task.commands.time.assign(message.time_s().begin(), message.time_s().end());
  task.commands.p_WT = points_of(message.tip());
  task.commands.jaw_rad.assign(message.jaw_rad().begin(), message.jaw_rad().end());
  task.commands.path = message.path();
  task.period = message.period_s();
  task.grasp = {message.patch_radius_m(), message.closed_rad()};
  task.parameters = message.parameters();
  if (message.columns_file()) task.columns_folder = folder;
  task.column_steps.assign(message.column_step().begin(), message.column_step().end());
  task.stride = message.stride();
  task.from_rest = message.from_rest();
  task.estimate_error = message.estimate_error();
  return task;
}

void put_recording(const SimulatedRecording& recording, pb::SimulationResult& result) {
  result.mutable_time_s()->Add(recording.time.begin(), recording.time.end());
  add(*result.mutable_tip(), recording.tip);
  add(*result.mutable_measured_tip(), recording.measured_tip);
  for (const ArmReport& arm : recording.arm) {
    for (const auto* part : {&arm.commanded, &arm.measured, &arm.effort})
      result.mutable_arm()->Add(part->begin(), part->end());
  }
  add(*result.mutable_force(), recording.force);
  for (std::size_t k = 0; k < recording.points.size(); ++k) {
    pb::SimulatedSurface& surface = *result.add_surface();
    add(*surface.mutable_points(), recording.points[k]);
    surface.mutable_drawn()->Add(recording.surface[k].begin(), recording.surface[k].end());
  }
  result.set_missed_grasps(recording.missed_grasps);
  result.set_start_speed_m_per_s(recording.start_speed);
  result.set_failure(recording.failure);
}

pb::SimulationResult message_of(const Simulation& simulation) {
  pb::SimulationResult result;
  put_recording(simulation.recording, result);
  result.set_reference(simulation.reference);
  for (const int cells : simulation.cells) result.add_cells(cells);
  result.set_column_frames(simulation.column_frames);
  for (const auto& [step, state] : simulation.columns) {
    pb::SimulatedColumns& columns = *result.add_columns();
    columns.set_step(step);
    for (std::size_t k = 0; k < state.surface.size(); ++k) {
      pb::SimulatedColumn& column = *columns.add_column();
      column.mutable_surface()->Add(state.surface[k].begin(), state.surface[k].end());
      add(*column.mutable_force(), {state.force[k]});
    }
  }
  if (const auto& error = simulation.mesh_error) {
    result.mutable_mesh_error()->set_rms_m(error->rms_m);
    result.mutable_mesh_error()->set_worst_rms_m(error->worst_rms_m);
    result.mutable_mesh_error()->set_force(error->force);
  }
  for (const std::string& warning : simulation.warnings) result.add_warning(warning);
  for (const std::string& warning : simulation.model_warnings) result.add_model_warning(warning);
  return result;
}

/// Throws Error for a result that cannot be one of the task, whose scene this is.
void check_result(const pb::SimulationResult& result, const SimulationTask& task,
                  const Scene& scene) {
  const auto require = [](bool good, const char* what) {
    if (!good) throw_error("result: {}", what);
  };
  const auto rows = static_cast<std::size_t>(result.time_s_size());
  const std::size_t steps = count_steps(task.commands, task.period);
  require(rows >= 1 && rows <= steps + 1, "number of times");
  require(rows == steps + 1 || !result.failure().empty(), "it ends early without a failure");
  for (std::size_t k = 0; k < rows; ++k) {
    require(result.time_s(static_cast<int>(k)) ==
                task.commands.begin() + static_cast<double>(k) * task.period,
            "times are not those of the commands");
  }
  const auto has = [](const auto& values, std::size_t count) {
    return static_cast<std::size_t>(values.size()) == count;
  };
  require(has(result.tip(), 3 * rows) && has(result.measured_tip(), 3 * rows) &&
              has(result.force(), 3 * rows) && has(result.surface(), rows),
          "lengths differ");
  require(has(result.arm(), 0) || has(result.arm(), 18 * rows), "length of arm");
  require(all_finite(result.tip()) && all_finite(result.measured_tip()), "a tip is no number");
  require(result.reference() == (task.scene.tissue().model() == pb::TISSUE_REFERENCE), "model");
  require(has(result.cells(), 3), "cells");
  const std::size_t points =
      result.reference() ? 2 * scene.tissue.particles.size() : scene.points();
  const std::size_t skin = scene.tissue.surface_vertices.size();
  for (const pb::SimulatedSurface& surface : result.surface()) {
    require(has(surface.points(), 3 * points) && all_finite(surface.points()), "points");
    require(has(surface.drawn(), 3 * points) || (skin > 0 && has(surface.drawn(), 3 * skin)),
            "vertices of the drawn surface");
    require(surface.drawn_size() == result.surface(0).drawn_size() && all_finite(surface.drawn()),
            "drawn surface");
  }
  const bool in_memory = !task.parameters.empty() && task.columns_folder.empty();
  const std::size_t most = in_memory ? parse_parameters(task.parameters, task.scene).size() : 0;
  for (const pb::SimulatedColumns& columns : result.columns()) {
    require(std::binary_search(task.column_steps.begin(), task.column_steps.end(), columns.step()),
            "columns of a step that has none");
    require(has(columns.column(), static_cast<std::size_t>(result.columns(0).column_size())) &&
                static_cast<std::size_t>(columns.column_size()) <= most,
            "number of columns");
    for (const pb::SimulatedColumn& column : columns.column())
      require(has(column.surface(), 3 * points) && has(column.force(), 3), "length of a column");
  }
  // Names that the scene cannot have leave only a list of all.
  const bool whole = result.columns_size() == 0 ||
                     static_cast<std::size_t>(result.columns(0).column_size()) == most;
  require(whole || task.parameters.find("all") != std::string::npos, "columns are missing");
  require(result.columns_file().empty() || !task.columns_folder.empty(), "columns for no folder");
}

void take_recording(const pb::SimulationResult& result, SimulatedRecording& recording) {
  recording.time.assign(result.time_s().begin(), result.time_s().end());
  recording.tip = points_of(result.tip());
  recording.measured_tip = points_of(result.measured_tip());
  for (int at = 0; at < result.arm_size(); at += 18) {
    ArmReport& arm = recording.arm.emplace_back();
    const double* from = result.arm().data() + at;
    std::copy_n(from, 6, arm.commanded.begin());
    std::copy_n(from + 6, 6, arm.measured.begin());
    std::copy_n(from + 12, 6, arm.effort.begin());
  }
  recording.force = points_of(result.force());
  for (const pb::SimulatedSurface& surface : result.surface()) {
    recording.points.push_back(points_of(surface.points()));
    recording.surface.emplace_back(surface.drawn().begin(), surface.drawn().end());
  }
  recording.missed_grasps = result.missed_grasps();
  recording.start_speed = result.start_speed_m_per_s();
  recording.failure = result.failure();
}

Simulation simulation_of(const pb::SimulationResult& result, const SimulationTask& task,
                         Scene scene) {
  Simulation made;
  made.scene = std::move(scene);
  made.model_warnings.assign(result.model_warning().begin(), result.model_warning().end());
  made.warnings.assign(result.warning().begin(), result.warning().end());
  made.reference = result.reference();
  std::copy_n(result.cells().begin(), 3, made.cells.begin());
  take_recording(result, made.recording);
  made.recording.clocks = task.scene.clocks();
  made.column_frames = result.column_frames();
  for (const pb::SimulatedColumns& columns : result.columns()) {
    StateColumns& state = made.columns[columns.step()];
    for (const pb::SimulatedColumn& column : columns.column()) {
      state.surface.emplace_back(column.surface().begin(), column.surface().end());
      state.force.push_back(points_of(column.force()).front());
    }
  }
  if (result.has_mesh_error()) {
    const pb::MeshErrorEstimate& error = result.mesh_error();
    made.mesh_error = {error.rms_m(), error.worst_rms_m(), error.force()};
  }
  return made;
}

}  // namespace

Result<Bytes> task_bytes(const SimulationTask& task) {
  try {
    const pb::SimulationTask message = message_of(task);
    check_task(message);
    override_scene(message.scene(), {});  // throws Error for what no file of a scene may hold
    if (const std::size_t size = message.ByteSizeLong(); size > kMaxTaskBytes) {
      return Failure{fmt::format("the task and its meshes take {} bytes, allowed up to {}", size,
                                 kMaxTaskBytes)};
    }
    return bytes_of(message);
  } catch (const Error& error) {
    return Failure{error.what()};
  }
}

Result<SimulationTask> read_task(std::span<const std::byte> bytes, const std::string& folder) {
  pb::SimulationTask message;
  if (bytes.size() > kMaxTaskBytes || !parse(bytes, message))
    return Failure{"task: bytes that are no message"};
  try {
    check_task(message);
    return task_of(message, folder);
  } catch (const Error& error) {
    return Failure{error.what()};
  }
}

Bytes run_task_bytes(std::span<const std::byte> bytes, const std::function<bool()>& stop) {
  pb::SimulationResult result;
  try {
    const ScratchFolder scratch;
    Result<SimulationTask> task = read_task(bytes, scratch.path().string());
    if (!task) throw_error("{}", task.error());
    result = message_of(simulate(task.value(), stop));
    if (!task.value().columns_folder.empty() && !task.value().parameters.empty()) {
      const Result<Bytes> columns = read_whole((scratch.path() / kColumnsFile).string());
      if (!columns) throw_error("{}", columns.error());
      result.set_columns_file(columns.value().data(), columns.value().size());
    }
    if (const std::size_t size = result.ByteSizeLong(); size > kMaxResultBytes)
      throw_error("the result takes {} bytes, allowed up to {}", size, kMaxResultBytes);
  } catch (const Error& error) {
    result.Clear();
    result.set_error(error.what());
  } catch (const std::bad_alloc&) {
    result.Clear();
    result.set_error("the memory does not suffice");
  }
  return bytes_of(result);
}

Result<Simulation> read_result(std::span<const std::byte> bytes, const SimulationTask& task) {
  pb::SimulationResult result;
  if (!parse(bytes, result)) return Failure{"result: bytes that are no message"};
  if (result.has_error()) return Failure{result.error()};
  Scene scene = make_scene(task.scene, task.folder);
  try {
    check_result(result, task, scene);
  } catch (const Error& error) {
    return Failure{error.what()};
  }
  if (!result.columns_file().empty()) {
    const std::string path = task.columns_folder + "/" + kColumnsFile;
    if (const Result<void> written = write_durably(path, result.columns_file()); !written)
      throw_error("{}", written.error());
  }
  return simulation_of(result, task, std::move(scene));
}

}  // namespace omentum
