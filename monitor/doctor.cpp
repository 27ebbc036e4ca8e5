#include "monitor/doctor.h"

#include <fmt/core.h>

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <set>

#include "core/check.h"
#include "core/clock.h"
#include "core/printable.h"
#include "monitor/run_watch.h"

namespace omentum {
namespace {

/// Who stands in the names of options, beside the learner.
std::vector<std::string> hosts_of(const DdsOptions& dds) {
  std::vector<std::string> hosts = dds.peers;
  if (!dds.hub.empty()) hosts.push_back(dds.hub);
  return hosts;
}

Finding check_configuration(const ToolOptions& options) {
  const Result<DdsProfile> profile =
      find_dds_profile(options.dds, DdsRole::kOther, options.domain, 0);
  if (!profile) return {false, "network", profile.error(), "see --discovery, --hub and --peers"};
  std::string detail = "profile " + profile.value().name;
  if (profile.value().name == "environment")
    detail += ": CYCLONEDDS_URI is set and counts, not the options";
  return {true, "network", detail, ""};
}

std::vector<Finding> listen_to_run(const DoctorOptions& options) {
  try {
    const std::unique_ptr<dds::Participant> participant = join_run(options.tool, "omentum-doctor");
    if (!participant) return {};
    RunWatch watch(*participant, options.tool.run, false);
    RunState state(options.tool.run);
    const std::int64_t began = steady_now_ns();
    while (!stop_requested() && seconds_since(began) < options.patience_s) {
      watch.wait(100'000'000);  // a signal does not wake the wait set
      watch.take_into(state);
    }
    return check_run(state, options.tool, steady_now_ns());
  } catch (const Error& error) {
    return {{false, "bus", error.what(), "see the lines above"}};
  }
}

}  // namespace

std::string print_finding(const Finding& finding) {
  std::string line =
      fmt::format("{:<6} {:<16} {}\n", finding.ok ? "ok" : "WRONG", finding.about, finding.detail);
  if (!finding.remedy.empty()) line += fmt::format("{:<23} -> {}\n", "", finding.remedy);
  return printable(line);
}

std::vector<Finding> check_run(const RunState& state, const ToolOptions& options,
                               std::int64_t now_ns) {
  if (!state.learner() || state.learner_presence(now_ns) != Presence::kAlive) {
    return {{false, "learner",
             fmt::format("none of run {} speaks on domain {}", options.run, options.domain),
             fmt::format("start learner --run {} --set run.domain={}; is it there, look at "
                         "--discovery, --hub, --peers and the firewall (UDP from {} on)",
                         options.run, options.domain, discovery_port(options.domain))}};
  }
  std::vector<Finding> findings;
  const std::uint64_t build = state.manifest() ? state.manifest()->build_id : 0;
  findings.push_back(
      {true, "learner",
       fmt::format("speaks, epoch {}, revision {}, build {:016x}", state.learner()->learner_epoch,
                   state.manifest() ? state.manifest()->git_revision : "unknown", build),
       ""});
  for (const auto& [id, row] : state.workers()) {
    const WorkerStatus& w = row.status;
    const std::string who = fmt::format("{} on {} pid {}: ", id, w.host, w.pid);
    const Presence presence = RunState::presence_of(row, now_ns);
    if (presence != Presence::kAlive) {
      findings.push_back({false, "worker", who + name_of(presence), "look at its log"});
    } else if (build != 0 && w.build_id != build) {
      findings.push_back({false, "worker", who + fmt::format("build {:016x}", w.build_id),
                          "install the learner's build there: results would differ, so it gets no "
                          "task"});
    } else {
      findings.push_back({true, "worker", who + "revision " + w.program_version, ""});
    }
    for (const std::string& alarm : w.alarms)
      findings.push_back({false, "worker", who + alarm, "look at its log"});
  }
  if (state.workers().empty()) {
    findings.push_back(
        {false, "workers", "none speaks",
         fmt::format("start sim_worker --run {} --domain {}", options.run, options.domain)});
  }
  for (const std::string& alarm : state.learner()->alarms)
    findings.push_back({false, "learner", alarm, "look at its log"});
  return findings;
}

int run_doctor(const DoctorOptions& options) {
  catch_stop_signals();
  fmt::print("{}\n", options.version);
  bool wrong = false;
  const auto tell = [&wrong](const Finding& finding) {
    wrong = wrong || !finding.ok;
    std::fputs(print_finding(finding).c_str(), stdout);
  };
  tell(check_cpu());
  tell(check_receive_buffer(probe_receive_buffer(kReceiveBufferBytes)));
  tell(check_clock());
  tell(check_interfaces(options.tool.dds.interface));
  bool names = true;
  for (const std::string& host : hosts_of(options.tool.dds)) {
    const Finding name = check_name(host);
    names = names && name.ok;
    tell(name);
  }
  tell(check_ports(options.tool.domain));
  const std::string& dir = options.tool.dds.security_dir;
  bool certificates = true;
  if (!dir.empty()) {
    const Finding finding = check_certificates(dir, wall_now_ns() / 1'000'000'000);
    certificates = finding.ok;
    tell(finding);
  }
  // What cannot work would only wait.
  const bool reachable = names && certificates;
  if (reachable) tell(check_configuration(options.tool));
  if (reachable && !options.tool.run.empty()) {
    for (const Finding& finding : listen_to_run(options)) tell(finding);
  }
  return wrong ? 1 : 0;
}

}  // namespace omentum
