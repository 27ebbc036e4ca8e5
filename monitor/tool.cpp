#include "monitor/tool.h"

#include <CLI/CLI.hpp>
#include <csignal>
#include <optional>

#include "core/topics.h"

namespace omentum {
namespace {

volatile std::sig_atomic_t stop_flag = 0;
void on_signal(int) { stop_flag = 1; }

}  // namespace

CLI::Option* add_tool_options(CLI::App& app, ToolOptions& options) {
  CLI::Option* run = app.add_option("--run", options.run, "Name of the run to look at")
                         ->envname("OMENTUM_RUN")
                         ->required();
  app.add_option("--domain", options.domain, "DDS domain of the run, 0 ... 230")
      ->check(CLI::Range(0, 230))
      ->capture_default_str();
  add_dds_options(app, options.dds);
  return run;
}

bool stop_requested() { return stop_flag != 0; }

void catch_stop_signals() {
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
}

std::unique_ptr<dds::Participant> join_run(const ToolOptions& options, const std::string& name) {
  check_run_name(options.run);
  const std::optional<DdsProfile> profile = wait_for_dds_profile(
      options.dds, DdsRole::kOther, options.domain, 0, 0, [] { return stop_requested(); });
  if (!profile) return nullptr;
  return std::make_unique<dds::Participant>(options.domain, profile->uri, name);
}

}  // namespace omentum
