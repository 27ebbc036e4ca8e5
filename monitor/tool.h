#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/dds.h"
#include "core/dds_options.h"

namespace CLI {  // NOLINT(readability-identifier-naming): the library's name
class App;
class Option;
}  // namespace CLI

namespace omentum {

/// What every subcommand of the program is told: the run, its domain and how to reach it.
struct ToolOptions {
  std::string run;
  std::uint32_t domain = 0;  ///< 0 ... 230; find_domain() fills it in where none was named
  bool domain_named = false;
  std::string runs_dir = "runs";  ///< where the folder of the run tells its domain
  DdsOptions dds;
};

/// The domain of a run whose --domain was not named: that of RUNS_DIR/RUN/config.txtpb, else 0.
/// What it took and from where is told on standard error, and what else can be tried where it
/// guesses: deploy/train.sh draws a domain that nobody else uses.
void find_domain(ToolOptions& options);
/// Domains whose ports have sockets on this machine, those of --discovery loopback and mesh.
std::vector<std::uint32_t> domains_in_use(const std::string& udp_table);

/// Adds --run (required), --domain, --runs-dir and the network options; returns --run.
CLI::Option* add_tool_options(CLI::App& app, ToolOptions& options);

/// Says at once whether SIGINT or SIGTERM came; async-signal-safe flag behind it.
bool stop_requested();
/// From now on SIGINT and SIGTERM set that flag instead of ending the process.
void catch_stop_signals();

/// Joins the run's domain as a tool, waiting for names of hosts as learner and workers do. Null
/// when asked to stop meanwhile. Throws Error.
std::unique_ptr<dds::Participant> join_run(const ToolOptions& options, const std::string& name);

}  // namespace omentum
