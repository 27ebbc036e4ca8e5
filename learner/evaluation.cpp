#include "learner/evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/limits.h"
#include "core/scene_draws.h"

namespace omentum {
namespace {

EvaluationSet make_set(const std::string& name, StartSet start_set, const pb::StartGrid& grid,
                       bool greedy) {
  EvaluationSet set;
  set.rows = grid.rows();
  set.columns = grid.columns();
  set.starts = set.rows * set.columns;
  set.name = fmt::format("{}{}_{}", name, set.starts, greedy ? "greedy" : "sampled");
  set.start_set = start_set;
  set.greedy = greedy;
  set.record = greedy;
  for (std::uint32_t i = 0; i < set.starts; ++i) set.start_indices.push_back(i);
  return set;
}

/// Particle of a grid at rest in B [m].
std::array<double, 3> rest_place(const pb::GridMaker& grid, std::uint32_t particle) {
  const std::uint32_t column = particle / grid.count_y();
  return {(column - 0.5 * (grid.count_x() - 1)) * grid.pitch_m(),
          (particle % grid.count_y() - 0.5 * (grid.count_y() - 1)) * grid.pitch_m(), 0};
}

/// Value of the one parameter that the start's scene was drawn with; NaN where none or all are.
double drawn_alone(const pb::Config& config, const EvaluationSet& set, std::uint32_t index) {
  EpisodeStart start;
  start.run_seed = config.rollout().run_seed();
  start.start_set = set.start_set;
  start.start_index = index;
  const std::optional<DrawKey> key = draw_key(start, set.starts);
  return key && key->alone ? drawn_value(config, *key->alone, *key) : std::nan("");
}

}  // namespace

std::vector<EvaluationSet> evaluation_sets(const pb::Config& config) {
  std::vector<EvaluationSet> sets;
  const pb::Scene& scene = config.scene();
  if (scene.has_start_grid())
    sets.push_back(make_set("grid", StartSet::kGrid, scene.start_grid(), true));
  if (config.evaluation().grasp_lattice() && !sets.empty()) {
    EvaluationSet lattice;
    lattice.name = "grasp_lattice";
    lattice.start_set = StartSet::kGraspLattice;
    sets.push_back(std::move(lattice));
  }
  if (scene.has_start_grid())
    sets.push_back(make_set("grid", StartSet::kGrid, scene.start_grid(), false));
  for (const bool greedy : {true, false}) {
    if (scene.has_robot_grid())
      sets.push_back(make_set("robot", StartSet::kRobotGrid, scene.robot_grid(), greedy));
  }
  for (const bool greedy : {true, false}) {
    if (!scene.has_start_grid() || config.randomise().empty()) break;
    sets.push_back(make_set("drawn", StartSet::kGridDrawn, scene.start_grid(), greedy));
    sets.back().record = false;  // a replay is of the scene of the configuration
  }
  for (int k = 0; k < config.randomise_size() && scene.has_start_grid(); ++k) {
    // By drawn actions: what is drawn is hidden from the policy (docs/decisions/0032).
    EvaluationSet set = make_set("drawn", StartSet::kGridDrawn, scene.start_grid(), false);
    set.name = fmt::format("drawn{}_{}_sampled", set.starts, config.randomise(k).parameter());
    for (std::uint32_t& index : set.start_indices)
      index += set.starts * (1 + static_cast<std::uint32_t>(k));
    sets.push_back(std::move(set));
  }
  return sets;
}

void fill_lattice(const pb::Config& config, std::uint32_t particles, EvaluationSet& set) {
  // Frames hold the nodes of a soft body behind the particles of the sheet; only these are grasped.
  const pb::Tissue& tissue = config.scene().tissue();
  if (tissue.has_grid())
    particles = std::min(particles, tissue.grid().count_x() * tissue.grid().count_y());
  for (std::uint32_t i = 0; i < particles; i += config.evaluation().lattice_stride())
    set.start_indices.push_back(i);
  set.starts = static_cast<std::uint32_t>(set.start_indices.size());
}

std::uint32_t particles_of(std::span<const RolloutSegment> segments, std::uint32_t frame_stride) {
  for (const RolloutSegment& s : segments) {
    if (s.failed != 0 || frame_stride == 0) continue;
    const std::size_t frames =
        s.steps / frame_stride + 1;  // before every stride-th step and after the last
    return static_cast<std::uint32_t>(s.frame_positions_in_world_m.size() / (3 * frames));
  }
  return 0;
}

std::vector<EvaluationTask> evaluation_tasks(const pb::Config& config, const EvaluationSet& set,
                                             std::uint64_t version) {
  const pb::Task& task = config.task();
  const bool lattice = set.start_set == StartSet::kGraspLattice;
  std::vector<EvaluationTask> tasks;
  for (const std::uint32_t index : set.start_indices) {
    EvaluationTask t;
    t.start_set = set.start_set;
    t.start_index = index;
    t.greedy = set.greedy;
    t.policy_version = version;
    t.policy_steps = lattice ? 0 : std::max(1U, task.episode_steps() / task.action_repeat());
    t.hold_steps = hold_steps(task);
    t.steps = evaluation_steps(config, lattice);
    t.frame_stride = set.record ? config.evaluation().frame_stride() : 0;
    tasks.push_back(t);
  }
  return tasks;
}

std::vector<EvaluationRow> judge(const pb::Config& config, const EvaluationSet& set,
                                 std::span<const RolloutSegment> segments, double best_exposure) {
  OMENTUM_CHECK(segments.size() == set.start_indices.size());
  const bool lattice = set.start_set == StartSet::kGraspLattice;
  const std::uint32_t columns = std::max(1U, set.columns);
  std::vector<EvaluationRow> rows;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const RolloutSegment& s = segments[i];
    EvaluationRow& r = rows.emplace_back(row_of_episode(s));
    r.index = set.start_indices[i];
    const std::uint32_t start = lattice ? 0 : r.index % std::max(1U, set.starts);
    r.row = lattice ? 0 : start / columns + 1;
    r.column = lattice ? 0 : start % columns + 1;
    r.drawn = drawn_alone(config, set, r.index);
    r.greedy = set.greedy;
    r.best_exposure = best_exposure;
    r.exposed = is_exposed(r, best_exposure);
    if (lattice && config.scene().tissue().has_grid())
      r.start = rest_place(config.scene().tissue().grid(), r.index);
  }
  return rows;
}

}  // namespace omentum
