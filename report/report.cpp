#include "report/report.h"

#include <fmt/core.h>

#include <algorithm>
#include <filesystem>

#include "core/check.h"
#include "report/episodes.h"
#include "report/html.h"
#include "report/replay3d.h"
#include "report/section_parts.h"
#include "report/sections.h"

namespace omentum {
namespace {

constexpr std::size_t kShownEpisodes = 12;

std::string title_of(const std::vector<RunFolder>& runs) {
  if (runs.size() == 1) return runs.front().name;
  const std::filesystem::path parent =
      std::filesystem::weakly_canonical(runs.front().path).parent_path();
  return fmt::format("{}: {} seeds", parent.filename().string(), runs.size());
}

std::string subtitle_of(const std::vector<RunFolder>& runs,
                        const std::vector<ShownEpisode>& episodes) {
  std::string text = report_texts(runs).task();
  if (runs.size() > 1) {
    text += " Runs:";
    for (const RunFolder& run : runs) text += " " + run.name;
    text += ".";
  }
  if (!episodes.empty()) {
    const RecordingContext& context = episodes.front().recording.context;
    text +=
        fmt::format(" Revision {}, configuration {:016x}, policy version {}.", context.git_revision,
                    context.config_hash, episodes.front().recording.task.policy_version);
  }
  return text;
}

/// What the comparison of workers found wrong, above everything else.
std::string audit_of(const std::vector<RunFolder>& runs) {
  std::string text;
  for (const RunFolder& run : runs) {
    if (run.audit_mismatch.empty()) continue;
    text += missing(fmt::format("{} is not to be trusted: {}.", run.name, run.audit_mismatch));
  }
  return text;
}

}  // namespace

std::string make_report(const std::vector<RunFolder>& runs, const Scene* scene,
                        std::vector<std::string>* damaged) {
  OMENTUM_CHECK(!runs.empty());
  std::vector<std::string> warnings;
  const std::vector<ShownEpisode> episodes = choose_episodes(runs, kShownEpisodes, warnings);
  std::vector<std::string> all;
  for (const RunFolder& run : runs) {
    for (const std::string& warning : run.warnings) all.push_back(run.name + ": " + warning);
  }
  all.insert(all.end(), warnings.begin(), warnings.end());
  if (damaged != nullptr) *damaged = all;
  std::vector<Section> sections = {make_learning_section(runs),
                                   make_grid_section(runs),
                                   make_drawn_section(runs),
                                   make_episode_section(episodes, scene, warnings),
                                   make_replay_section(episodes, scene),
                                   make_lattice_section(runs),
                                   make_robot_section(runs),
                                   make_grasp_section(runs),
                                   make_numbers_section(runs),
                                   make_config_section(runs, all)};
  std::erase_if(sections, [](const Section& section) { return section.content.empty(); });
  return make_page(title_of(runs), subtitle_of(runs, episodes),
                   audit_of(runs) + make_overview(runs), sections, replay_script(),
                   "Made by the program <code>report</code> of Omentum. This file is complete in "
                   "itself: it loads nothing from anywhere.");
}

}  // namespace omentum
