#include "mismatch/recording/recording_program.h"

#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <set>

#include "core/check.h"
#include "core/durable_file.h"
#include "core/file_name.h"
#include "core/output_folder.h"
#include "mismatch/fit/forward.h"
#include "mismatch/import/import_map.h"
#include "mismatch/intake/contact_sheet.h"
#include "mismatch/intake/intake.h"
#include "mismatch/intake/intake_json.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/read_recording.h"
#include "mismatch/recording/recording_mcap.h"
#include "mismatch/recording/text_table.h"
#include "mismatch/ros/bag.h"
#include "mismatch/scene/believed_scene.h"
#include "mismatch/seen/cloud_mask.h"
#include "mismatch/seen/observation.h"
#include "mismatch/seen/repeats.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

struct RecordingOptions {
  std::string input, map, output, contact_sheet, scene;
  std::vector<std::string> inputs;
  bool json = false;
};

void warn(const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings)
    std::fprintf(stderr, "warning: %s\n", warning.c_str());
}

std::string summary(const Recording& recording) {
  std::string text;
  for (const auto& [topic, series] : recording.series)
    text += fmt::format(" {} {},", topic, series.rows());
  const auto frames = [&](const char* what, std::size_t count) {
    if (count > 0) text += fmt::format(" {} {},", what, count);
  };
  frames("clouds", recording.clouds.size());
  frames("depth", recording.depth.size());
  frames("color", recording.color.size());
  if (!text.empty()) text.pop_back();
  return text;
}

/// A folder, an MCAP file of ours, or a bag of ROS.
Recording read_any(const std::string& path) {
  return is_bag(path) ? read_bag(path, {}, {}) : read_recording(path);
}

void warn_left_out(const std::string& /*path*/, const std::string& why) {
  warn({why + ": left out"});
}

/// What a folder or file holds, one recording after the other. Of several bags and files one that
/// cannot be read is left out with a line.
void for_each(const RecordingOptions& options, const TakeRecording& take) {
  if (options.map.empty()) {
    is_bag(options.input);  // refuses what first must be converted
    return for_each_recording(options.input, take, read_any, warn_left_out);
  }
  const pb::ImportMap map = read_import_map(options.map);
  if (map.has_ros()) return import_bags(map, options.input, take, warn_left_out);
  import_mapped(map, options.input, take);
}

/// What no scene can hold of a believed scene, once for all recordings that have it. Throws Error
/// where it is none.
class BeliefReport {
 public:
  void add(const Recording& recording) {
    const std::string& text = recording.info.scene_believed_text();
    if (text.empty() || !told_.insert(text).second) return;
    const std::string& path = recording.scene_path;
    const Result<BelievedScene> believed =
        parse_believed_scene(path.empty() ? "scene_believed.txt" : path, text);
    if (!believed) throw_error("{}", believed.error());
    warn(believed.value().warnings);
  }

 private:
  std::set<std::string> told_;
};

/// Rows that lie far from those before: a clock that was set while it was recorded.
void warn_of_leaps(const std::string& name, const Recording& recording) {
  constexpr double kFar = 3600;  // [s]
  const auto look = [&](const std::string& topic, const std::vector<std::int64_t>& time_ns) {
    for (std::size_t k = 1; k < time_ns.size(); ++k) {
      const double apart = 1e-9 * static_cast<double>(time_ns[k] - time_ns[k - 1]);
      if (apart <= kFar) continue;
      return warn(
          {fmt::format("{}: /{}: sample {} of {} is {:.6g} s after the one before it: was a "
                       "clock set?",
                       name, topic, k + 1, time_ns.size(), apart)});
    }
  };
  for (const auto& [topic, series] : recording.series) look(topic, series.time_ns);
  look("cloud", recording.clouds.time_ns);
  look("depth", recording.depth.time_ns);
  look("color", recording.color.time_ns);
}

int import_recordings(const RecordingOptions& options) {
  BeliefReport beliefs;
  const auto report = [&](const std::string& name, const Recording& recording) {
    beliefs.add(recording);
    warn(recording.warnings);
    warn_of_leaps(name, recording);
    std::printf("%s:%s\n", name.c_str(), summary(recording).c_str());
    for (const std::string& note : recording.notes) std::printf("  %s\n", note.c_str());
  };
  if (!has_ending(options.output, ".mcap")) {
    OutputFolder out(options.output);
    out.begin();
    for_each(options, [&](const std::string& name, const Recording& recording) {
      write_recording_mcap(recording, (out.path() / (name + ".mcap")).string());
      report(name, recording);
    });
    out.finish();
    return 0;
  }
  // One file: it is there once it is known that there is no other recording.
  std::string first;
  OutputFolder out(options.output + ".parts");  // never finished: it goes with what is in it
  out.begin();
  const std::string part = (out.path() / "one.mcap").string();
  for_each(options, [&](const std::string& name, const Recording& recording) {
    if (!first.empty())
      throw_error("-o: {}, but there are recordings {}, {} ...: allowed the name of a folder",
                  options.output, first, name);
    first = name;
    write_recording_mcap(recording, part);
    report(name, recording);
  });
  std::error_code failed;
  fs::rename(part, options.output, failed);
  if (failed) throw_error("{}: cannot be written: {}", options.output, failed.message());
  return 0;
}

int export_recording(const RecordingOptions& options) {
  const Recording recording = read_recording_mcap(options.input);
  warn(recording.warnings);
  write_recording_folder(recording, options.output);
  std::printf("%s:%s\n", options.output.c_str(), summary(recording).c_str());
  return 0;
}

/// The scene of --scene, else the one that the recording states of itself.
std::optional<Scene> scene_of(const RecordingOptions& options, Recording& recording) {
  if (!options.scene.empty()) {
    const bool believed = options.scene.ends_with(".txt");
    recording.info.clear_scene_text();
    recording.info.clear_scene_believed_text();
    (believed ? *recording.info.mutable_scene_believed_text()
              : *recording.info.mutable_scene_text()) = read_whole_file(options.scene);
  }
  return stated_scene(recording, recording.warnings);
}

bool has_clouds(const Recording& recording) {
  return recording.clouds.size() > 0 || recording.depth.size() > 0;
}

/// What the clouds show of the believed scene; empty without one.
std::string told_clouds(const RecordingOptions& options, const std::string& path,
                        const Recording& recording) {
  constexpr std::size_t kMostFrames = 80;
  if (!has_clouds(recording)) return "";
  Recording stated = recording;
  const std::optional<Scene> scene = scene_of(options, stated);
  if (!scene) return "";
  return print_seen(look_at_clouds(recording, path, *scene, kMostFrames));
}

/// Clouds of a recording less what the scene's model makes of its commands; `why` says where the
/// simulation ends early. An error says why there is none.
Result<Series> residuals_of(const Recording& recording, const Scene& scene,
                            std::vector<std::string>& odd) {
  const std::string& name = recording.info.name();
  const Observation seen = observe(name, name, recording, scene, odd);
  Numerics numerics;
  numerics.model = scene.config.tissue().model();
  Simulator here(1);
  const Prediction predicted =
      predict(seen, scene.config, "", {}, Eigen::VectorXd(), 0, numerics, false, here);
  if (predicted.refused) return Failure{predicted.failure};
  if (!predicted.failure.empty())
    odd.push_back(fmt::format("{}: the model ends early: {}", name, predicted.failure));
  std::vector<std::vector<Eigen::Vector3d>> surfaces;
  for (const PredictedFrame& frame : predicted.frames) surfaces.push_back(frame.vertices);
  return residuals_of_surfaces(seen, scene, surfaces);
}

/// Clouds of repeats, each less what the scene's model makes of its own commands.
std::string cloud_floor(const RecordingOptions& options, const std::vector<Recording>& repeats) {
  std::vector<Series> residuals;
  for (const Recording& recording : repeats) {
    if (!has_clouds(recording)) return "";
    Recording stated = recording;
    const std::optional<Scene> scene = scene_of(options, stated);
    if (!scene) return "";
    std::vector<std::string> odd;
    try {
      Result<Series> made = residuals_of(recording, *scene, odd);
      if (!made) return fmt::format("  floor of /cloud by the model: none: {}\n", made.error());
      residuals.push_back(std::move(made).value());
    } catch (const Error& error) {  // the recording tells nothing of tissue
      return fmt::format("  floor of /cloud by the model: none: {}\n", error.what());
    }
    warn(odd);
    if (residuals.back().rows() == 0) return "  floor of /cloud by the model: none: no frame\n";
  }
  std::vector<const Series*> all;
  for (const Series& series : residuals) all.push_back(&series);
  FloorFigures floor{"cloud", "m"};
  floor.less = "what the model makes of its own commands";
  if (!compare_repeats(all, floor)) return "";
  return print_floor({floor});
}

/// The recordings of files and folders with the path of each, as for_each() has them.
void for_each_with_path(
    const std::vector<std::string>& inputs,
    const std::function<void(const std::string& path, const Recording& recording)>& take) {
  std::string at;
  const auto read = [&at](const std::string& path) {
    at = path;
    return read_any(path);
  };
  const auto take_there = [&](const std::string&, const Recording& recording) {
    take(at, recording);
  };
  for (const std::string& input : inputs) {
    if (is_bag(input)) {
      take(input, read_bag(input, {}, {}));
    } else {
      for_each_recording(input, take_there, read, warn_left_out);
    }
  }
}

int print_info(const RecordingOptions& options) {
  if (!options.contact_sheet.empty() && options.inputs.size() != 1)
    throw_error("--contact-sheet: {} recordings, allowed one", options.inputs.size());
  std::string sheet;
  std::map<std::string, std::vector<Recording>> repeats;
  std::set<fs::path> files;  // a recording that is given twice is no repeat of itself
  using Json = nlohmann::ordered_json;
  Json all_told = {{"recordings", Json::array()}, {"repeats", Json::array()}};
  const auto print = [&](const std::string& text) {
    if (!options.json) std::printf("%s", text.c_str());
  };
  const auto tell = [&](const std::string& path, const Recording& recording) {
    if (!sheet.empty())
      throw_error("--contact-sheet: several recordings in {}, allowed one", options.inputs.front());
    warn(recording.warnings);
    const pb::RecordingInfo& info = recording.info;
    print(fmt::format("{}: {}:{}\n", path, info.name(), summary(recording)));
    // The first of repeats names itself.
    const bool itself = info.repeat_of() == info.name();
    for (const auto& [what, text] : {std::pair{"repeat of", itself ? "" : info.repeat_of()},
                                     {"specimen", info.specimen()},
                                     {"notes", info.notes()},
                                     {"held out", std::string(info.held_out() ? "yes" : "")}}) {
      if (!text.empty()) print(fmt::format("  {}: {}\n", what, text));
    }
    const IntakeFigures figures = take_in(recording);
    const std::string clouds = told_clouds(options, path, recording);
    print(print_intake(figures) + clouds);
    Json told = {{"path", path},
                 {"name", info.name()},
                 {"repeat_of", info.repeat_of()},
                 {"specimen", info.specimen()},
                 {"notes", info.notes()},
                 {"held_out", info.held_out()}};
    told.update(intake_json(figures));
    told["clouds"] = clouds;
    told["warnings"] = recording.warnings;
    all_told["recordings"].push_back(std::move(told));
    if (!options.contact_sheet.empty()) sheet = make_contact_sheet(recording);
    if (!info.repeat_of().empty() && files.insert(fs::canonical(path)).second)
      repeats[info.repeat_of()].push_back(recording);
  };
  for_each_with_path(options.inputs, tell);
  if (!sheet.empty()) {
    const Result<void> written = write_durably(options.contact_sheet, sheet);
    if (!written) throw_error("{}", written.error());
  }
  for (const auto& [name, recordings] : repeats) {
    std::vector<const Recording*> all;
    for (const Recording& recording : recordings) all.push_back(&recording);
    const std::vector<FloorFigures> figures = repeatability(all);
    const std::string clouds = recordings.size() > 1 ? cloud_floor(options, recordings) : "";
    const std::string floor = print_floor(figures) + clouds;
    if (!floor.empty()) print(fmt::format("repeats of {}:\n{}", name, floor));
    all_told["repeats"].push_back(
        {{"repeat_of", name}, {"floor", floor_json(figures)}, {"clouds", clouds}});
  }
  using Handler = nlohmann::ordered_json::error_handler_t;
  if (options.json)  // bytes of names that are no UTF-8 are replaced
    std::printf("%s\n", all_told.dump(2, ' ', false, Handler::replace).c_str());
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  return 0;
}

}  // namespace

std::function<int()> add_recording_commands(CLI::App& app) {
  const auto options = std::make_shared<RecordingOptions>();
  CLI::App& in = *app.add_subcommand(
      "import", "Convert recordings to MCAP files (docs/formats.md 13, docs/import.md)");
  in.add_option("input", options->input,
                "Recording folder, case folder with several, MCAP file, bag of ROS in MCAP (a "
                "file, or the folder of its parts); with --map any folder")
      ->required();
  in.add_option("--map", options->map,
                "Mapping file that says how the recordings are stored there (docs/import.md)");
  in.add_option("-o,--output", options->output,
                "NAME.mcap for one recording, or a folder for several, new or empty")
      ->required();
  CLI::App& out =
      *app.add_subcommand("export", "Write a recording as a plain folder (docs/formats.md 3)");
  out.add_option("input", options->input, "MCAP file")->required();
  out.add_option("-o,--output", options->output, "Folder to write; new or empty")->required();
  CLI::App& info = *app.add_subcommand(
      "info",
      "Say what can be known of recordings without simulation: clocks, gaps, noise, repeats");
  info.add_option("inputs", options->inputs,
                  "Recording folders, folders of several, MCAP files, or bags of ROS in MCAP; "
                  "several to compare repeats")
      ->required();
  info.add_option(
      "--scene", options->scene,
      "Scene (.txtpb) or scene_believed.txt, by which tool, board and background are told "
      "from tissue in clouds; default: what the recording says");
  info.add_flag("--json", options->json, "The same as JSON (docs/import.md 9)");
  info.add_option("--contact-sheet", options->contact_sheet,
                  "PNG file to write: some clouds and pictures, and the curves of the channels");
  return [&in, &out, &info, options] {
    if (info.parsed()) return print_info(*options);
    if (in.parsed()) return import_recordings(*options);
    if (out.parsed()) return export_recording(*options);
    return -1;
  };
}

}  // namespace omentum
