#include "mismatch/explain/predictions_file.h"

#include <string>
#include <utility>

#include "core/check.h"
#include "sim_worker/playback/npz.h"

namespace omentum {

void write_predictions(const std::vector<PredictedRecording>& recordings,
                       const std::vector<Eigen::Vector2d>& uv_B, const pb::Scene& scene,
                       const std::filesystem::path& folder) {
  std::error_code failed;
  std::filesystem::create_directories(folder, failed);
  if (failed) throw_error("{}: cannot be made: {}", folder.string(), failed.message());
  const std::size_t n = scene.tissue().grid().count_x(), m = scene.tissue().grid().count_y();
  std::vector<double> uv;
  for (const Eigen::Vector2d& p : uv_B) uv.insert(uv.end(), {p.x(), p.y()});
  for (const PredictedRecording& recording : recordings) {
    NpzFile file;
    file.add("t_s", {recording.times.size()}, recording.times);
    file.add("uv_B", {n, m, 2}, uv);
    for (const auto& [name, surfaces] :
         {std::pair{"base", &recording.base}, {"model", &recording.model}}) {
      std::vector<double> values;
      for (const auto& surface : *surfaces) {
        for (const Eigen::Vector3d& p : surface) values.insert(values.end(), {p.x(), p.y(), p.z()});
      }
      file.add(name, {surfaces->size(), n, m, 3}, values);
    }
    file.write((folder / (recording.name + ".npz")).string());
  }
}

}  // namespace omentum
