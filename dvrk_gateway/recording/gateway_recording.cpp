#include "dvrk_gateway/recording/gateway_recording.h"

#include <fmt/core.h>
#include <google/protobuf/text_format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "core/check.h"
#include "core/clock.h"
#include "core/config.h"
#include "core/log.h"
#include "core/output_folder.h"
#include "core/read_file.h"
#include "core/registration_file.h"
#include "core/utc_time.h"
#include "dvrk_gateway/recording/plain_folder.h"

namespace omentum {
namespace {

constexpr const char* kNone = "none";

std::string text_of(const google::protobuf::Message& message) {
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(message, &text));
  return text;
}

void add_registration(const std::string& path, const ToolMount& mount, pb::RecordingInfo& info) {
  if (path.empty()) return;
  const Registration found = load_registration(path);
  info.set_registration_text(print_registration(found));
  const double touch_error = std::max(found.touch_error, pb::RegistrationRules{}.touch_noise_m());
  info.set_registration_uncertainty_m(
      worst_predicted_error(found, touch_error, mount.workspace_min, mount.workspace_max));
}

RobotRecorderOptions recorder_options(const std::string& path, const RecordedSessionFacts& facts,
                                      const pb::Config& config, const SafetySetup& safety) {
  const std::int64_t start_unix_ns = wall_now_ns();
  RobotRecorderOptions options;
  options.path = path;
  options.setup.mount = safety.mount;
  options.setup.X_AR = safety.X_AR;
  options.setup.start_ns = steady_now_ns();
  pb::RecordingInfo& info = options.setup.info;
  info.set_name(std::filesystem::path(path).stem().string());
  info.set_date(utc_text(start_unix_ns));
  info.set_start_unix_ns(static_cast<std::uint64_t>(start_unix_ns));
  info.set_mode(facts.mode);
  info.set_program("dvrk_gateway " + facts.revision);
  info.set_dry_run(facts.dry_run);
  info.set_instrument(std::string(safety.mount.instrument->name));
  info.set_control_period_s(safety.limits.period_s());
  info.set_tool_rate_hz(1 / safety.limits.period_s());
  info.set_joints_rate_hz(1 / safety.limits.period_s());
  info.set_scene_text(text_of(config.scene()));
  add_registration(facts.registration, safety.mount, info);
  RecordingContext& context = options.context;
  context.name = facts.mode;
  context.config_text = print_config(config);
  context.config_hash = config_hash(config);
  context.git_revision = facts.revision;
  context.control_period = config.task().control_period_s() * config.task().action_repeat();
  return options;
}

}  // namespace

void add_recording_options(CLI::App& app, RecordingOptions& options) {
  app.add_option("--record", options.record,
                 "FILE.mcap to record into, or a folder for files named by their time; none: "
                 "nothing is recorded")
      ->capture_default_str();
  app.add_option("--record-folder", options.plain_folder,
                 "Folder to write the recording into as well, in the plain form that `mismatch` "
                 "reads (docs/formats.md 3)");
  app.add_option(
         "--source", options.sources,
         "Record a sensor beside the robot: NAME=udp:PORT (JSON lines) or NAME=file:PATH (a "
         "table that grows); NAME force, markers, tracker, cloud, color, depth "
         "(docs/formats.md 12)")
      ->allow_extra_args(false);
}

std::string recording_path(const std::string& record, const std::string& mode,
                           std::int64_t now_unix_ns) {
  if (record.ends_with(".mcap")) return record;
  std::string time = utc_text(now_unix_ns);
  std::replace(time.begin(), time.end(), ':', '-');  // no name of a file on other systems
  return (std::filesystem::path(record) / fmt::format("{}-{}.mcap", time, mode)).string();
}

GatewayRecording::GatewayRecording(const RecordingOptions& options,
                                   const RecordedSessionFacts& facts, const pb::Config& config,
                                   const SafetySetup& safety)
    : plain_folder_(options.plain_folder) {
  if (options.record.empty()) throw_error("--record \"\": FILE.mcap, a folder, or none");
  if (options.record == kNone) {
    if (!plain_folder_.empty())
      throw_error("--record-folder {}: needs a recording, and --record is none", plain_folder_);
    if (!options.sources.empty())
      throw_error("--source {}: needs a recording, and --record is none", options.sources.front());
    return;
  }
  // Told now, not when the session is over.
  if (!plain_folder_.empty()) OutputFolder{plain_folder_};
  const std::string path = recording_path(options.record, facts.mode, wall_now_ns());
  for (const std::string& source : options.sources) (void)parse_sensor_source(source);
  recorder_ = std::make_unique<RobotRecorder>(recorder_options(path, facts, config, safety));
  sources_ = std::make_unique<SensorSources>(options.sources, *recorder_);
}

void GatewayRecording::append_to(std::vector<GatewayObserver*>& observers) {
  if (recorder_) observers.push_back(recorder_.get());
}

void GatewayRecording::stop_on_failure(OperatorEvents& events) {
  if (recorder_) recorder_->stop_on_failure([&events] { events.fault = true; });
}

bool GatewayRecording::finish() {
  if (!recorder_) return true;
  sources_->end();
  const Result<void> finished = recorder_->finish();
  if (!finished) log().error("{}", finished.error());
  if (!std::filesystem::exists(recorder_->path())) {
    log().warn("recording: no control period took place: no file");
    return finished.has_value();
  }
  fmt::print("recording  {}{}\n", recorder_->path(), finished ? "" : ", not whole");
  if (const std::uint64_t unseen = recorder_->unseen_periods(); unseen > 0)
    log().warn("recording: {} periods are not in it", unseen);
  if (plain_folder_.empty()) return finished.has_value();
  try {
    write_plain_folder(recorder_->path(), plain_folder_);
    fmt::print("recording  {}\n", plain_folder_);
  } catch (const Error& error) {
    log().error("--record-folder: {}", error.what());
    return false;
  }
  return finished.has_value();
}

}  // namespace omentum
