#include "sim_worker/playback/mesh_error.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace omentum {
namespace {

constexpr double kRatio = 1.5;

/// A mesh whose cells are kRatio times as long, in as many layers where these are few and follow
/// from the tolerance.
pb::ReferenceModel coarser_mesh(pb::ReferenceModel mesh, const std::array<int, 3>& cells) {
  const auto fewer = [](int count) {
    return static_cast<std::uint32_t>(std::max(1.0, std::round(count / kRatio)));
  };
  // The cell follows the root 3/8 of the tolerance (reference_mesh.cpp).
  mesh.set_tolerance_m(mesh.tolerance_m() * kRatio * kRatio * std::cbrt(kRatio * kRatio));
  if (mesh.elements_x() > 0) mesh.set_elements_x(fewer(cells[0]));
  if (mesh.elements_y() > 0) mesh.set_elements_y(fewer(cells[1]));
  // A sheet keeps its few layers: from five to three or three to two is no step of one refinement.
  constexpr int kFew = 5;
  const auto layers = static_cast<std::uint32_t>(std::min(cells[2], kFew));
  mesh.set_elements_z(mesh.elements_z() > 0 ? fewer(cells[2]) : std::max(layers, fewer(cells[2])));
  return mesh;
}

/// Of the finer of two meshes between which the error grows by the factor `growth`.
MeshError of_difference(const SimulatedRecording& fine, const SimulatedRecording& coarse,
                        double growth) {
  const double share = 1 / (growth - 1);
  MeshError error;
  double forces = 0;
  const std::size_t steps = fine.time.size();
  for (std::size_t k = 0; k < steps; ++k) {
    double squares = 0;
    for (std::size_t i = 0; i < fine.points[k].size(); ++i)
      squares += (fine.points[k][i] - coarse.points[k][i]).squaredNorm();
    squares /= static_cast<double>(fine.points[k].size());
    error.rms_m += squares / static_cast<double>(steps);
    error.worst_rms_m = std::max(error.worst_rms_m, squares);
    error.force += (fine.force[k] - coarse.force[k]).squaredNorm();
    forces += fine.force[k].squaredNorm();
  }
  error.rms_m = share * std::sqrt(error.rms_m);
  error.worst_rms_m = share * std::sqrt(error.worst_rms_m);
  error.force = forces > 0 ? share * std::sqrt(error.force / forces) : 0;
  return error;
}

}  // namespace

std::optional<MeshError> find_mesh_error(
    const SimulatedRecording& fine, const pb::ReferenceModel& mesh, const std::array<int, 3>& cells,
    const std::function<SimulatedRecording(const pb::ReferenceModel&)>& run,
    std::vector<std::string>& warnings) {
  pb::ReferenceModel other = coarser_mesh(mesh, cells);
  const SimulatedRecording coarse = run(other);
  if (!coarse.failure.empty()) {
    warnings.push_back("no estimate of the discretisation error: with larger cells " +
                       coarse.failure);
    return std::nullopt;
  }
  const MeshError by_cells = of_difference(fine, coarse, kRatio * kRatio);
  const int layers = cells[2];
  const int fewer = static_cast<int>(std::lround(layers / kRatio));
  const bool kept = static_cast<int>(other.elements_z()) == layers;
  if (!kept || fewer < 2 || fewer == layers) return by_cells;  // one is no mesh of a bent sheet
  other.set_elements_z(static_cast<std::uint32_t>(fewer));
  const SimulatedRecording flat = run(other);
  if (!flat.failure.empty()) {
    warnings.push_back(
        "the estimate of the discretisation error lacks what the layers leave: with fewer " +
        flat.failure);
    return by_cells;
  }
  const double ratio = static_cast<double>(layers) / fewer;
  const MeshError by_layers = of_difference(coarse, flat, ratio * ratio * ratio);
  return MeshError{std::hypot(by_cells.rms_m, by_layers.rms_m),
                   std::hypot(by_cells.worst_rms_m, by_layers.worst_rms_m),
                   std::hypot(by_cells.force, by_layers.force)};
}

}  // namespace omentum
