#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "core/dds.h"
#include "core/dds_options.h"

namespace CLI {  // NOLINT(readability-identifier-naming): the library's name
class App;
}

namespace omentum {

/// The gateway's place on the bus, as its command line tells it (docs/dvrk.md 10).
struct BusOptions {
  std::string run;           ///< empty: no DDS at all
  std::uint32_t domain = 0;  ///< 0 ... 230
  DdsOptions dds;
  std::string arm = "PSM1";  ///< name of the arm in CRTK's topics
  bool ros = false;          ///< also as ROS 2 reads it
};

/// Adds --run, --domain, --arm, --ros and the network options.
void add_bus_options(CLI::App& app, BusOptions& options);
/// Throws Error: one line, for options that need --run or that are no names.
void check_bus_options(const BusOptions& options);

/// Joins the run's domain, waiting for names of hosts as learner and workers do. Null without
/// --run, and when `stop` became true meanwhile. Throws Error.
std::unique_ptr<dds::Participant> join_bus(const BusOptions& options,
                                           const std::function<bool()>& stop);

}  // namespace omentum
