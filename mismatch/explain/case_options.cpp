#include "mismatch/explain/case_options.h"

#include "core/build_id.h"
#include "core/check.h"
#include "core/command_line.h"
#include "mismatch/seen/cloud_mask.h"

namespace omentum {

void add_case_options(CLI::App& command, CaseOptions& options) {
  command.add_option("--scene", options.scene,
                     "Scene (.txtpb) or scene_believed.txt; default: what the recordings say");
  command
      .add_option("-r,--recordings", options.recordings,
                  "Recordings: folders, MCAP files, or folders of them")
      ->required();
  command.add_option(
      "--set", options.overrides,
      "Override a knob of the scene, a.b=c, as scene.tissue.material.young_modulus_pa=5000");
  command.add_option("--rule-out", options.ruled_out,
                     "Name of an effect that is known to be absent");
  command
      .add_option("--tolerance-mm", options.tolerance_mm,
                  "Root mean square error of the surface that the fine mesh is made for [mm]")
      ->check(number_between(0.05, 10))
      ->capture_default_str();
  command
      .add_option("--coarse-mm", options.coarse_mm,
                  "The same for the coarse mesh, that of the search and of derivatives [mm]")
      ->check(number_between(0.1, 20))
      ->capture_default_str();
  command.add_option("--seed", options.seed, "Seed of random numbers")
      ->check(whole_number())
      ->capture_default_str();
  command
      .add_option("--threads", options.threads, "Number of threads; results do not depend on it")
      ->check(number_between(1, 256))
      ->capture_default_str();
  add_simulator_options(command, options.simulator);
}

ExplainOptions explain_options(const CaseOptions& options, const CaseInput& input,
                               const std::shared_ptr<ProgressLine>& line) {
  ExplainOptions chosen;
  chosen.priors = input.priors;
  chosen.folder = input.folder;
  chosen.threads = options.threads;
  chosen.seed = options.seed;
  chosen.tolerance_m = 1e-3 * options.tolerance_mm;
  chosen.coarse_tolerance_m = 1e-3 * options.coarse_mm;
  chosen.ruled_out = options.ruled_out;
  SimulatorOptions where = options.simulator;
  where.build_id = build_id();
  const auto simulator = std::make_shared<Simulator>(
      options.threads, where, [line](const std::string& text) { line->tell(text); });
  chosen.simulator = simulator;
  chosen.progress = [line, simulator](double share, const std::string& stage) {
    line->show(share, stage, simulator->describe());
  };
  return chosen;
}

void check_is_clamped_sheet(const std::string& program, const CaseInput& input, const Scene& made) {
  if (!input.scene.tissue().has_grid()) {
    throw_error("{}: the scene's tissue is no sheet (scene.tissue.grid); the only kind so far",
                program);
  }
  if (lies_free(made)) {
    throw_error("{}: no clamp holds the sheet (scene.tissue.anchor_max_y_m): use calibrate",
                program);
  }
}

}  // namespace omentum
