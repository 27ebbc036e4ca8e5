#include "mismatch/explain/explain_program.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <cstdio>
#include <memory>

#include "core/build_id.h"
#include "core/check.h"
#include "core/hash.h"
#include "core/output_folder.h"
#include "mismatch/explain/case_notes.h"
#include "mismatch/explain/case_options.h"
#include "mismatch/explain/explain.h"
#include "mismatch/explain/predictions_file.h"
#include "mismatch/explain/verdict_file.h"
#include "mismatch/explain/visited.h"

namespace omentum {
namespace {

struct ProgramOptions : CaseOptions {
  std::string output;
  std::vector<std::string> held_out;
};

std::string sha256_hex(const std::string& bytes) {
  return hex(sha256(std::as_bytes(std::span(bytes))));
}

std::string print_scene(const pb::Scene& scene) {
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(scene, &text));
  return text;
}

/// What of a recording can be read, for the record: its channels and the points of its frames. A
/// frame that cannot is none that was looked at, and told.
std::string fingerprint(const Recording& recording, pb::Verdict& verdict) {
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
    try {
      const Cloud cloud = recording.clouds.fetch(k);
      for (const Eigen::Vector3f& p : cloud) add(p.data(), 3 * sizeof(float));
    } catch (const Error& error) {
      verdict.add_warnings(fmt::format("{}: nothing looked at this cloud", error.what()));
    }
  }
  return sha256_hex(bytes);
}

int run_explain(const ProgramOptions& options) {
  OutputFolder folder(options.output);
  CaseInput input = read_case(options.recordings, options.scene, options.overrides);
  hold_out(options.held_out, input);
  const Scene made = make_scene(input.scene, input.folder);
  check_is_clamped_sheet("explain", input, made);
  std::size_t told = 0;
  tell_warnings(input.warnings, told);
  const auto line = std::make_shared<ProgressLine>("explain");
  ExplainOptions chosen = explain_options(options, input, line);
  std::vector<Observation> observations =
      observe_case(input, made, {}, chosen.markers, input.warnings);
  for (const Observation& o : observations)
    std::printf("%s:\n%s", o.name.c_str(), print_seen({o.clouds, o.parts, o.share_seen}).c_str());
  drop_frames_without_commands(observations, input.warnings);
  if (observations.empty())
    throw_error("explain: no recording has a frame that its commands lead to");
  const std::vector<std::string> notes = case_notes(observations);
  input.warnings.insert(input.warnings.end(), notes.begin(), notes.end());
  tell_warnings(input.warnings, told);
  pb::Verdict visited;
  add_visited(observations, visited);
  Explanation found = explain(input.scene, std::move(observations), chosen);
  line->end();
  pb::Verdict& verdict = found.verdict;
  verdict.mutable_visited()->Swap(visited.mutable_visited());
  verdict.set_tool_revision(fmt::format("{:016x}", build_id()));
  verdict.set_scene_hash(sha256_hex(input.scene.SerializeAsString()));
  for (pb::VerdictRecording& row : *verdict.mutable_recordings()) {
    for (const auto& [name, recording] : input.recordings) {
      if (name == row.id()) row.set_sha256(fingerprint(recording, verdict));
    }
  }
  for (const std::string& warning : verdict.warnings())
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
  for (const std::string& warning : input.warnings) verdict.add_warnings(warning);
  // It is said before it is written: the disk may be full.
  std::printf("%s\n", verdict_sentence(verdict).c_str());
  std::fflush(stdout);
  folder.begin();
  folder.write("verdict.json", print_verdict(verdict));
  folder.write("scene.repaired.txtpb", print_scene(found.scene));
  folder.write("scene.base.txtpb", print_scene(found.base_scene));
  folder.write("report.html", make_verdict_page(found, chosen.folder));
  write_predictions(found.predictions, found.uv_B, input.scene, folder.path() / "predictions");
  folder.finish();
  std::printf(
      "%s: verdict.json, scene.repaired.txtpb, scene.base.txtpb, report.html, predictions; %.0f "
      "core-seconds\n",
      options.output.c_str(), verdict.core_seconds());
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  return 0;
}

}  // namespace

std::function<int()> add_explain_command(CLI::App& app) {
  const auto made = std::make_shared<ProgramOptions>();
  ProgramOptions& options = *made;
  CLI::App& sub = *app.add_subcommand("explain",
                                      "Say where recordings and simulation differ and which "
                                      "physics the simulation leaves out (docs/mismatch.md 5)");
  add_case_options(sub, options);
  sub.add_option("--held-out", options.held_out,
                 "Name of a recording that confirms and is not fitted, or NAME* for those whose "
                 "names begin with NAME; recordings that say so themselves are held out as well");
  sub.add_option("-o,--output", options.output,
                 "Folder for verdict.json, scene.repaired.txtpb, scene.base.txtpb, report.html, "
                 "predictions; new or empty")
      ->required();
  return [made] { return run_explain(*made); };
}

}  // namespace omentum
