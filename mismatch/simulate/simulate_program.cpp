#include "mismatch/simulate/simulate_program.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <thread>

#include "core/build_id.h"
#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/file_name.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/read_recording.h"
#include "mismatch/recording/recording_mcap.h"
#include "mismatch/simulate/simulated_recording.h"
#include "mismatch/simulate/simulator.h"
#include "mismatch/simulate/tool_track.h"
#include "sim_worker/camera/depth_sensor.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

constexpr double kScenePeriod = 0.02;  // [s] what the substeps of a scene are counted for

struct SimulateOptions {
  std::string scene, output, model;
  std::vector<std::string> commands, overrides;
  GraspSettings grasp;
  std::optional<double> patch_radius_m;  ///< none: the scene's
  double rate_hz = 0;                    ///< of control steps; 0 = the recording's
  double cloud_rate_hz = 10;
  double tolerance_mm = 0;  ///< 0 = what the scene says
  std::string columns;      ///< names of parameters; empty = none
  bool no_settle = false;
  std::uint64_t seed = 1;
  std::size_t threads = std::max(1U, std::thread::hardware_concurrency());
  SimulatorOptions simulator;
};

bool is_mcap(const std::string& path) { return has_ending(path, ".mcap"); }

/// Control steps from one cloud to the next; 0 = no clouds.
std::size_t cloud_stride(const SimulateOptions& options, double period) {
  if (options.cloud_rate_hz == 0) return 0;
  return static_cast<std::size_t>(std::max(1.0, std::round(1 / period / options.cloud_rate_hz)));
}

/// Of several recordings at a time; a line is never torn, a warning told once.
class Reports {
 public:
  void print(const std::string& line) {
    const std::lock_guard lock(mutex_);
    std::printf("%s\n", line.c_str());
  }
  void warn(const std::vector<std::string>& warnings) {
    const std::lock_guard lock(mutex_);
    for (const std::string& warning : warnings) {
      if (told_.insert(warning).second) std::fprintf(stderr, "warning: %s\n", warning.c_str());
    }
  }
  void tell(const std::string& line) {
    const std::lock_guard lock(mutex_);
    std::fprintf(stderr, "mismatch: %s\n", line.c_str());
  }
  void failed(const std::string& line) {
    tell(line);
    any_failed_ = true;
  }
  bool any_failed() const { return any_failed_; }

 private:
  std::mutex mutex_;
  std::set<std::string> told_;
  std::atomic<bool> any_failed_{false};
};

/// The scene of the options.
pb::Scene make_config(const SimulateOptions& options) {
  pb::Scene config = load_scene(options.scene, options.overrides);
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

/// Control steps of a recording [s]: as it was commanded, else of the task.
double find_period(const SimulateOptions& options, const std::string& commands,
                   const pb::RecordingInfo& info) {
  constexpr double kMin = 10, kMax = 1000;  // [Hz]
  if (options.rate_hz > 0) return 1 / options.rate_hz;
  if (!info.has_tool_rate_hz()) return kScenePeriod;
  const double rate = info.tool_rate_hz();
  if (rate < kMin || rate > kMax)
    throw_error("{}: tool_rate_hz of recording.txtpb: {} Hz, allowed {} ... {}, or give --rate",
                commands, rate, kMin, kMax);
  return 1 / rate;
}

/// As long substeps as the scene has in its control step.
void scale_substeps(double share, pb::Tissue& tissue) {
  const auto scaled = [&](std::uint32_t substeps) {
    return static_cast<std::uint32_t>(std::max(1.0, std::round(share * substeps)));
  };
  tissue.mutable_cluster()->set_substeps(scaled(tissue.cluster().substeps()));
  tissue.mutable_elastic()->set_substeps(scaled(tissue.elastic().substeps()));
  tissue.mutable_reference()->set_substeps(scaled(tissue.reference().substeps()));
}

SimulationTask make_task(const SimulateOptions& options, const std::string& commands,
                         Reports& reports) {
  SimulationTask task;
  const Recording recording = read_recording(commands);
  task.period = find_period(options, commands, recording.info);
  if (options.cloud_rate_hz * task.period > 1 + 1e-9)
    throw_error("--cloud-rate: {} Hz, allowed 0 ... {:.6g} (the control rate)",
                options.cloud_rate_hz, 1 / task.period);
  task.scene = make_config(options);
  if (!task.scene.has_camera() && options.cloud_rate_hz > 0)
    throw_error("scene.camera: missing, clouds need it; allowed without: --cloud-rate 0");
  scale_substeps(task.period / kScenePeriod, *task.scene.mutable_tissue());
  task.folder = fs::path(options.scene).parent_path().string();
  const Scene scene = make_scene(task.scene, task.folder);
  std::vector<std::string> warnings = recording.warnings;
  task.commands = tool_track_of(recording, commands, scene_tool_mount(scene), warnings);
  check_reach(task.commands, scene, warnings);
  reports.warn(warnings);
  const pb::Grip& grip = task.scene.tool().grip();
  if (options.patch_radius_m && grip.shape() == pb::GRIP_RECTANGLE)
    throw_error(
        "--patch-radius: {} m with scene.tool.grip.shape GRIP_RECTANGLE, allowed: GRIP_DISC",
        *options.patch_radius_m);
  task.grasp = options.grasp;
  task.grasp.patch_radius_m = options.patch_radius_m.value_or(
      grip.shape() == pb::GRIP_RECTANGLE ? std::max(grip.half_x_m(), grip.half_y_m())
                                         : grip.half_x_m());
  task.parameters = options.columns;
  // What is wrong with them is told before anything is made.
  if (!options.columns.empty()) parse_parameters(options.columns, task.scene);
  task.stride = std::max<std::size_t>(1, cloud_stride(options, task.period));
  task.from_rest = !options.no_settle;
  task.estimate_error = true;
  return task;
}

pb::RecordingInfo info_of(const Scene& scene, const SimulateOptions& options, double rate_hz,
                          const std::string& output) {
  pb::RecordingInfo info;
  info.set_name((is_mcap(output) ? fs::path(output).stem() : fs::path(output).filename()).string());
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

/// What the depth camera of the scene sees at a control step.
std::vector<Eigen::Vector3f> cloud_at(std::size_t step, Camera& camera, const ToolTrack& commands,
                                      const Simulation& simulation, std::uint64_t seed) {
  const pb::DepthSensor& sensor = simulation.scene.config.depth_sensor();
  const double t = simulation.recording.time[step] - sensor.time_offset_s();
  const SeenState seen = seen_at(simulation.recording, t);
  ToolPose tool;
  tool.p_WT = seen.tip;
  tool.jaw_rad = commands.jaw_rad.empty() ? 0 : commands.jaw_at(t);
  CameraFrame frame{seen.surface, tool, {}};
  if (simulation.reference) {  // two faces
    frame.lower_face_W = frame.tissue_vertices_W.last(seen.surface.size() / 2);
    frame.tissue_vertices_W = frame.tissue_vertices_W.first(seen.surface.size() / 2);
  }
  return sense_cloud(camera, frame, sensor, seed, static_cast<std::uint32_t>(step));
}

void describe(const Simulation& simulation, const std::string& output, Reports& reports) {
  const SimulatedRecording& recording = simulation.recording;
  double largest = 0;
  for (const Eigen::Vector3d& f : recording.force) largest = std::max(largest, f.norm());
  reports.print(fmt::format("{}: {} steps, {} nodes, largest force {:.4f} N", output,
                            recording.time.size() - 1, recording.points.front().size(), largest));
  if (simulation.column_frames > 0)
    reports.print(fmt::format("{}: columns.npz, {} frames", output, simulation.column_frames));
  if (const auto& error = simulation.mesh_error) {
    reports.print(fmt::format(
        "{}: mesh {} x {} x {}, discretisation error about {:.4f} mm rms, {:.4f} mm at the worst "
        "time, {:.2f} % of force",
        output, simulation.cells[0], simulation.cells[1], simulation.cells[2], 1e3 * error->rms_m,
        1e3 * error->worst_rms_m, 100 * error->force));
  }
}

/// Clouds and files of a simulation; into the folder, or into the file where there is none.
void write_output(const SimulateOptions& options, const SimulationTask& task,
                  const Simulation& simulation, OutputFolder* folder, const std::string& output) {
  std::unique_ptr<Camera> camera;
  const std::size_t stride = cloud_stride(options, task.period);
  if (stride > 0) camera = std::make_unique<Camera>(simulation.scene, 64, 64);
  pb::RecordingInfo info = info_of(simulation.scene, options, 1 / task.period, output);
  if (const std::string& failure = simulation.recording.failure; !failure.empty())
    info.set_incomplete(failure);
  const Recording recording = make_recording(
      info, task.commands, simulation.recording,
      [&](std::size_t step) {
        return cloud_at(step, *camera, task.commands, simulation, options.seed);
      },
      stride);
  if (folder != nullptr) {
    write_recording_files(recording, *folder);
    folder->finish();
  } else {
    write_recording_mcap(recording, output);
  }
}

/// One recording, from commands to a finished folder or file.
void simulate_one(const SimulateOptions& options, const std::string& commands,
                  const std::string& output, Simulator& simulator, Reports& reports) {
  SimulationTask task = make_task(options, commands, reports);
  std::optional<OutputFolder> folder;
  if (!is_mcap(output)) {
    folder.emplace(output);
    folder->begin();
    task.columns_folder = folder->path().string();
  } else if (!task.parameters.empty()) {
    throw_error("--columns: they need a folder, not {}", output);
  }
  Simulation simulation = simulator.simulate(task);
  for (auto* warnings : {&simulation.scene.warnings, &simulation.model_warnings}) {
    for (std::string& warning : *warnings) warning = with_place(options.scene, warning);
    reports.warn(*warnings);
  }
  reports.warn(simulation.warnings);
  simulator.work_here(
      [&] { write_output(options, task, simulation, folder ? &*folder : nullptr, output); });
  describe(simulation, output, reports);
  if (const std::string& failure = simulation.recording.failure; !failure.empty())
    reports.failed(fmt::format("{}; what there is up to there is in {}", failure, output));
}

/// Where each recording goes: the output itself for one, else folders in it.
std::vector<std::string> outputs_of(const SimulateOptions& options) {
  if (options.commands.size() == 1) return {options.output};
  std::vector<std::string> outputs;
  std::set<std::string> names;
  for (const std::string& commands : options.commands) {
    const fs::path path = fs::path(commands).lexically_normal();
    const std::string name = (is_mcap(commands) ? path.stem() : path.filename()).string();
    if (name.empty() || !names.insert(name).second)
      throw_error("--commands: {} has no name of its own, allowed: folders of different names",
                  commands);
    outputs.push_back((fs::path(options.output) / name).string());
  }
  std::error_code error;
  fs::create_directories(options.output, error);
  if (error) throw_error("--output: {}: {}", options.output, error.message());
  return outputs;
}

int simulate_folders(const SimulateOptions& options) {
  const std::vector<std::string> outputs = outputs_of(options);
  Reports reports;
  SimulatorOptions where = options.simulator;
  where.build_id = build_id();
  Simulator simulator(options.threads, where,
                      [&reports](const std::string& line) { reports.tell(line); });
  run_parallel(outputs.size(), simulator.at_once(), [&](std::size_t k) {
    try {
      simulate_one(options, options.commands[k], outputs[k], simulator, reports);
    } catch (const Error& error) {
      throw_error("{}", with_place(options.scene, error.what()));
    }
  });
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  return reports.any_failed() ? 1 : 0;
}

}  // namespace

std::function<int()> add_simulate_command(CLI::App& app) {
  const auto made = std::make_shared<SimulateOptions>();
  SimulateOptions& options = *made;
  CLI::App& sub = *app.add_subcommand("simulate",
                                      "Simulate a scene under the tool commands of recordings and "
                                      "write what recordings of it would hold (docs/formats.md 3)");
  sub.add_option("--scene", options.scene, "Scene file (deploy/scenes/*.txtpb)")->required();
  sub.add_option("--commands", options.commands,
                 "Recordings whose tool commands are simulated: folders or MCAP files")
      ->required();
  sub.add_option("-o,--output", options.output,
                 "Folder to write, new or empty, or X.mcap; for several recordings a folder that "
                 "gets a folder of the name of each")
      ->required();
  sub.add_option("--model", options.model, "Tissue model instead of the scene's")
      ->check(CLI::IsMember({"cluster", "elastic", "reference"}));
  sub.add_option(
      "--set", options.overrides,
      "Override a knob of the scene, a.b=c, as scene.tissue.material.young_modulus_pa=5000");
  sub.add_option(
         "--patch-radius", options.patch_radius_m,
         "Distance from the tip within which tissue is held [m]; default: scene.tool.grip.half_x_m")
      ->check(number_between(1e-4, 0.05));
  sub.add_option("--tolerance-mm", options.tolerance_mm,
                 "Root mean square error of the surface that the mesh of model reference is made "
                 "for [mm]; default: the scene's")
      ->check(number_between(1e-3, 10));
  sub.add_option(
      "--columns", options.columns,
      "Write derivatives by these parameters to columns.npz as well: all, sites (stiffness, "
      "density and force on a grid of places), or names of the list below, separated by commas");
  sub.footer("Parameters of --columns, their units and settings (name@key=value:key=value):\n" +
             describe_parameters());
  sub.add_option("--closed", options.grasp.closed_rad,
                 "Angle of the jaw at or below which it holds tissue [rad]")
      ->check(number_between(0, 3.2))
      ->capture_default_str();
  sub.add_option("--rate", options.rate_hz,
                 "Control steps per second [Hz]; default: tool_rate_hz of recording.txtpb, else 50")
      ->check(number_between(10, 1000));
  sub.add_option("--cloud-rate", options.cloud_rate_hz, "Point clouds per second [Hz]; 0: none")
      ->check(number_between(0, 1000))
      ->capture_default_str();
  sub.add_flag("--no-settle", options.no_settle,
               "Begin with the shape that the scene states instead of at rest under gravity");
  sub.add_option("--seed", options.seed, "Seed of the noise of the simulated depth camera")
      ->check(whole_number())
      ->capture_default_str();
  sub.add_option("--threads", options.threads,
                 "Number of recordings that are simulated at a time; results do not depend on it")
      ->check(number_between(1, 1024))
      ->capture_default_str();
  add_simulator_options(sub, options.simulator);
  return [made] { return simulate_folders(*made); };
}

}  // namespace omentum
