#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "core/evaluation_table.h"
#include "core/result.h"

namespace omentum {

/// Outcome of one evaluation set, e.g. grid100_greedy.
struct EvaluationSummary {
  std::string name;
  EvaluationFigures figures;
  double best_exposure = 0;  ///< of the grasp lattice
};

/// What a run came to; written to <run folder>/summary.json at the end and after every evaluation.
struct RunSummary {
  std::string run_id;
  std::string weights_hash;  ///< hex
  std::string config_hash;   ///< hex
  std::string git_revision;
  std::uint64_t run_seed = 0;
  std::uint64_t steps = 0;
  std::uint64_t physics_steps = 0;
  std::uint64_t updates = 0;
  std::uint64_t episodes = 0;
  double wall_s = 0;
  double mean_return = 0;                 ///< in training, of the last 100 episodes
  std::map<std::string, double> timings;  ///< [s], see Learner
  std::uint64_t compared = 0;             ///< second results of a task
  std::string audit_mismatch;             ///< whose results differed; empty: they agree
  std::vector<EvaluationSummary> evaluations;
};

std::string summary_json(const RunSummary& summary);

/// Durable write.
Result<void> write_summary(const std::string& path, const RunSummary& summary);

}  // namespace omentum
