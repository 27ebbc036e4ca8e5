#pragma once

#include <cstdint>
#include <string>

namespace omentum {

/// The command line of dvrk_gateway (docs/dvrk.md 8).
struct GatewayOptions {
  std::string robot_host;        ///< sends the stream
  std::uint16_t robot_port = 0;  ///< of this machine, where the stream arrives
  std::string policy;            ///< checkpoint or run folder
  std::string registration;      ///< registration.txtpb; empty: the base of the scene file
  std::string instrument = "large_needle_driver";
  std::string limits;          ///< SafetyLimits as protobuf text; empty: the defaults
  std::uint64_t run_seed = 1;  ///< of drawn starts
  int episodes = 1;
  bool robot_grid = false;  ///< starts are the robot grid of the scene, not drawn
  bool dry_run = false;
  double seconds = 3;           ///< of `check`
  std::string touches, pivots;  ///< tables of `register`; pivots may be empty
};

/// Runs episodes of the policy in mode twin; keys and signals arm, stop and end (docs/dvrk.md 8.2).
/// Throws Error for what is wrong at the start. Exit code: 0 all episodes ran, 1 ended before.
int run_gateway(const GatewayOptions& options);

/// Makes options.registration of the tables of touches and prints it. Exit code: 0 done, 1 the
/// touches do not determine where the arm stands.
int register_robot(const GatewayOptions& options);

/// Listens, arms nothing, sends nothing: a line per stream and per thing that is missing, then "go"
/// or "no go". Exit code: 0 go, 1 no go.
int check_robot(const GatewayOptions& options);

}  // namespace omentum
