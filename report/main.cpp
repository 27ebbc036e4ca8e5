// Turns the folder of a run, or of several seeds, into one self-contained report.html.

#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/check.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/durable_file.h"
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

}  // namespace

int main(int count, char** arguments) {
  try {
    CLI::App app(
        "Writes report.html of a run: learning curves, exposure and grasp grids, pictures, 3-D "
        "replay.");
    std::vector<std::string> folders;
    std::string output;
    app.add_option("runs", folders,
                   "run folders, seeds of one experiment; or one folder that holds them")
        ->required();
    app.add_option("-o,--output", output,
                   "file to write (default: report.html in the folder, or beside the folders)");
    if (const std::optional<int> code = parse_command_line(app, count, arguments)) return *code;
    write_report(folders, output);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "report: %s\n", error.what());
    return 2;
  }
}
