// Turns the folder of a run, or of several seeds, into one self-contained report.html.

#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/durable_file.h"
#include "core/printable.h"
#include "core/read_file.h"
#include "report/recording_page.h"
#include "report/report.h"

namespace {

namespace fs = std::filesystem;
using namespace omentum;  // NOLINT(google-build-using-namespace): a program of this very namespace

/// Where the report of these folders goes by default: beside what it describes.
std::string default_output(const std::vector<std::string>& folders) {
  const fs::path first(folders.front());
  const fs::path place = folders.size() == 1 ? first : fs::weakly_canonical(first).parent_path();
  return (place / "report.html").string();
}

/// Scene of the first run that has a configuration; a report without pictures is better than none.
std::optional<Scene> find_scene(const std::vector<RunFolder>& runs) {
  for (const RunFolder& run : runs) {
    if (!run.config) continue;
    try {
      return make_scene(run.config->scene(), scene_directory(*run.config));
    } catch (const Error& error) {
      fmt::print(stderr, "report: no pictures: {}\n", error.what());
    }
  }
  return std::nullopt;
}

void write_report(const std::vector<std::string>& folders, std::string output) {
  const std::vector<RunFolder> runs = load_runs(folders);
  const std::optional<Scene> scene = find_scene(runs);
  std::vector<std::string> warnings;
  const std::string html = make_report(runs, scene ? &*scene : nullptr, &warnings);
  for (const std::string& warning : warnings) fmt::print(stderr, "report: {}\n", warning);
  if (output.empty()) output = default_output(folders);
  if (const Result<void> written = write_durably(output, html); !written)
    throw_error("{}", written.error());
  fmt::print("{}: {} run(s), {:.1f} MB\n", output, runs.size(),
             static_cast<double>(html.size()) / 1e6);
}

/// A run that is named twice would count twice.
void check_paths(const std::vector<std::string>& paths) {
  std::map<fs::path, std::string> seen;
  for (const std::string& path : paths) {
    std::error_code ignored;  // what is not there is told later
    const auto [same, fresh] = seen.emplace(fs::weakly_canonical(path, ignored), path);
    if (!fresh) throw_error("{}: named twice, as {} too", path, same->second);
  }
}

/// Recordings of a robot that these paths name: files, or folders that hold files and no run.
std::vector<std::string> recordings_in(const std::vector<std::string>& paths) {
  std::vector<std::string> files;
  for (const std::string& path : paths) {
    if (path.ends_with(".mcap")) files.push_back(path);
    if (!fs::is_directory(path) || fs::exists(fs::path(path) / "config.txtpb")) continue;
    for (const auto& entry : fs::directory_iterator(path)) {
      if (entry.path().extension() == ".mcap") files.push_back(entry.path().string());
    }
  }
  std::sort(files.begin(), files.end());
  return files;
}

void write_recording_page(const std::vector<std::string>& files, std::string output) {
  std::vector<RobotRecording> recordings;
  for (const std::string& file : files) {
    const Result<std::string> bytes = read_file(file);
    if (!bytes) throw_error("{}", bytes.error());
    Result<RobotRecording> recording = read_robot_recording(file, bytes.value());
    if (!recording && files.size() == 1) throw_error("{}", recording.error());
    if (!recording) fmt::print(stderr, "report: {}: left out\n", recording.error());
    if (!recording) continue;
    for (const std::string& problem : recording.value().problems)
      fmt::print(stderr, "report: {}: {}\n", file, problem);
    recordings.push_back(std::move(recording).value());
  }
  if (recordings.empty()) throw_error("{}: no recording that can be shown", files.front());
  if (output.empty()) {
    const fs::path first(files.front());
    output = (files.size() == 1 ? fs::path(first).replace_extension(".html")
                                : first.parent_path() / "report.html")
                 .string();
  }
  const std::string html = make_recording_page(recordings);
  if (const Result<void> written = write_durably(output, html); !written)
    throw_error("{}", written.error());
  fmt::print("{}: {} recording(s), {:.1f} MB\n", output, recordings.size(),
             static_cast<double>(html.size()) / 1e6);
}

}  // namespace

int main(int count, char** arguments) {
  try {
    CLI::App app(
        "Writes report.html of a run: learning curves, exposure and grasp grids, pictures, 3-D "
        "replay.");
    std::vector<std::string> folders;
    std::string output;
    app.add_option("runs", folders,
                   "Run folders, the seeds of one experiment; or one folder that holds them; or "
                   "recordings of a robot: FILE.mcap or a folder of them")
        ->required();
    app.add_option("-o,--output", output,
                   "File to write; default: report.html in the folder, or beside the folders; of a "
                   "recording FILE.html beside it");
    if (const std::optional<int> code = parse_command_line(app, count, arguments)) return *code;
    check_paths(folders);
    const std::vector<std::string> recordings = recordings_in(folders);
    if (recordings.empty())
      write_report(folders, output);
    else
      write_recording_page(recordings, output);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "report: %s\n", omentum::printable(error.what()).c_str());
    return 2;
  }
}
