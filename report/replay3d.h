#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/episode_recording.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// What belongs to one frame. Frames show the state before a step, while the arrays of a segment
/// hold tool and exposure after it, so this is entry step - 1 (and the start of the tool for the
/// first frame).
struct FrameState {
  std::uint32_t step = 0;                ///< decisions taken before the frame
  double time = 0;                       ///< simulated [s]
  std::array<float, 3> tool_position{};  ///< p_WT [m], NaN if not recorded
  float exposure = 0;                    ///< NaN if not recorded
  bool held = false;
};
FrameState frame_state(const EpisodeRecording& recording, std::size_t frame);

/// An episode to show, with the words for its pane.
struct ReplayEpisode {
  std::string label;  ///< e.g. "start (8, 6): exposure 71 %"
  const EpisodeRecording* recording = nullptr;
};

/// Markup of the 3-D replay: two panes side by side (the first two episodes; any can be chosen in
/// each), one time slider for both, play and pause, orbit by drag, zoom by wheel or pinch.
/// Positions are embedded as base64 int16 of 1/65535 of the scene's extent (about 5 um) and at most
/// 120 frames per episode.
std::string make_replay_markup(const Scene& scene, const std::vector<ReplayEpisode>& episodes);

/// A surface over time with what a camera saw of it.
struct SurfaceReplay {
  std::string label;
  std::vector<double> times;                           ///< of the frames [s]
  std::vector<std::vector<Eigen::Vector3d>> vertices;  ///< of every frame, p_W [m]
  std::vector<std::vector<Eigen::Vector3d>> clouds;    ///< of every frame, p_W [m]
  std::vector<Eigen::Vector3d> tips;                   ///< of the tool, p_WT [m]
  std::vector<std::string> notes;                      ///< in the pane's corner
};

/// The same viewer for surfaces of these triangles: clouds as dots over them, the cloud of the
/// nearest frame. Two panes, the first two replays. At most 30 frames of a replay and 900 points of
/// a cloud are embedded.
std::string make_surface_markup(const Scene& scene, const std::vector<Eigen::Vector3i>& triangles,
                                const std::vector<SurfaceReplay>& replays);

/// One pane for an environment that runs now: the scene with its tissue at rest, until the page
/// calls show_frame({positions, tools, held, note}): Float32Array of x y z of SurfaceSkin's
/// vertices and of the tool [m, W], [1] or [0], and the words in the pane's corner. Empty where the
/// surface has too many vertices for a page.
std::string make_live_markup(const Scene& scene);

/// The script behind both: plain JavaScript, WebGL with a 2-D canvas as fallback, no network.
/// Opening the report with #selftest (or #selftest-2d for the fallback) moves the slider, compares
/// the drawn pictures and writes "ok ..." or "failed ..." into data-selftest of the html element.
std::string replay_script();

}  // namespace omentum
