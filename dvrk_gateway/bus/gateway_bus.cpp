#include "dvrk_gateway/bus/gateway_bus.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <optional>

#include "core/check.h"
#include "core/topics.h"

namespace omentum {

void add_bus_options(CLI::App& app, BusOptions& options) {
  app.add_option(
      "--run", options.run,
      "Name of the run on whose DDS topics the robot's state is published; default: none is");
  app.add_option("--domain", options.domain, "DDS domain of the run, 0 ... 230")
      ->check(CLI::Range(0, 230))
      ->capture_default_str();
  app.add_option("--arm", options.arm, "Name of the arm in topics and messages")
      ->capture_default_str();
  app.add_flag("--ros", options.ros,
               "Also publish rt/ARM/measured_cp and rt/ARM/operating_state, as ROS 2 reads them");
  add_dds_options(app, options.dds);
}

void check_bus_options(const BusOptions& options) {
  // A token of a ROS name.
  const std::string& arm = options.arm;
  const auto allowed = [](unsigned char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  };
  const bool digit_first = !arm.empty() && arm.front() >= '0' && arm.front() <= '9';
  if (arm.empty() || arm.size() > 63 || digit_first ||
      !std::all_of(arm.begin(), arm.end(), allowed))
    throw_error("--arm \"{}\": 1 to 63 of A-Z a-z 0-9 _, no digit first", arm);
  if (!options.run.empty()) {
    check_run_name(options.run);
  } else if (options.ros) {
    throw_error("--ros: needs --run, the name of the run on the bus");
  }
}

std::unique_ptr<dds::Participant> join_bus(const BusOptions& options,
                                           const std::function<bool()>& stop) {
  if (options.run.empty()) return nullptr;
  const std::optional<DdsProfile> profile =
      wait_for_dds_profile(options.dds, DdsRole::kOther, options.domain, 0, 0, stop);
  if (!profile) return nullptr;
  return std::make_unique<dds::Participant>(options.domain, profile->uri, "omentum-gateway");
}

}  // namespace omentum
