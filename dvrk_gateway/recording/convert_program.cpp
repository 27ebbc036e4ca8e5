#include "dvrk_gateway/recording/convert_program.h"

#include <fmt/core.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <system_error>

#include "core/command_line.h"
#include "core/registration_file.h"
#include "core/regular_file.h"
#include "dvrk_gateway/recording/plain_folder.h"
#include "dvrk_gateway/recording/wire_log.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

struct ConvertOptions {
  std::string log, output, registration, plain_folder;
  std::string instrument = "large_needle_driver";
};

RecordingSetup setup_of(const ConvertOptions& options) {
  RecordingSetup setup;
  setup.mount.instrument = &find_instrument(options.instrument);
  pb::RecordingInfo& info = setup.info;
  info.set_name(fs::path(options.log).filename().string());
  info.set_mode("convert");
  info.set_program("dvrk_gateway " + git_revision());
  info.set_instrument(std::string(setup.mount.instrument->name));
  if (options.registration.empty()) {
    fmt::print(stderr, "warning: no --registration: W is taken to be R\n");
    return setup;
  }
  const Registration found = load_registration(options.registration);
  if (found.instrument != setup.mount.instrument->name) {
    throw_error("--registration {}: made with {}, and --instrument is {}", options.registration,
                found.instrument, setup.mount.instrument->name);
  }
  setup.mount.X_WR = found.X_WR;
  info.set_registration_text(print_registration(found));
  return setup;
}

/// Under another name until it is whole.
void convert_log(const ConvertOptions& options) {
  // A file in the place of a device would be there for all programs.
  if (fs::exists(options.output) && !fs::is_regular_file(options.output))
    throw_error("-o {}: is no file", options.output);
  const RecordingSetup setup = setup_of(options);
  if (const Result<void> regular = require_regular_file(options.log); !regular)
    throw_error("{}", regular.error());
  std::ifstream log(options.log, std::ios::binary);
  if (!log) throw_error("{}: cannot be opened", options.log);
  const std::string unfinished = options.output + ".unfinished";
  errno = 0;
  std::ofstream out(unfinished, std::ios::binary | std::ios::trunc);
  if (!out) {
    throw_error("-o {}: cannot be written: {}", options.output,
                std::generic_category().message(errno));
  }
  const Result<WireLogCounts> converted = convert_wire_log(log, setup, out);
  out.close();
  std::error_code failed;
  if (converted && out) {
    fs::rename(unfinished, options.output, failed);
  } else {
    std::error_code ignored;
    fs::remove(unfinished, ignored);
  }
  if (!converted) throw_error("{}: {}", options.log, converted.error());
  if (!out) throw_error("-o {}: cannot be written", options.output);
  if (failed) throw_error("-o {}: cannot be written: {}", options.output, failed.message());
  const WireLogCounts& counts = converted.value();
  for (const std::string& problem : counts.problems)
    fmt::print(stderr, "warning: {}: {}\n", options.log, problem);
  if (counts.stepped_back > 0) {
    fmt::print(stderr,
               "warning: {}: {} lines up to 1 us earlier than a line before, recorded behind it\n",
               options.log, counts.stepped_back);
  }
  fmt::print(
      "{}: {} datagrams of the robot, {} of the client ({} without a whole goal), {} comments, {} "
      "bad lines, {} payloads not valid\n",
      options.output, counts.robot, counts.client, counts.without_goal, counts.comments, counts.bad,
      counts.invalid_payloads);
}

}  // namespace

int convert_program(int argc, char** argv) {
  CLI::App app{
      "Makes a recording (MCAP) from a captured wire log, whose lines hold a time in s, a tab and "
      "a datagram, with \">> \" before a datagram of the client (docs/formats.md 11). From a "
      "recording it makes the plain folder.",
      "dvrk_gateway convert"};
  ConvertOptions options;
  app.add_option("log", options.log, "Wire log, or a recording FILE.mcap")->required();
  app.add_option("-o,--output", options.output, "FILE.mcap to write; an existing one is replaced");
  app.add_option(
      "--record-folder", options.plain_folder,
      "Folder to write as well, in the plain form that `mismatch` reads (docs/formats.md 3)");
  app.add_option("--registration", options.registration,
                 "File registration.txtpb, which says where the base of the arm stood; without it "
                 "the world frame is that of the arm's remote centre of motion");
  app.add_option("--instrument", options.instrument,
                 "Name or number of the instrument that was on the arm")
      ->capture_default_str();
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  const bool is_recording = options.log.ends_with(".mcap");
  if (!is_recording && options.output.empty()) throw_error("-o: names the file to write");
  if (is_recording && options.plain_folder.empty())
    throw_error("{}: is a recording: --record-folder names the folder to write", options.log);
  if (!is_recording) convert_log(options);
  if (!options.plain_folder.empty()) {
    write_plain_folder(is_recording ? options.log : options.output, options.plain_folder);
    fmt::print("{}\n", options.plain_folder);
  }
  return 0;
}

}  // namespace omentum
