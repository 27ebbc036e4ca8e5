#include "learner/summary.h"

#include <span>

#include "learner/durable_file.h"
#include "learner/json_writer.h"

namespace omentum {

std::string summary_json(const RunSummary& summary) {
  JsonWriter json;
  json.begin_object();
  json.key("format_version").value(std::uint64_t{1});
  json.key("run_id").value(summary.run_id);
  json.key("weights_hash").value(summary.weights_hash);
  json.key("config_hash").value(summary.config_hash);
  json.key("git_revision").value(summary.git_revision);
  json.key("run_seed").value(summary.run_seed);
  json.key("steps").value(summary.steps);
  json.key("physics_steps").value(summary.physics_steps);
  json.key("updates").value(summary.updates);
  json.key("episodes").value(summary.episodes);
  json.key("wall_s").value(summary.wall_s);
  json.key("mean_return").value(summary.mean_return);
  json.key("timings").begin_object();
  for (const auto& [name, seconds] : summary.timings) json.key(name).value(seconds);
  json.end_object();
  json.key("evaluations").begin_array();
  for (const EvaluationSummary& evaluation : summary.evaluations) {
    json.begin_object();
    json.key("name").value(evaluation.name);
    json.key("starts").value(evaluation.starts);
    json.key("target_reached").value(evaluation.target_reached);
    json.key("exposed").value(evaluation.exposed);
    json.key("grasp_held").value(evaluation.grasp_held);
    for (const auto& [name, value] : evaluation.values) json.key(name).value(value);
    json.end_object();
  }
  json.end_array();
  json.end_object();
  return json.text() + "\n";
}

Result<void> write_summary(const std::string& path, const RunSummary& summary) {
  const std::string text = summary_json(summary);
  return write_durably(path, std::as_bytes(std::span(text)));
}

}  // namespace omentum
