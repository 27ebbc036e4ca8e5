#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "monitor/run_state.h"
#include "monitor/tool.h"

namespace omentum {

/// One line of `omentum doctor`.
struct Finding {
  bool ok = true;
  std::string about;   ///< "receive buffer"
  std::string detail;  ///< what is there, or what is wrong with it
  std::string remedy;  ///< what to type or do; empty when ok
};

/// "ok     about   detail", and the remedy on a line of its own.
std::string print_finding(const Finding& finding);

/// `usable_bytes` as probe_receive_buffer() tells.
Finding check_receive_buffer(std::size_t usable_bytes);
/// Whether somebody keeps this machine's clock right (adjtimex).
Finding check_clock();
Finding check_cpu();
/// Interfaces that are up; wrong where `wanted` (name or address, may be empty) is not among them.
Finding check_interfaces(const std::string& wanted);
/// Whether a host has an IPv4 address.
Finding check_name(const std::string& host);
/// UDP ports that participants of the domain take on this machine, one after the other.
Finding check_ports(std::uint32_t domain);
/// Files of --security-dir as Cyclone will read them, and their end.
Finding check_certificates(const std::string& dir, std::int64_t now_s);
/// Learner and workers of a run: who speaks, and whether all are of one build.
std::vector<Finding> check_run(const RunState& state, const ToolOptions& options,
                               std::int64_t now_ns);

struct DoctorOptions {
  ToolOptions tool;       ///< without a run the bus is left out
  std::string version;    ///< of this program, for its first line
  double patience_s = 5;  ///< for the learner and the workers to speak
};

/// Prints every finding. Exit code: 0, or 1 if something is wrong.
int run_doctor(const DoctorOptions& options);

}  // namespace omentum
