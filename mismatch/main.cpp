// mismatch: where simulation and recordings differ. So far: simulate recorded commands.

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <new>

#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "mismatch/recording_folder.h"
#include "mismatch/recording_info.h"
#include "mismatch/simulate.h"
#include "sim_worker/camera/depth_sensor.h"
#include "sim_worker/models.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

struct SimulateOptions {
  std::string scene, commands, output, model;
  std::vector<std::string> overrides;
  GraspSettings grasp;
  double cloud_rate_hz = 10;
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

/// A scene, the models made of it, and what is odd about them.
struct Setup {
  Scene scene;
  std::shared_ptr<const TissueModel> model;
  std::shared_ptr<const Arm> arm;
};

Setup make_setup(const SimulateOptions& options) {
  pb::Scene config = load_scene(options.scene, options.overrides);
  if (!options.model.empty()) {
    config.mutable_tissue()->set_model(options.model == "cluster"   ? pb::TISSUE_CLUSTER
                                       : options.model == "elastic" ? pb::TISSUE_ELASTIC
                                                                    : pb::TISSUE_REFERENCE);
  }
  try {
    Setup made;
    made.scene = make_scene(config, std::filesystem::path(options.scene).parent_path().string());
    made.model = make_tissue_model(made.scene, kControlPeriod, made.scene.warnings);
    made.arm = std::make_shared<Arm>(config.arm(), scene_tool_mount(made.scene), kControlPeriod);
    for (std::string& warning : made.scene.warnings) warning = with_place(options.scene, warning);
    return made;
  } catch (const Error& error) {
    throw_error("{}", with_place(options.scene, error.what()));
  }
}

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

int simulate(const SimulateOptions& options) {
  const auto [scene, model, arm] = make_setup(options);
  warn(scene.warnings);
  const ToolTrack track = load_commands(options, scene);
  OutputFolder folder(options.output);
  SimulatedRecording recording = simulate_recording(*model, *arm, track, options.grasp);
  recording.clocks = scene.config.clocks();
  if (recording.missed_grasps > 0) {
    warn({fmt::format("{}: the jaw closed {} times and held nothing", track.path,
                      recording.missed_grasps)});
  }
  std::unique_ptr<Camera> camera;
  if (options.cloud_rate_hz > 0) camera = std::make_unique<Camera>(scene, 64, 64);
  const CloudOf cloud = [&](std::size_t step) {
    const double t = recording.time[step] - scene.config.depth_sensor().time_offset_s();
    const SeenState seen = seen_at(recording, t);
    ToolPose tool;
    tool.p_WT = seen.tip;
    tool.jaw_rad = track.jaw_rad.empty() ? 0 : track.jaw_at(t);
    return sense_cloud(*camera, {seen.surface, tool}, scene.config.depth_sensor(), options.seed,
                       static_cast<std::uint32_t>(step));
  };
  const auto stride = static_cast<std::size_t>(
      options.cloud_rate_hz > 0
          ? std::max(1.0, std::round(1 / kControlPeriod / options.cloud_rate_hz))
          : 0);
  write_recording(folder, info_of(scene, options, 1 / kControlPeriod), track, recording, cloud,
                  stride);
  double largest = 0;
  for (const Eigen::Vector3d& f : recording.force) largest = std::max(largest, f.norm());
  std::printf("%s: %zu steps, %zu nodes, largest force %.4f N\n", options.output.c_str(),
              recording.time.size() - 1, recording.points.front().size(), largest);
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
  sub.add_option("--patch-radius", options.grasp.patch_radius_m,
                 "Tissue this near the tip is held [m]")
      ->check(number_between(1e-4, 0.05))
      ->capture_default_str();
  sub.add_option("--closed", options.grasp.closed_rad, "The jaw holds at or below this angle [rad]")
      ->check(number_between(0, 3.2))
      ->capture_default_str();
  sub.add_option("--cloud-rate", options.cloud_rate_hz, "Clouds per second; 0 = none [Hz]")
      ->check(number_between(0, 50))
      ->capture_default_str();
  sub.add_option("--seed", options.seed, "Seed of the depth sensor")
      ->check(whole_number())
      ->capture_default_str();
  app.footer("Exit codes: 0 done, 2 wrong input, or the output cannot be written.");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  return simulate(options);
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
