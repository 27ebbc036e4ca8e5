#include "mismatch/explain/explain_program.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <cstdio>
#include <filesystem>
#include <memory>
#include <thread>

#include "core/build_id.h"
#include "core/check.h"
#include "core/hash.h"
#include "core/output_folder.h"
#include "mismatch/calibrate/case_input.h"
#include "mismatch/explain/explain.h"
#include "mismatch/explain/verdict_file.h"
#include "sim_worker/playback/npz.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

struct ProgramOptions {
  std::string scene, output;
  std::vector<std::string> recordings, overrides, ruled_out;
  double tolerance_mm = 0.6, coarse_mm = 2;
  std::uint64_t seed = 1;
  std::size_t threads = std::max(1U, std::thread::hardware_concurrency());
  SimulatorOptions simulator;
};

std::string sha256_hex(const std::string& bytes) {
  return hex(sha256(std::as_bytes(std::span(bytes))));
}

void write_predictions(const Explanation& found, const pb::Scene& scene, const fs::path& folder) {
  fs::create_directories(folder);
  const std::size_t n = scene.tissue().grid().count_x(), m = scene.tissue().grid().count_y();
  std::vector<double> uv;
  for (const Eigen::Vector2d& p : found.uv_B) uv.insert(uv.end(), {p.x(), p.y()});
  for (const PredictedRecording& recording : found.predictions) {
    NpzFile file;
    file.add("t_s", {recording.times.size()}, recording.times);
    file.add("uv_B", {n, m, 2}, uv);
    for (const auto& [name, surfaces] :
         {std::pair{"base", &recording.base}, {"model", &recording.model}}) {
      std::vector<double> values;
      for (const auto& surface : *surfaces) {
        for (const Eigen::Vector3d& p : surface) values.insert(values.end(), {p.x(), p.y(), p.z()});
      }
      file.add(name, {surfaces->size(), n, m, 3}, values);
    }
    file.write((folder / (recording.name + ".npz")).string());
  }
}

/// What of a recording was read, for the record: its channels and the times of its frames.
std::string fingerprint(const Recording& recording) {
  std::string bytes;
  const auto add = [&](const void* data, std::size_t size) {
    bytes.append(static_cast<const char*>(data), size);
  };
  for (const auto& [topic, series] : recording.series) {
    bytes += topic;
    add(series.time_ns.data(), series.time_ns.size() * sizeof(series.time_ns[0]));
    add(series.values.data(), series.values.size() * sizeof(double));
  }
  for (std::size_t k = 0; k < recording.clouds.size(); ++k) {
    const Cloud cloud = recording.clouds.fetch(k);
    for (const Eigen::Vector3f& p : cloud) add(p.data(), 3 * sizeof(float));
  }
  return sha256_hex(bytes);
}

int run_explain(const ProgramOptions& options) {
  OutputFolder folder(options.output);
  CaseInput input = read_case(options.recordings, options.scene, options.overrides);
  ExplainOptions chosen;
  chosen.priors = input.priors;
  chosen.folder = input.folder;
  chosen.threads = options.threads;
  chosen.seed = options.seed;
  chosen.tolerance_m = 1e-3 * options.tolerance_mm;
  chosen.coarse_tolerance_m = 1e-3 * options.coarse_mm;
  chosen.ruled_out = options.ruled_out;
  const Scene made = make_scene(input.scene, input.folder);
  if (!input.scene.tissue().has_grid())
    throw_error(
        "explain: the scene's tissue is no sheet (scene.tissue.grid); the only kind so far");
  if (lies_free(made))
    throw_error("explain: no clamp holds the sheet (scene.tissue.anchor_max_y_m): use calibrate");
  std::vector<Observation> observations =
      observe_case(input, made, {}, chosen.markers, input.warnings);
  for (const Observation& o : observations)
    std::printf("%s:\n%s", o.name.c_str(), print_seen({o.clouds, o.parts, o.share_seen}).c_str());
  const auto line = std::make_shared<ProgressLine>("explain");
  SimulatorOptions where = options.simulator;
  where.build_id = build_id();
  const auto simulator = std::make_shared<Simulator>(
      options.threads, where, [line](const std::string& text) { line->tell(text); });
  chosen.simulator = simulator;
  chosen.progress = [line, simulator](double share, const std::string& stage) {
    line->show(share, stage, simulator->describe());
  };
  Explanation found = explain(input.scene, std::move(observations), chosen);
  line->end();
  pb::Verdict& verdict = found.verdict;
  verdict.set_tool_revision(fmt::format("{:016x}", build_id()));
  verdict.set_scene_hash(sha256_hex(input.scene.SerializeAsString()));
  for (pb::VerdictRecording& row : *verdict.mutable_recordings()) {
    for (const auto& [name, recording] : input.recordings) {
      if (name == row.id()) row.set_sha256(fingerprint(recording));
    }
  }
  for (const std::string& warning : input.warnings) verdict.add_warnings(warning);
  folder.begin();
  folder.write("verdict.json", print_verdict(verdict));
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(found.scene, &text));
  folder.write("scene.repaired.txtpb", text);
  folder.write("report.html", make_verdict_page(found, chosen.folder));
  write_predictions(found, input.scene, folder.path() / "predictions");
  folder.finish();
  for (const std::string& warning : verdict.warnings())
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
  std::printf(
      "%s\n%s: verdict.json, scene.repaired.txtpb, report.html, predictions; %.0f core-seconds\n",
      verdict_sentence(verdict).c_str(), options.output.c_str(), verdict.core_seconds());
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  return 0;
}

}  // namespace

std::function<int()> add_explain_command(CLI::App& app) {
  const auto made = std::make_shared<ProgramOptions>();
  ProgramOptions& options = *made;
  CLI::App& sub =
      *app.add_subcommand("explain",
                          "Where recordings and simulation differ, and what physics was left out "
                          "(docs/mismatch.md 5)");
  sub.add_option("--scene", options.scene,
                 "Scene (.txtpb) or scene_believed.txt; default: what the recordings say");
  sub.add_option("-r,--recordings", options.recordings,
                 "Recordings: folders, MCAP files, or folders of them")
      ->required();
  sub.add_option("-o,--output", options.output,
                 "Folder for verdict.json, scene.repaired.txtpb, report.html, predictions; new or "
                 "empty")
      ->required();
  sub.add_option("--set", options.overrides, "Override of the scene, a.b=c (scene.tissue...)");
  sub.add_option("--rule-out", options.ruled_out, "Effect that is known not to be there, by name");
  sub.add_option("--tolerance-mm", options.tolerance_mm,
                 "Of the mesh of surfaces, rms error of the surface")
      ->check(CLI::Range(0.05, 10.0));
  sub.add_option("--coarse-mm", options.coarse_mm, "The same of the mesh of search and columns")
      ->check(CLI::Range(0.1, 20.0));
  sub.add_option("--seed", options.seed, "Recorded in the verdict");
  sub.add_option("--threads", options.threads, "Threads; the verdict does not depend on them")
      ->check(CLI::Range(std::size_t{1}, std::size_t{256}));
  add_simulator_options(sub, options.simulator);
  return [made] { return run_explain(*made); };
}

}  // namespace omentum
