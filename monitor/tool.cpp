#include "monitor/tool.h"

#include <fmt/ranges.h>
#include <google/protobuf/text_format.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <csignal>
#include <cstdio>
#include <optional>
#include <set>
#include <sstream>

#include "core/read_file.h"
#include "core/topics.h"
#include "proto/config.pb.h"

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
      ->default_str("that of RUNS_DIR/RUN/config.txtpb, without it 0")
      ->each([&options](const std::string& /*value*/) { options.domain_named = true; });
  app.add_option("--runs-dir", options.runs_dir, "Folder of the run folders, for the run's domain")
      ->envname("OMENTUM_RUNS_DIR")
      ->capture_default_str();
  add_dds_options(app, options.dds);
  return run;
}

std::vector<std::uint32_t> domains_in_use(const std::string& udp_table) {
  // docs/wire.md 6: 7400 + 250 x domain, from 10 on two for each of 81 participants. Above these
  // the system gives ports to anybody.
  constexpr unsigned kFirst = 7400, kStep = 250, kLow = 10, kHigh = 172, kEnd = 32768;
  std::set<std::uint32_t> domains;
  std::istringstream lines(udp_table);
  std::string line;
  while (std::getline(lines, line)) {
    std::istringstream words(line);
    std::string number, local;
    if (!(words >> number >> local)) continue;
    const std::size_t colon = local.find(':');
    if (colon == std::string::npos) continue;
    unsigned port = 0;
    std::from_chars(local.data() + colon + 1, local.data() + local.size(), port, 16);
    if (port < kFirst || port >= kEnd) continue;
    const unsigned within = (port - kFirst) % kStep;
    if (within >= kLow && within < kHigh) domains.insert((port - kFirst) / kStep);
  }
  return {domains.begin(), domains.end()};
}

void find_domain(ToolOptions& options) {
  if (options.domain_named || options.run.empty()) return;
  check_run_name(options.run);
  const std::string path = fmt::format("{}/{}/config.txtpb", options.runs_dir, options.run);
  if (const Result<std::string> text = read_file(path); text) {
    google::protobuf::TextFormat::Parser parser;
    parser.AllowUnknownField(true);  // of another version
    pb::Config config;
    if (parser.ParseFromString(text.value(), &config)) {
      options.domain = config.run().domain();
      fmt::print(stderr, "omentum: domain {}, as {} says\n", options.domain, path);
      return;
    }
  }
  const Result<std::string> sockets = read_file("/proc/net/udp");
  const std::vector<std::uint32_t> used =
      sockets ? domains_in_use(sockets.value()) : std::vector<std::uint32_t>{};
  fmt::print(
      stderr,
      "omentum: domain 0, for there is no {}; another one: --domain N, as the learner and "
      "train.sh print it, or --runs-dir DIR{}\n",
      path, used.empty() ? "" : fmt::format("; in use on this machine: {}", fmt::join(used, ", ")));
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
