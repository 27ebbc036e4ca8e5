#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "core/types.h"
#include "monitor/frame_desk.h"
#include "monitor/run_state.h"
#include "report/skin.h"

namespace omentum {

/// The scene of a run, ready for the 3-D view: from the configuration in the manifest. Immutable.
struct LiveScene {
  std::uint64_t config_hash = 0;
  std::string markup;                 ///< of the pane; empty when there is none
  std::string problem;                ///< why there is none
  std::size_t points = 0;             ///< particles of a frame
  std::unique_ptr<SurfaceSkin> skin;  ///< null without a pane
};

/// Never fails: what is wrong is in `problem` (meshes that are not on this machine, for one).
LiveScene make_live_scene(const RunManifest& manifest);

/// The page: frame, style, script and 3-D pane; what changes comes with make_state_json() and
/// make_curves_json(). Loads nothing from anywhere.
std::string make_monitor_page(const std::string& run, const LiveScene& scene);

/// Tiles, alarms, workers and ledger as markup, by the id of the element they belong into.
std::string make_state_json(const RunState& state, const LiveScene& scene, std::int64_t now_ns);

/// The learning curves as markup.
std::string make_curves_json(const RunState& state);

/// One frame: its words and the surface as base64 of float32. Empty when it is not one of this
/// scene.
std::string make_frame_json(const NumberedFrame& frame, const LiveScene& scene);

}  // namespace omentum
