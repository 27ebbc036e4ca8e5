#include "mismatch/explain/predict.h"

#include "mismatch/fit/camera_errors.h"
#include "mismatch/fit/forward_model.h"
#include "mismatch/fit/search.h"

namespace omentum {
namespace {

/// A scene under the commands of all recordings.
struct Simulated {
  Simulated(const pb::Scene& scene, const std::vector<Observation>& observations,
            const FitSetup& setup, const Numerics& numerics)
      : data(make_fit_data(scene, observations, setup)), at(believed_state(data)) {
    take_camera_errors(data, scene, at);
    ReferenceForward forward;
    linear = {at, forward.simulate(data, at, numerics, false, all_of(observations.size()))};
  }

  bool valid(std::size_t r, std::size_t f) const { return linear.predictions[r].frames[f].valid; }
  std::vector<Eigen::Vector3d> upper_face(std::size_t r, std::size_t f) const {
    auto vertices = data.likelihood.vertices(comparison(data, linear, at, r), f);
    vertices.resize(data.made.tissue.particles.size());
    return vertices;
  }

  FitData data;
  FitState at;
  Linearisation linear;
};

}  // namespace

Foretold predict_commands(const pb::Scene& base, const pb::Scene& model,
                          const std::vector<Observation>& observations, const FitSetup& setup,
                          double tolerance_m) {
  const Numerics numerics{pb::TISSUE_REFERENCE,
                          count_elements(base, setup.folder, observations, tolerance_m), 1};
  const Simulated without(base, observations, setup, numerics);
  const Simulated with(model, observations, setup, numerics);
  Foretold made;
  for (const Eigen::Vector3d& p : without.data.made.tissue.particles)
    made.uv_B.push_back(p.head<2>());
  for (std::size_t r = 0; r < observations.size(); ++r) {
    PredictedRecording& out = made.recordings.emplace_back();
    out.name = observations[r].name;
    std::string failure;
    for (const Simulated* one : {&without, &with}) {
      if (failure.empty()) failure = one->linear.predictions[r].failure;
    }
    made.failures.push_back(failure);
    for (std::size_t f = 0; f < observations[r].frames.size(); ++f) {
      if (!without.valid(r, f) || !with.valid(r, f)) continue;
      out.times.push_back(observations[r].frames[f].t);
      out.base.push_back(without.upper_face(r, f));
      out.model.push_back(with.upper_face(r, f));
    }
  }
  return made;
}

}  // namespace omentum
