#include "learner/summary.h"

#include <span>
#include <utility>

#include "core/durable_file.h"
#include "learner/json.h"

namespace omentum {

std::string summary_json(const RunSummary& summary) {
  Json json = {{"format_version", 1},
               {"run_id", summary.run_id},
               {"weights_hash", summary.weights_hash},
               {"config_hash", summary.config_hash},
               {"git_revision", summary.git_revision},
               {"run_seed", summary.run_seed},
               {"steps", summary.steps},
               {"physics_steps", summary.physics_steps},
               {"updates", summary.updates},
               {"episodes", summary.episodes},
               {"wall_s", json_number(summary.wall_s)},
               {"mean_return", json_number(summary.mean_return)},
               {"results_compared", summary.compared},
               {"audit_mismatch", summary.audit_mismatch},
               {"timings", Json::object()},
               {"evaluations", Json::array()}};
  for (const auto& [name, seconds] : summary.timings) json["timings"][name] = json_number(seconds);
  for (const EvaluationSummary& evaluation : summary.evaluations) {
    const EvaluationFigures& figures = evaluation.figures;
    json["evaluations"].push_back({{"name", evaluation.name},
                                   {"starts", figures.starts},
                                   {"target_reached", figures.target_reached},
                                   {"exposed", figures.exposed},
                                   {"grasp_held", figures.grasp_held},
                                   {"best_exposure", json_number(evaluation.best_exposure)},
                                   {"failed", figures.failed},
                                   {"held", figures.held},
                                   {"lost", figures.lost},
                                   {"mean_exposure", json_number(figures.mean_exposure)},
                                   {"mean_return", json_number(figures.mean_return)}});
  }
  return json_text(json, 2) + "\n";
}

Result<void> write_summary(const std::string& path, const RunSummary& summary) {
  return write_durably(path, summary_json(summary));
}

}  // namespace omentum
