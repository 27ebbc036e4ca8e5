#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/evaluation_table.h"
#include "core/types.h"
#include "learner/task_book.h"
#include "proto/config.pb.h"

namespace omentum {

/// One set of evaluation episodes: fixed starts that training never uses, run by the workers over
/// the bus.
struct EvaluationSet {
  /// grid100_greedy, grid100_sampled, robot25_greedy, ..., grasp_lattice; where the configuration
  /// draws parameters of the scene also drawn100_greedy, drawn100_sampled: the grid in drawn
  /// scenes, and drawn100_<parameter>_sampled: with that parameter drawn alone.
  std::string name;
  StartSet start_set = StartSet::kGrid;
  bool greedy = true;
  bool record = false;  ///< tissue frames and an MCAP file per episode
  std::uint32_t starts = 0;
  std::uint32_t rows = 0, columns = 0;
  std::vector<std::uint32_t> start_indices;
};

/// The sets of a configuration: the recorded grid first, then the grasp lattice (still without
/// starts, see fill_lattice), whose best exposure is the reference of all, then the others.
std::vector<EvaluationSet> evaluation_sets(const pb::Config& config);

/// Appends one start per lattice_stride-th particle to a set that has none.
void fill_lattice(const pb::Config& config, std::uint32_t particles, EvaluationSet& set);

/// Tissue particles, from the frames of recorded segments; 0 if there are none.
std::uint32_t particles_of(std::span<const RolloutSegment> segments, std::uint32_t frame_stride);

/// Tasks of one set for weights of `version`: the policy acts until the target is reached or its
/// episode is over, then the hold script stands at p_T for task.hold_s.
std::vector<EvaluationTask> evaluation_tasks(const pb::Config& config, const EvaluationSet& set,
                                             std::uint64_t version);

/// Reads the rows of a set's table off its segments, in its order; `best_exposure` <= 0 judges
/// nothing exposed. Segments have passed check_segment(); aborts unless there is one per start.
std::vector<EvaluationRow> judge(const pb::Config& config, const EvaluationSet& set,
                                 std::span<const RolloutSegment> segments, double best_exposure);

}  // namespace omentum
