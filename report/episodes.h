#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/episode_recording.h"
#include "report/html.h"
#include "report/run_folder.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// A recorded evaluation episode with its row of the evaluation table.
struct ShownEpisode {
  std::string set;
  EvaluationRow start;
  EpisodeRecording recording;
  std::string label() const;  ///< "start (8, 6): exposure 71 %"
};

/// The recordings of the report, best first: of the first run that has any, at most `limit`, among
/// them the best and the worst by exposure at the end (greedy grid first). Every recording is
/// looked at: what of one cannot be read, or has no row in a table, becomes a line in `warnings`.
std::vector<ShownEpisode> choose_episodes(const std::vector<RunFolder>& runs, std::size_t limit,
                                          std::vector<std::string>& warnings);

/// Whether the first and the last differ by what a label tells: else none is best or worst.
bool are_ranked(const std::vector<ShownEpisode>& episodes);

/// Pictures of the best and the worst episode (start, grasp, end of hold), exposure curves of all,
/// and what was wrong with recordings; and the replay. Without a scene there are curves only.
Section make_episode_section(const std::vector<ShownEpisode>& episodes, const Scene* scene,
                             const std::vector<std::string>& warnings);
Section make_replay_section(const std::vector<ShownEpisode>& episodes, const Scene* scene);

/// Index of the recorded frame at which the tissue is first held, if it ever is.
std::optional<std::size_t> grasp_frame(const EpisodeRecording& recording);

}  // namespace omentum
