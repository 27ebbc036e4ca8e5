#include "sim_worker/playback/simulation.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <exception>
#include <thread>
#include <utility>

#include "core/check.h"
#include "core/config.h"
#include "sim_worker/models.h"

namespace omentum {
namespace {

/// Scenes and arms in which the parameters are larger by their step.
std::vector<PreparedParameter> prepare_parameters(const SimulationTask& task,
                                                  const std::vector<PinchCircle>& pinches,
                                                  const Scene& scene,
                                                  const ReferenceTissueModel& model,
                                                  std::vector<std::string>& warnings) {
  std::vector<PreparedParameter> prepared;
  for (const Parameter& parameter : parse_parameters(task.parameters, task.scene)) {
    PreparedParameter p;
    p.parameter = parameter;
    p.tissue.kind = ColumnKind::kToolPath;
    try {
      if (parameter.kind == Parameter::Kind::kSite) p.tissue = parameter.site;
      const bool of_clamp =
          p.tissue.kind == ColumnKind::kClampGive || p.tissue.kind == ColumnKind::kClampFree;
      if (of_clamp && model.effects.moves_anchor())
        throw_error("the clamp gives way already: scene.tissue.effects.anchor, allowed none");
      if (parameter.kind == Parameter::Kind::kHeldPlace && !task.scene.has_held_start())
        throw_error("nothing is held at the start: scene.held_start is missing");
      if (p.tissue.kind == ColumnKind::kStartVelocity && task.scene.has_held_start())
        throw_error("it begins where jaws held it: scene.held_start, allowed none");
      if (parameter.kind == Parameter::Kind::kScene || parameter.kind == Parameter::Kind::kArm) {
        pb::Scene config = override_scene(task.scene, parameter.overrides);
        if (!parameter.effect.empty())
          set_effect(*config.mutable_tissue()->mutable_effects(), parameter.effect,
                     parameter.value);
        if (parameter.kind == Parameter::Kind::kArm) {
          p.arm = std::make_shared<Arm>(config.arm(), scene_tool_mount(scene), task.period);
        } else {
          std::vector<std::string> ignored;
          p.tissue.kind = ColumnKind::kScene;
          p.tissue.step = parameter.step;
          p.tissue.changed = make_reference_model(make_scene(config, task.folder), task.period,
                                                  ignored, pinches, &model);
          check_column(model, p.tissue);
        }
      }
    } catch (const Error& error) {
      if (parameter.from_all) {
        warnings.push_back(
            fmt::format("--columns: {} is left out: {}", parameter.name, error.what()));
        continue;
      }
      throw_error("--columns: {} has no column in this scene: {}", parameter.name, error.what());
    }
    prepared.push_back(std::move(p));
  }
  return prepared;
}

using Stop = std::function<bool()>;

/// Runs the task with its columns, if it has any.
void run_task(const SimulationTask& task, const RecordingStart& start,
              const std::vector<PinchCircle>& pinches, const Arm& arm,
              const std::shared_ptr<const TissueModel>& tissue, const Stop& stop,
              Simulation& made) {
  SimulatedRecording& recording = made.recording;
  const auto run = [&](ColumnCarrier* columns) {
    recording = simulate_recording(*tissue, arm, task.commands, task.grasp, start, columns, stop);
    if (columns == nullptr) return;
    if (recording.failure.empty()) recording.failure = columns->failure();
    made.warnings.insert(made.warnings.end(), columns->warnings().begin(),
                         columns->warnings().end());
  };
  if (task.parameters.empty()) return run(nullptr);
  const auto model = std::dynamic_pointer_cast<const ReferenceTissueModel>(tissue);
  if (!model) throw_error("--columns: the tissue is not TISSUE_REFERENCE; give --model reference");
  std::vector<PreparedParameter> parameters =
      prepare_parameters(task, pinches, made.scene, *model, made.warnings);
  if (task.columns_folder.empty()) {
    ColumnKeeper keeper(std::move(parameters), made.scene, model, arm, task.column_steps);
    run(&keeper);
    made.columns = std::move(keeper.kept);
    return;
  }
  const std::size_t frames = count_steps(task.commands, task.period) / task.stride + 1;
  ColumnRecorder recorder(std::move(parameters), made.scene, model, arm, task.columns_folder,
                          frames, task.stride);
  run(&recorder);
  recorder.finish();
  made.column_frames = recorder.frames();
}

/// Tissue that nothing holds has no rest to begin from: it begins in the shape of the scene.
RecordingStart start_of(const SimulationTask& task, const Scene& scene) {
  RecordingStart start;
  if (task.scene.has_held_start()) {
    const pb::HeldStart& held = task.scene.held_start();
    const pb::Vec3& p = held.position_m();
    start.held = {{held.x_m(), held.y_m()}, held.radius_m(), {p.x(), p.y(), p.z()}, held.until_s()};
  }
  start.from_rest = task.from_rest && (start.held || !scene.falls());
  const pb::Vec3& v = task.scene.start_velocity_m_per_s();
  start.velocity = {v.x(), v.y(), v.z()};
  if (start.held && !start.velocity.isZero(0))
    throw_error("scene.start_velocity_m_per_s: allowed without scene.held_start");
  return start;
}

}  // namespace

Simulation simulate(const SimulationTask& task, const std::function<bool()>& stop) {
  Simulation made;
  made.scene = make_scene(task.scene, task.folder);
  std::vector<PinchCircle> pinches = pinches_of(task.commands, made.scene, task.grasp);
  const RecordingStart start = start_of(task, made.scene);
  if (start.held) pinches.push_back({start.held->place, start.held->radius});
  const std::shared_ptr<const TissueModel> model =
      make_tissue_model(made.scene, task.period, made.model_warnings, pinches);
  const auto* reference = dynamic_cast<const ReferenceTissueModel*>(model.get());
  made.reference = reference != nullptr;
  if (made.reference)
    made.cells = {reference->cells(0), reference->free_cells_y(), reference->cells(2)};
  const Arm arm(task.scene.arm(), scene_tool_mount(made.scene), task.period);
  run_task(task, start, pinches, arm, model, stop, made);
  SimulatedRecording& recording = made.recording;
  recording.clocks = task.scene.clocks();
  constexpr double kAtRest = 1e-4;  // [m/s]
  if (recording.start_speed > kAtRest) {
    made.warnings.push_back(
        fmt::format("{}: the tissue still moves at {:.3g} m/s when the commands begin, at rest are "
                    "{} m/s; scene.tissue.material.damping_per_s damps it",
                    task.commands.path, recording.start_speed, kAtRest));
  }
  if (recording.missed_grasps > 0) {
    made.warnings.push_back(fmt::format("{}: the jaw closed {} times and held nothing",
                                        task.commands.path, recording.missed_grasps));
  }
  if (task.estimate_error && made.reference && recording.failure.empty()) {
    const auto run = [&](const pb::ReferenceModel& mesh) {
      Scene scene = made.scene;
      *scene.config.mutable_tissue()->mutable_reference() = mesh;
      std::vector<std::string> ignored;
      const auto other = make_tissue_model(scene, task.period, ignored, pinches);
      return simulate_recording(*other, arm, task.commands, task.grasp, start, nullptr, stop);
    };
    made.mesh_error =
        find_mesh_error(recording, reference->numerics, made.cells, run, made.warnings);
  }
  return made;
}

void run_parallel(std::size_t count, std::size_t threads,
                  const std::function<void(std::size_t)>& job) {
  std::vector<std::exception_ptr> errors(count);
  std::atomic<std::size_t> next{0};
  {
    std::vector<std::jthread> workers;
    for (std::size_t i = 0; i < std::min(count, threads); ++i) {
      workers.emplace_back([&] {
        for (std::size_t k = next++; k < count; k = next++) {
          try {
            job(k);
          } catch (...) {
            errors[k] = std::current_exception();
          }
        }
      });
    }
  }
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }
}

}  // namespace omentum
