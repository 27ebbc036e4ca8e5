#include "mismatch/calibrate/calibrate_program.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/text_format.h>
#include <unistd.h>

#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "core/build_id.h"
#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/output_folder.h"
#include "mismatch/calibrate/calibration.h"
#include "mismatch/calibrate/calibration_file.h"
#include "mismatch/calibrate/calibration_page.h"
#include "mismatch/calibrate/case_input.h"
#include "mismatch/fit/unknowns.h"
#include "mismatch/recording/read_recording.h"
#include "mismatch/recording/text_table.h"
#include "mismatch/scene/believed_scene.h"
#include "mismatch/seen/cloud_mask.h"
#include "mismatch/seen/observation.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

struct CalibrateOptions {
  std::string scene, output, markers, method, frame_period;
  std::vector<std::string> recordings, overrides, own_overrides, held_out;
  double tolerance_mm = 0.3;
  std::size_t skipped_clouds = 0;
  std::optional<double> above_board_mm;
  bool no_leave_out = false, fused = false;
  std::uint64_t seed = 1;
  std::size_t threads = std::max(1U, std::thread::hardware_concurrency());
  SimulatorOptions simulator;
};

/// "0.3:0.1": a number and its standard deviation.
BelievedNumber parse_frame_period(const std::string& text) {
  const std::size_t colon = text.find(':');
  const auto number = [&](std::string_view part) {
    double value = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    const bool whole = error == std::errc() && end == part.data() + part.size();
    if (!whole || !(value > 0) || !std::isfinite(value)) {
      throw_error("--frame-period-s: {}, needed SECONDS:STANDARD_DEVIATION, both above 0", text);
    }
    return value;
  };
  const std::string_view all = text;
  if (colon == std::string::npos) return {number(all), number("")};
  return {number(all.substr(0, colon)), number(all.substr(colon + 1))};
}

/// The method that was stated; else that of the scene's body.
std::string method_of(const CalibrateOptions& options, const Scene& made) {
  if (!options.method.empty()) return options.method;
  const bool sheet = !made.config.tissue().has_volume();
  if (!sheet || made.config.has_held_start() || !lies_free(made)) return "reference";
  std::printf("no clamp holds the body: the shell is fitted (--method shell)\n");
  return "shell";
}

/// "NAME:a.b=c" to the overrides of recordings of that name, or that begin so with "*" at its end.
void add_own_overrides(const std::vector<std::string>& stated,
                       std::vector<Observation>& observations) {
  for (const std::string& text : stated) {
    const std::size_t colon = text.find(':');
    if (colon == std::string::npos || text.find('=', colon) == std::string::npos)
      throw_error("--set-for: {}, needed RECORDING:a.b=c", text);
    const std::string name = text.substr(0, colon);
    const bool begin = name.ends_with('*');
    bool any = false;
    for (Observation& o : observations) {
      if (begin ? !o.name.starts_with(name.substr(0, name.size() - 1)) : o.name != name) continue;
      o.overrides.push_back(text.substr(colon + 1));
      any = true;
    }
    if (!any) throw_error("--set-for: {}: no recording is called so", name);
  }
}

/// What was made of the markers of a recording, for people.
std::string print_markers(const Observation& seen) {
  if (seen.marker_rows == 0) return "";
  const auto frames = std::ranges::count_if(
      seen.frames, [](const SeenFrame& frame) { return !frame.markers.empty(); });
  std::string line = fmt::format("  markers: {} of {} frames are looked at, noise {:.3f} mm",
                                 frames, seen.marker_rows, 1e3 * seen.marker_noise);
  if (seen.held) line += fmt::format(", let go at {:.3f} s", seen.released);
  return fmt::format("{}\n", line);
}

/// As a table of a recording folder.
std::string print_table(const Series& series) {
  std::string text = fmt::format("t_s,{}\n", fmt::join(series.columns, ","));
  for (std::size_t row = 0; row < series.rows(); ++row) {
    text += print_seconds(series.time_ns[row]);
    for (std::size_t k = 0; k < series.columns.size(); ++k) {
      const double value = series.at(row, k);
      text += std::isfinite(value) ? fmt::format(",{:.9g}", value) : ",";
    }
    text += '\n';
  }
  return text;
}

int calibrate(const CalibrateOptions& options) {
  OutputFolder folder(options.output);
  // What is wrong in itself is told before recordings are read, which takes its time.
  CalibrationOptions chosen;
  if (!options.frame_period.empty()) chosen.frame_period = parse_frame_period(options.frame_period);
  if (!options.markers.empty()) chosen.markers = read_marker_notes(options.markers);
  CaseInput input = read_case(options.recordings, options.scene, options.overrides);
  std::vector<std::string>& warnings = input.warnings;
  hold_out(options.held_out, input);
  chosen.priors = input.priors;
  chosen.threads = options.threads;
  chosen.seed = options.seed;
  chosen.tolerance_m = 1e-3 * options.tolerance_mm;
  chosen.leave_out = !options.no_leave_out;
  chosen.folder = input.folder;
  const pb::Scene& scene = input.scene;
  const std::vector<std::string> not_looked_for = told_not_looked_for(scene, chosen.priors);
  // Before anything is simulated: who meant it otherwise need not wait.
  for (const std::string& told : not_looked_for)
    std::fprintf(stderr, "warning: %s\n", told.c_str());
  const Scene made = make_scene(scene, chosen.folder);
  const std::string method = method_of(options, made);
  if (!options.frame_period.empty()) {
    if (method != "shell") {
      throw_error(
          "--frame-period-s: of --method shell alone, here it is {}: state times in seconds",
          method);
    }
    for (auto& [name, recording] : input.recordings)
      set_frame_period(name, chosen.frame_period->value, recording);
  }
  CloudChoice clouds;
  clouds.skipped = options.skipped_clouds;
  clouds.fused = options.fused;
  if (options.above_board_mm) clouds.above_board = 1e-3 * *options.above_board_mm;
  std::size_t told_count = 0;
  tell_warnings(warnings, told_count);
  warnings.insert(warnings.end(), made.warnings.begin(), made.warnings.end());
  std::vector<Observation> observations =
      observe_case(input, made, clouds, chosen.markers, warnings);
  tell_warnings(warnings, told_count);
  for (const Observation& o : observations) {
    const SeenFigures figures{o.clouds, o.parts, o.share_seen};
    std::printf("%s:\n%s%s", o.name.c_str(), print_seen(figures).c_str(), print_markers(o).c_str());
  }
  add_own_overrides(options.own_overrides, observations);
  const auto line = std::make_shared<ProgressLine>("calibrate");
  SimulatorOptions where = options.simulator;
  where.build_id = build_id();
  const auto simulator = std::make_shared<Simulator>(
      options.threads, where, [line](const std::string& text) { line->tell(text); });
  chosen.simulator = simulator;
  chosen.progress = [line, simulator](double share, const std::string& stage) {
    line->show(share, stage, simulator->describe());
  };
  const auto calibrate_by = method == "paper"   ? calibrate_paper
                            : method == "shell" ? calibrate_shell
                                                : calibrate_reference;
  Calibration result = calibrate_by(scene, std::move(observations), chosen);
  line->end();
  const std::vector<std::string> to_tell = result.warnings;
  result.warnings.insert(result.warnings.begin(), warnings.begin(), warnings.end());
  result.warnings.insert(result.warnings.begin(), not_looked_for.begin(), not_looked_for.end());
  folder.begin();
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(result.scene, &text));
  folder.write("scene.txtpb", text);
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(result.priors, &text));
  if (result.priors.prior_size() > 0) folder.write("scene.prior.txtpb", text);
  folder.write("calibration.json", print_calibration(result));
  folder.write("report.html", make_calibration_page(result, chosen.folder));
  for (const Calibration::LeftOut& left : result.left_out) {
    OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(left.scene, &text));
    fs::create_directories(folder.path() / "left_out");
    folder.write("left_out/" + left.recording + ".txtpb", text);
  }
  for (const Calibration::MarkerTable& markers : result.markers) {
    fs::create_directories(folder.path() / "markers");
    folder.write("markers/" + markers.recording + ".csv", print_table(markers.table));
  }
  folder.finish();
  for (const std::string& warning : to_tell) std::fprintf(stderr, "warning: %s\n", warning.c_str());
  std::printf("%s%s: scene.txtpb, calibration.json, report.html; %.0f core-seconds\n",
              summarise_calibration(result).c_str(), options.output.c_str(), result.core_seconds);
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  return 0;
}

}  // namespace

std::function<int()> add_calibrate_command(CLI::App& app) {
  const auto made = std::make_shared<CalibrateOptions>();
  CalibrateOptions& options = *made;
  CLI::App& sub =
      *app.add_subcommand("calibrate", "Fit the simulation to recordings (docs/calibrate.md)");
  sub.add_option("--scene", options.scene,
                 "Scene (.txtpb) or scene_believed.txt that the fit begins from; default: what the "
                 "recordings say");
  sub.add_option("-r,--recordings", options.recordings,
                 "Recordings: folders, MCAP files, or folders of them")
      ->required();
  sub.add_option("-o,--output", options.output,
                 "Folder for scene.txtpb, calibration.json, report.html; new or empty")
      ->required();
  sub.add_option("--method", options.method,
                 "reference: fit with the derivatives of the converged finite-element solid; "
                 "shell: fit with differences of the shell; paper: genetic algorithm on the "
                 "cluster model. Default: reference, but shell where no clamp holds the body")
      ->check(CLI::IsMember({"reference", "shell", "paper"}));
  sub.add_option(
      "--set", options.overrides,
      "Override a knob of the scene, a.b=c, as scene.tissue.material.young_modulus_pa=5000");
  sub.add_option("--set-for", options.own_overrides,
                 "Override a knob of the scene for one recording, RECORDING:a.b=c, or NAME*:a.b=c "
                 "for those whose names begin with NAME");
  sub.add_option("--held-out", options.held_out,
                 "Name of a recording that is predicted and not fitted, or NAME* for those whose "
                 "names begin with NAME; recordings that say so themselves are held out as well");
  sub.add_option("--markers", options.markers,
                 "Table of markers with the columns name, on (tissue, clamp, other), x_m, y_m, "
                 "z_m: their places in the body frame B, as far as they are known");
  sub.add_option(
      "--frame-period-s", options.frame_period,
      "Time between frames where recordings only count them, SECONDS:STANDARD_DEVIATION; "
      "all times are stretched by it");
  sub.add_option("--skip-clouds", options.skipped_clouds,
                 "Number of clouds at the beginning of every recording that are left out")
      ->check(whole_number());
  sub.add_flag(
      "--fused", options.fused,
      "Take clouds as merged from several cameras, whatever recordings and scene say of one");
  sub.add_option("--above-board-mm", options.above_board_mm,
                 "Height above the board below which points are not compared [mm]")
      ->check(number_between(0, 1000));
  sub.add_option(
         "--tolerance-mm", options.tolerance_mm,
         "Root mean square error of the surface that the mesh of the reference is made for [mm]")
      ->check(number_between(1e-3, 10))
      ->capture_default_str();
  sub.add_flag("--no-leave-out", options.no_leave_out,
               "Do not fit again without each pinch point to find the error there");
  sub.add_option("--seed", options.seed, "Seed of the genetic algorithm")
      ->check(whole_number())
      ->capture_default_str();
  sub.add_option("--threads", options.threads,
                 "Number of recordings that are simulated at a time; results do not depend on it")
      ->check(number_between(1, 1024))
      ->capture_default_str();
  add_simulator_options(sub, options.simulator);
  return [made] { return calibrate(*made); };
}

}  // namespace omentum
