#include "mismatch/scene/scene_program.h"

#include <google/protobuf/text_format.h>

#include <cstdio>
#include <filesystem>
#include <memory>

#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/durable_file.h"
#include "core/file_name.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/read_recording.h"
#include "mismatch/recording/text_table.h"
#include "mismatch/scene/believed_scene.h"
#include "mismatch/scene/rest_cloud.h"
#include "sim_worker/scene/scene.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

struct SceneOptions {
  std::string input, output;
  double board_mm = 0, thickness_mm = 0, clamp_mm = 3;
  std::vector<double> fixed = {0, -1};
};

void write_text(const std::string& path, const google::protobuf::Message& message) {
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(message, &text));
  if (const Result<void> written = write_durably(path, text); !written)
    throw_error("{}", written.error());
}

Cloud rest_cloud(const std::string& path, std::vector<std::string>& warnings) {
  if (has_ending(path, ".ply") || has_ending(path, ".pcd")) {
    Cloud cloud = read_cloud_file(path, &warnings);
    if (cloud.empty()) throw_error("{}: no point that is finite", path);
    return cloud;
  }
  const Recording recording = read_recording(path);
  const Frames<Cloud> clouds = seen_clouds(recording);
  if (clouds.size() == 0) throw_error("{}: no cloud, needed one of the body at rest", path);
  return clouds.fetch(0);
}

int make(const SceneOptions& options) {
  if (!options.output.ends_with(".txtpb"))
    throw_error("-o: {}, allowed a name that ends in .txtpb", options.output);
  pb::Scene scene;
  pb::Priors priors;
  std::vector<std::string> warnings;
  bool sheet = true;
  if (options.input.ends_with(".txt")) {
    const Result<BelievedScene> made =
        parse_believed_scene(options.input, read_whole_file(options.input));
    if (!made) throw_error("{}", made.error());
    scene = made.value().scene;
    priors = made.value().priors;
    warnings = made.value().warnings;
    sheet = made.value().kind == SetUp::kSheet || made.value().kind == SetUp::kSolid;
  } else {
    RestCloudSettings settings;
    settings.board_z = 1e-3 * options.board_mm;
    settings.thickness = 1e-3 * options.thickness_mm;
    settings.clamp = 1e-3 * options.clamp_mm;
    settings.fixed = {options.fixed[0], options.fixed[1]};
    if (!(settings.fixed.norm() > 0)) throw_error("--fixed: 0 0, allowed a direction");
    RestScene made = scene_of_cloud(fs::path(options.input).stem().string(),
                                    rest_cloud(options.input, warnings), settings);
    scene = made.scene;
    priors = made.priors;
    warnings.insert(warnings.end(), made.warnings.begin(), made.warnings.end());
  }
  if (sheet) {  // what is written can be simulated
    const Scene whole =
        make_scene(override_scene(scene, {}), fs::path(options.input).parent_path().string());
    warnings.insert(warnings.end(), whole.warnings.begin(), whole.warnings.end());
  }
  write_text(options.output, scene);
  if (priors.prior_size() > 0)
    write_text(fs::path(options.output).replace_extension(".prior.txtpb").string(), priors);
  for (const std::string& warning : warnings)
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
  const pb::Tissue& tissue = scene.tissue();
  if (sheet && tissue.has_grid()) {
    std::printf("%s: %.1f x %.1f x %.2f mm, %u x %u particles\n", options.output.c_str(),
                1e3 * (tissue.grid().count_x() - 1) * tissue.grid().pitch_m(),
                1e3 * (tissue.grid().count_y() - 1) * tissue.grid().pitch_m(),
                1e3 * tissue.thickness_m(), tissue.grid().count_x(), tissue.grid().count_y());
  }
  return 0;
}

}  // namespace

std::function<int()> add_scene_command(CLI::App& app) {
  const auto made = std::make_shared<SceneOptions>();
  SceneOptions& options = *made;
  CLI::App& sub = *app.add_subcommand("scene",
                                      "Make a scene from a point cloud of the body at rest, or "
                                      "from scene_believed.txt (docs/calibrate.md 7)");
  sub.add_option("input", options.input,
                 "Point cloud (.ply, .pcd), recording whose first cloud shows the body at rest, or "
                 "scene_believed.txt")
      ->required();
  sub.add_option(
         "-o,--output", options.output,
         "NAME.txtpb to write; NAME.prior.txtpb beside it gets the uncertainty of its numbers")
      ->required();
  sub.add_option("--board-mm", options.board_mm, "Height of the board in the world frame W [mm]")
      ->check(number_between(-1e4, 1e4))
      ->capture_default_str();
  sub.add_option("--thickness-mm", options.thickness_mm,
                 "Thickness of the body [mm]; 0: the height of the cloud above the board")
      ->check(number_between(0, 500))
      ->capture_default_str();
  sub.add_option("--clamp-mm", options.clamp_mm,
                 "Width of the strip of the body that is clamped [mm]")
      ->check(number_between(0, 500))
      ->capture_default_str();
  sub.add_option(
         "--fixed", options.fixed,
         "Direction from the middle of the body to its clamped edge: x and y in the world frame W")
      ->expected(2)
      ->check(number_between(-1e3, 1e3));
  return [made] { return make(*made); };
}

}  // namespace omentum
