#include "mismatch/explain/predict_program.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <thread>

#include "core/build_id.h"
#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/output_folder.h"
#include "mismatch/calibrate/case_input.h"
#include "mismatch/explain/predict.h"
#include "mismatch/explain/predictions_file.h"
#include "mismatch/explain/verdict_file.h"
#include "mismatch/explain/visited.h"
#include "mismatch/seen/commanded.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

struct PredictOptions {
  std::string verdict, output;
  std::vector<std::string> recordings;
  double tolerance_mm = 0.6;
  std::size_t threads = std::max(1U, std::thread::hardware_concurrency());
  SimulatorOptions simulator;
};

/// Times of the clouds [s], else every 50 ms of the commands.
std::vector<double> times_of(const Recording& recording, const ToolTrack& track) {
  constexpr double kApart = 0.05;  // [s]
  std::vector<double> times;
  for (const auto* clouds : {&recording.clouds.time_ns, &recording.depth.time_ns}) {
    if (!times.empty()) continue;
    for (const std::int64_t t : *clouds) times.push_back(1e-9 * static_cast<double>(t));
  }
  if (!times.empty()) return times;
  const auto count = static_cast<std::size_t>((track.end() - track.begin()) / kApart + 1e-6);
  for (std::size_t k = 0; k <= count; ++k)
    times.push_back(track.begin() + kApart * static_cast<double>(k));
  return times;
}

std::vector<Observation> observations_of(const CaseInput& input, const Scene& scene,
                                         std::vector<std::string>& warnings) {
  std::vector<Observation> observations;
  for (const auto& [name, recording] : input.recordings) {
    std::vector<std::string> told;  // once, with the times
    const Observation whole = observe_commands(name, name, recording, scene, {}, told);
    observations.push_back(
        observe_commands(name, name, recording, scene, times_of(recording, whole.track), warnings));
    warnings.insert(warnings.end(), recording.warnings.begin(), recording.warnings.end());
  }
  std::ranges::sort(observations, {}, &Observation::name);
  return observations;
}

/// A line on one recording.
void tell(const Observation& seen, const PredictedRecording& made, const std::string& failure,
          const pb::Verdict& verdict) {
  const std::vector<std::string> beyond = beyond_visited(seen, verdict);
  const std::string where = verdict.visited_size() == 0 ? "what was visited is not known"
                            : !seen.pinched             ? "nothing is held"
                            : beyond.empty()
                                ? "within what was fitted"
                                : fmt::format("extrapolated: {}", fmt::join(beyond, "; "));
  std::printf("%s: %zu frames, %s\n", seen.name.c_str(), made.times.size(), where.c_str());
  if (!failure.empty())
    std::fprintf(stderr, "mismatch: %s: %s; what there is up to there is written\n",
                 seen.name.c_str(), failure.c_str());
}

int run_predict(const PredictOptions& options) {
  OutputFolder folder(options.output);
  const pb::Verdict verdict = read_verdict(options.verdict);
  const fs::path found = options.verdict;
  CaseInput input = read_case(options.recordings, (found / "scene.repaired.txtpb").string(), {});
  const pb::Scene base = load_scene((found / "scene.base.txtpb").string(), {});
  if (!input.scene.tissue().has_grid())
    throw_error(
        "predict: the scene's tissue is no sheet (scene.tissue.grid); the only kind so far");
  const Scene scene = make_scene(input.scene, input.folder);
  const std::vector<Observation> observations = observations_of(input, scene, input.warnings);
  SimulatorOptions where = options.simulator;
  where.build_id = build_id();
  FitSetup setup;
  setup.folder = input.folder;
  setup.threads = options.threads;
  setup.simulator = std::make_shared<Simulator>(
      options.threads, where,
      [](const std::string& text) { std::fprintf(stderr, "mismatch: %s\n", text.c_str()); });
  const Foretold made =
      predict_commands(base, input.scene, observations, setup, 1e-3 * options.tolerance_mm);
  folder.begin();
  write_predictions(made.recordings, made.uv_B, input.scene, folder.path() / "predictions");
  folder.finish();
  for (const std::string& warning : input.warnings)
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
  for (std::size_t r = 0; r < observations.size(); ++r)
    tell(observations[r], made.recordings[r], made.failures[r], verdict);
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  const bool whole = std::ranges::all_of(made.failures, &std::string::empty);
  return whole ? 0 : 1;
}

}  // namespace

std::function<int()> add_predict_command(CLI::App& app) {
  const auto made = std::make_shared<PredictOptions>();
  PredictOptions& options = *made;
  CLI::App& sub =
      *app.add_subcommand("predict",
                          "Predict with a stored verdict what other commands would do "
                          "(docs/mismatch.md 5.8); of the recordings only the tool commands "
                          "and the times of clouds are read");
  sub.add_option("OUT", options.verdict, "Folder that mismatch explain wrote")->required();
  sub.add_option("-r,--recordings", options.recordings,
                 "Recordings whose commands are simulated: folders, MCAP files, or folders of them")
      ->required();
  sub.add_option("-o,--output", options.output,
                 "Folder for predictions/NAME.npz, new or empty: without and with the effect that "
                 "the verdict names")
      ->required();
  sub.add_option("--tolerance-mm", options.tolerance_mm,
                 "Root mean square error of the surface that the mesh is made for [mm]")
      ->check(number_between(0.05, 10))
      ->capture_default_str();
  sub.add_option("--threads", options.threads, "Number of threads; results do not depend on it")
      ->check(number_between(1, 256))
      ->capture_default_str();
  add_simulator_options(sub, options.simulator);
  return [made] { return run_predict(*made); };
}

}  // namespace omentum
