// mismatch: where simulation and recordings differ. So far: recordings in and out, simulation of
// recorded commands.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <new>
#include <optional>

#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/recording_info.h"
#include "mismatch/recording_folder.h"
#include "mismatch/recording_program.h"
#include "mismatch/simulate.h"
#include "sim_worker/camera/depth_sensor.h"
#include "sim_worker/models.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

struct SimulateOptions {
  std::string scene, commands, output, model;
  std::vector<std::string> overrides;
  GraspSettings grasp;
  std::optional<double> patch_radius_m;  ///< none: the scene's
  double cloud_rate_hz = 10;
  double tolerance_mm = 0;  ///< 0 = what the scene says
  std::string columns;      ///< names of parameters; empty = none
  std::uint64_t seed = 1;
};

pb::RecordingInfo info_of(const Scene& scene, const SimulateOptions& options, double rate_hz) {
  pb::RecordingInfo info;
  info.set_name(std::filesystem::path(options.output).filename().string());
  info.set_frame("W");
  info.set_units("m, s, N, rad");
  info.set_tip_point(pb::jaw_tip);
  info.set_tool_rate_hz(rate_hz);
  info.set_force_rate_hz(rate_hz);
  info.set_markers_rate_hz(rate_hz);
  if (options.cloud_rate_hz == 0) return info;
  info.set_cloud_rate_hz(options.cloud_rate_hz);
  pb::RecordingCamera& camera = *info.mutable_camera();
  for (int k = 0; k < 3; ++k) {
    camera.add_p_m(scene.camera.position[k]);
    camera.add_view_direction(-scene.camera.R_WC(k, 2));
    camera.add_up(scene.camera.R_WC(k, 1));
  }
  camera.set_width(scene.config.depth_sensor().width_px());
  camera.set_height(scene.config.depth_sensor().height_px());
  camera.set_vertical_fov_rad(scene.camera.vertical_fov_rad);
  return info;
}

constexpr double kControlPeriod = 0.02;  // [s] of every recording (docs/formats.md 3)

/// A scene and what is simulated of it.
struct Setup {
  Scene scene;
  ToolTrack track;
  std::vector<PinchCircle> pinches;
  GraspSettings grasp;
  std::shared_ptr<const TissueModel> model;
  std::shared_ptr<const Arm> arm;
};

void warn(const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings)
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
}

ToolTrack load_commands(const SimulateOptions& options, const Scene& scene) {
  std::vector<std::string> warnings;
  ToolTrack track = read_tool_track(options.commands, read_recording_info(options.commands),
                                    scene_tool_mount(scene), warnings);
  check_reach(track, scene, warnings);
  warn(warnings);
  return track;
}

/// The scene of the options, with further overrides.
pb::Scene make_config(const SimulateOptions& options, const std::vector<std::string>& more = {}) {
  std::vector<std::string> overrides = options.overrides;
  overrides.insert(overrides.end(), more.begin(), more.end());
  pb::Scene config = load_scene(options.scene, overrides);
  if (!options.model.empty()) {
    config.mutable_tissue()->set_model(options.model == "cluster"   ? pb::TISSUE_CLUSTER
                                       : options.model == "elastic" ? pb::TISSUE_ELASTIC
                                                                    : pb::TISSUE_REFERENCE);
  }
  if (options.tolerance_mm > 0) {
    pb::ReferenceModel& mesh = *config.mutable_tissue()->mutable_reference();
    mesh.set_tolerance_m(1e-3 * options.tolerance_mm);
    mesh.clear_elements_x();
    mesh.clear_elements_y();
    mesh.clear_elements_z();
  }
  return config;
}

Setup make_setup(const SimulateOptions& options) {
  const pb::Scene config = make_config(options);
  const auto of_scene = [&](const auto& make) {
    try {
      return make();
    } catch (const Error& error) {
      throw_error("{}", with_place(options.scene, error.what()));
    }
  };
  Setup made;
  made.scene = of_scene([&] {
    return make_scene(config, std::filesystem::path(options.scene).parent_path().string());
  });
  made.track = load_commands(options, made.scene);
  const pb::Grip& grip = made.scene.config.tool().grip();
  if (options.patch_radius_m && grip.shape() == pb::GRIP_RECTANGLE)
    throw_error(
        "--patch-radius: {} m with scene.tool.grip.shape GRIP_RECTANGLE, allowed: GRIP_DISC",
        *options.patch_radius_m);
  made.grasp = options.grasp;
  made.grasp.patch_radius_m = options.patch_radius_m.value_or(
      grip.shape() == pb::GRIP_RECTANGLE ? std::max(grip.half_x_m(), grip.half_y_m())
                                         : grip.half_x_m());
  made.pinches = pinches_of(made.track, made.scene, made.grasp);
  made.model = of_scene([&] {
    return make_tissue_model(made.scene, kControlPeriod, made.scene.warnings, made.pinches);
  });
  made.arm = of_scene([&] {
    return std::make_shared<Arm>(config.arm(), scene_tool_mount(made.scene), kControlPeriod);
  });
  for (std::string& warning : made.scene.warnings) warning = with_place(options.scene, warning);
  warn(made.scene.warnings);
  return made;
}

/// Of the reference: the same commands on a mesh with 1.5 times larger cells, printed.
void print_mesh_error(const Setup& setup, const SimulateOptions& options,
                      const ReferenceTissueModel& fine, const SimulatedRecording& recording) {
  constexpr double kRatio = 1.5;
  Scene scene = setup.scene;
  *scene.config.mutable_tissue()->mutable_reference() =
      coarser_mesh(fine.numerics, {fine.cells(0), fine.free_cells_y(), fine.cells(2)}, kRatio);
  std::vector<std::string> ignored;
  const std::shared_ptr<const TissueModel> model =
      make_tissue_model(scene, kControlPeriod, ignored, setup.pinches);
  const SimulatedRecording coarse =
      simulate_recording(*model, *setup.arm, setup.track, setup.grasp);
  if (!coarse.failure.empty()) {
    std::printf("%s: no estimate of the discretisation error: with larger cells %s\n",
                options.output.c_str(), coarse.failure.c_str());
    return;
  }
  const MeshError error = estimate_mesh_error(recording, coarse, kRatio);
  std::printf(
      "%s: mesh %d x %d x %d, discretisation error about %.4f mm rms, %.4f mm at the worst time, "
      "%.2f %% of force\n",
      options.output.c_str(), fine.cells(0), fine.free_cells_y(), fine.cells(2), 1e3 * error.rms_m,
      1e3 * error.worst_rms_m, 100 * error.force);
}

/// Scenes and arms in which the parameters are larger by their step.
std::vector<PreparedParameter> prepare_parameters(const SimulateOptions& options,
                                                  const Setup& setup,
                                                  const ReferenceTissueModel& model) {
  std::vector<PreparedParameter> prepared;
  for (Parameter& parameter : parse_parameters(options.columns, setup.scene.config)) {
    PreparedParameter p;
    p.tissue.kind = ColumnKind::kToolPath;
    try {
      if (parameter.kind == Parameter::Kind::kSite) p.tissue = parameter.site;
      if (!parameter.overrides.empty()) {
        const pb::Scene config = make_config(options, parameter.overrides);
        if (parameter.kind == Parameter::Kind::kArm) {
          p.arm =
              std::make_shared<Arm>(config.arm(), scene_tool_mount(setup.scene), kControlPeriod);
        } else {
          std::vector<std::string> ignored;
          const Scene scene =
              make_scene(config, std::filesystem::path(options.scene).parent_path().string());
          p.tissue.kind = ColumnKind::kScene;
          p.tissue.step = parameter.step;
          p.tissue.changed =
              make_reference_model(scene, kControlPeriod, ignored, setup.pinches, &model);
        }
      }
    } catch (const Error& error) {
      if (parameter.from_all) {
        warn({fmt::format("--columns: {} is left out: {}", parameter.name, error.what())});
        continue;
      }
      throw_error("--columns: {} has no column in this scene: {}", parameter.name, error.what());
    }
    p.parameter = std::move(parameter);
    prepared.push_back(std::move(p));
  }
  return prepared;
}

std::unique_ptr<ColumnRecorder> make_columns(const SimulateOptions& options, const Setup& setup,
                                             const std::string& folder, std::size_t stride) {
  if (options.columns.empty()) return nullptr;
  const auto model = std::dynamic_pointer_cast<const ReferenceTissueModel>(setup.model);
  if (!model) throw_error("--columns: the tissue is not TISSUE_REFERENCE; give --model reference");
  const std::size_t frames = count_steps(setup.track, kControlPeriod) / stride + 1;
  return std::make_unique<ColumnRecorder>(prepare_parameters(options, setup, *model), setup.scene,
                                          model, *setup.arm, folder, frames);
}

int simulate(const SimulateOptions& options) {
  const Setup setup = make_setup(options);
  const Scene& scene = setup.scene;
  const ToolTrack& track = setup.track;
  OutputFolder folder(options.output);
  folder.begin();
  const auto stride = static_cast<std::size_t>(
      options.cloud_rate_hz > 0
          ? std::max(1.0, std::round(1 / kControlPeriod / options.cloud_rate_hz))
          : 0);
  const std::size_t column_stride = stride > 0 ? stride : 1;
  const std::unique_ptr<ColumnRecorder> columns =
      make_columns(options, setup, folder.path().string(), column_stride);
  SimulatedRecording recording = simulate_recording(*setup.model, *setup.arm, track, setup.grasp,
                                                    columns.get(), column_stride);
  if (columns) {
    columns->finish();
    if (recording.failure.empty()) recording.failure = columns->failure();
  }
  recording.clocks = scene.config.clocks();
  if (recording.missed_grasps > 0) {
    warn({fmt::format("{}: the jaw closed {} times and held nothing", track.path,
                      recording.missed_grasps)});
  }
  const auto* reference = dynamic_cast<const ReferenceTissueModel*>(setup.model.get());
  std::unique_ptr<Camera> camera;
  if (options.cloud_rate_hz > 0) camera = std::make_unique<Camera>(scene, 64, 64);
  const CloudOf cloud = [&](std::size_t step) {
    const double t = recording.time[step] - scene.config.depth_sensor().time_offset_s();
    const SeenState seen = seen_at(recording, t);
    ToolPose tool;
    tool.p_WT = seen.tip;
    tool.jaw_rad = track.jaw_rad.empty() ? 0 : track.jaw_at(t);
    CameraFrame frame{seen.surface, tool, {}};
    if (reference != nullptr) {  // two faces
      frame.lower_face_W = frame.tissue_vertices_W.last(seen.surface.size() / 2);
      frame.tissue_vertices_W = frame.tissue_vertices_W.first(seen.surface.size() / 2);
    }
    return sense_cloud(*camera, frame, scene.config.depth_sensor(), options.seed,
                       static_cast<std::uint32_t>(step));
  };
  pb::RecordingInfo info = info_of(scene, options, 1 / kControlPeriod);
  if (!recording.failure.empty()) info.set_incomplete(recording.failure);
  write_recording(folder, info, track, recording, cloud, stride);
  double largest = 0;
  for (const Eigen::Vector3d& f : recording.force) largest = std::max(largest, f.norm());
  std::printf("%s: %zu steps, %zu nodes, largest force %.4f N\n", options.output.c_str(),
              recording.time.size() - 1, recording.points.front().size(), largest);
  if (columns) {
    std::printf("%s: columns.npz, %zu frames\n", options.output.c_str(), columns->frames());
    warn(columns->warnings());
  }
  if (!recording.failure.empty()) {
    std::fprintf(stderr, "mismatch: %s; what there is up to there is in %s\n",
                 recording.failure.c_str(), options.output.c_str());
    return 1;
  }
  if (reference != nullptr) print_mesh_error(setup, options, *reference, recording);
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  return 0;
}

int run(int argc, char** argv) {
  CLI::App app{"Omentum mismatch: compares simulation with recordings of the real thing."};
  app.require_subcommand(1);
  SimulateOptions options;
  CLI::App& sub = *app.add_subcommand(
      "simulate",
      "Run a scene under the tool commands of a recording folder and write what a "
      "recording of it would hold (docs/formats.md 3)");
  sub.add_option("--scene", options.scene, "Scene file (deploy/scenes/*.txtpb)")->required();
  sub.add_option("--commands", options.commands, "Recording folder with tool.csv")->required();
  sub.add_option("-o,--output", options.output, "Folder to write; new or empty")->required();
  sub.add_option("--model", options.model, "Tissue model instead of the scene's")
      ->check(CLI::IsMember({"cluster", "elastic", "reference"}));
  sub.add_option("--set", options.overrides, "Override of the scene, a.b=c (scene.tissue...)");
  sub.add_option("--patch-radius", options.patch_radius_m,
                 "Tissue this near the tip is held, instead of scene.tool.grip.half_x_m [m]")
      ->check(number_between(1e-4, 0.05));
  sub.add_option("--tolerance-mm", options.tolerance_mm,
                 "Mesh of the reference for this rms error of the surface, instead of the "
                 "scene's [mm]")
      ->check(number_between(1e-3, 10));
  sub.add_option("--columns", options.columns,
                 "Derivatives by these parameters too, to columns.npz: all, sites, or names of the "
                 "list below with commas");
  sub.footer("Parameters of --columns, their units and settings (name@key=value:key=value):\n" +
             describe_parameters());
  sub.add_option("--closed", options.grasp.closed_rad, "The jaw holds at or below this angle [rad]")
      ->check(number_between(0, 3.2))
      ->capture_default_str();
  sub.add_option("--cloud-rate", options.cloud_rate_hz, "Clouds per second; 0 = none [Hz]")
      ->check(number_between(0, 50))
      ->capture_default_str();
  sub.add_option("--seed", options.seed, "Seed of the depth sensor")
      ->check(whole_number())
      ->capture_default_str();
  const std::function<int()> recordings = add_recording_commands(app);
  app.footer(
      "Exit codes: 0 done, 1 the tissue fails under the commands, 2 wrong input, or the output "
      "cannot be written.");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  return sub.parsed() ? simulate(options) : recordings();
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "mismatch: scene and commands need more memory than there is\n");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "mismatch: %s\n", error.what());
  }
  return 2;
}
