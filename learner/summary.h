#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "core/result.h"

namespace omentum {

/// Outcome of one evaluation set, e.g. grid100_greedy.
struct EvaluationSummary {
  std::string name;
  std::uint64_t starts = 0;
  std::uint64_t target_reached = 0;
  std::uint64_t exposed = 0;     ///< tumour exposed at the end
  std::uint64_t grasp_held = 0;  ///< tissue grasped and never lost
  double best_exposure = 0;      ///< of the grasp lattice
  std::uint64_t failed = 0;      ///< the simulation diverged
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
  double mean_return = 0;                 ///< of the last update with finished episodes
  std::map<std::string, double> timings;  ///< [s], see Learner
  std::uint64_t compared = 0;             ///< second results of a task
  std::string audit_mismatch;             ///< whose results differed; empty: they agree
  std::vector<EvaluationSummary> evaluations;
};

std::string summary_json(const RunSummary& summary);

/// Durable write.
Result<void> write_summary(const std::string& path, const RunSummary& summary);

}  // namespace omentum
