#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "dvrk_gateway/bus/gateway_bus.h"
#include "dvrk_gateway/recording/gateway_recording.h"

namespace omentum {

/// docs/dvrk.md 8.3
enum class GatewayMode { kTwin, kMeasured, kReplay, kTeach };

/// The command line of dvrk_gateway (docs/dvrk.md 8).
struct GatewayOptions {
  std::string robot_host;        ///< sends the stream
  std::uint16_t robot_port = 0;  ///< of this machine, where the stream arrives
  std::string policy;  ///< checkpoint, run folder, or "bus": what the learner of bus.run publishes
  GatewayMode mode = GatewayMode::kTwin;
  std::string registration;  ///< registration.txtpb; empty: the base of the scene file
  std::string instrument = "large_needle_driver";
  std::string base_frame = "0,0,0,1,0,0,0";  ///< parse_base_frame()
  std::string limits;                        ///< SafetyLimits as protobuf text; empty: the defaults
  std::uint64_t run_seed = 1;                ///< of drawn starts
  int episodes = 1;
  /// As the policy draws them, as in training; the most probable ones. Nothing: drawn where the run
  /// of the policy drew scenes (docs/decisions/0032), else the most probable.
  std::optional<bool> drawn_actions;
  bool robot_grid = false;  ///< starts are the robot grid of the scene, not drawn
  bool dry_run = false;
  RecordingOptions recording;
  BusOptions bus;
  double seconds = 3;           ///< of `check`
  std::string motion;           ///< of mode replay: a recording, or a table of it
  double slow = 1;              ///< the motion takes so many times as long
  std::string folder;           ///< of `experiment`
  std::uint32_t starts = 25;    ///< of `experiment`, the first ones of the grid
  bool ask_outcome = false;     ///< `experiment` asks for each outcome instead of reading the jaw
  std::string touches, pivots;  ///< tables of `register`; pivots may be empty
  std::string points;           ///< of `touches`, which writes the table `touches`
};

}  // namespace omentum
