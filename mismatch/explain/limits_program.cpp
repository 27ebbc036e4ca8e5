#include "mismatch/explain/limits_program.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>

#include "core/build_id.h"
#include "core/check.h"
#include "core/command_line.h"
#include "core/output_folder.h"
#include "mismatch/explain/case_options.h"
#include "mismatch/explain/planned_limits.h"
#include "mismatch/explain/verdict_file.h"
#include "mismatch/explain/verdict_text.h"
#include "mismatch/explain/visited.h"
#include "mismatch/seen/commanded.h"

namespace omentum {
namespace {

struct LimitsOptions : CaseOptions {
  std::string output;
  double rate_hz = 10, noise_mm = 0.8;
  std::size_t points = 400;
};

/// Frames of a camera of that rate, as many of them as explain would look at.
std::vector<double> frame_times(const ToolTrack& track, double rate_hz) {
  const auto count = static_cast<std::size_t>((track.end() - track.begin()) * rate_hz + 1e-6) + 1;
  std::vector<double> times;
  for (const std::size_t k : evenly_chosen(count, kMostFrames))
    times.push_back(track.begin() + static_cast<double>(k) / rate_hz);
  return times;
}

std::vector<Observation> planned(const LimitsOptions& options, CaseInput& input,
                                 const Scene& scene) {
  std::vector<Observation> observations;
  for (const auto& [name, recording] : input.recordings) {
    std::vector<std::string> told;  // once, with the times
    const Observation whole = observe_commands(name, name, recording, scene, {}, told);
    Observation seen = observe_commands(name, name, recording, scene,
                                        frame_times(whole.track, options.rate_hz), input.warnings);
    if (!seen.rays) {
      input.warnings.push_back(name + ": no camera is stated: one 1 m above the sheet");
      seen.rays = true;
    }
    input.warnings.insert(input.warnings.end(), recording.warnings.begin(),
                          recording.warnings.end());
    observations.push_back(std::move(seen));
  }
  std::ranges::sort(observations, {}, &Observation::name);
  number_conditions(observations);
  return observations;
}

int run_limits(const LimitsOptions& options) {
  std::optional<OutputFolder> folder;
  if (!options.output.empty()) folder.emplace(options.output);
  CaseInput input = read_case(options.recordings, options.scene, options.overrides);
  const Scene made = make_scene(input.scene, input.folder);
  check_is_clamped_sheet("limits", input, made);
  const auto line = std::make_shared<ProgressLine>("limits");
  const ExplainOptions chosen = explain_options(options, input, line);
  std::vector<Observation> observations = planned(options, input, made);
  pb::Verdict visited;
  add_visited(observations, visited);
  pb::Verdict limits = planned_limits(input.scene, std::move(observations), chosen,
                                      {1e-3 * options.noise_mm, options.points, options.seed});
  line->end();
  limits.mutable_visited()->Swap(visited.mutable_visited());
  limits.set_tool_revision(fmt::format("{:016x}", build_id()));
  for (const std::string& warning : input.warnings) limits.add_warnings(warning);
  for (const std::string& warning : limits.warnings())
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
  std::fputs(limits_text(limits).c_str(), stdout);
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  if (!folder) return 0;
  folder->begin();
  folder->write("limits.json", print_verdict(limits));
  folder->finish();
  return 0;
}

}  // namespace

std::function<int()> add_limits_command(CLI::App& app) {
  const auto made = std::make_shared<LimitsOptions>();
  LimitsOptions& options = *made;
  CLI::App& sub = *app.add_subcommand(
      "limits",
      "Say how large each effect must be to be detected with commands that were not run yet "
      "(docs/mismatch.md 5.9); only the tool commands of the recordings are read");
  add_case_options(sub, options);
  sub.add_option("-o,--output", options.output, "Folder for limits.json, new or empty");
  sub.add_option("--rate", options.rate_hz, "Point clouds per second [Hz]")
      ->check(number_between(0.1, 1000))
      ->capture_default_str();
  sub.add_option("--noise-mm", options.noise_mm,
                 "Standard deviation of a point along its camera ray [mm]")
      ->check(number_between(0.01, 20))
      ->capture_default_str();
  sub.add_option("--points", options.points, "Number of points of a cloud on the sheet, about")
      ->check(number_between(50, 1200))
      ->capture_default_str();
  return [made] { return run_limits(*made); };
}

}  // namespace omentum
