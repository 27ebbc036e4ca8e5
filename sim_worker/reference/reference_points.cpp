// Points of the reference solid: shape functions, location of a point, the patch of a grasp.
#include <algorithm>
#include <map>

#include "core/check.h"
#include "sim_worker/reference/reference_model.h"
#include "sim_worker/tissue/grasp_patch.h"

namespace omentum {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Cells of a row of grid lines that touch the coordinate: one, or two if it lies on a line.
std::vector<int> cells_at(const std::vector<double>& lines, double value) {
  std::vector<int> cells;
  for (int k = 0; k + 1 < static_cast<int>(lines.size()); ++k) {
    if (value >= lines[k] - kSameLine && value <= lines[k + 1] + kSameLine) cells.push_back(k);
  }
  OMENTUM_CHECK(!cells.empty() && cells.size() <= 2, "coordinate {}", value);
  return cells;
}

double local_coordinate(const std::vector<double>& lines, int cell, double value) {
  const double t = 2 * (value - lines[cell]) / (lines[cell + 1] - lines[cell]) - 1;
  return std::clamp(t, -1.0, 1.0);
}

}  // namespace

std::array<double, 8> hex_functions(const Vector3d& xi) {
  std::array<double, 8> N{};
  for (int a = 0; a < 8; ++a) {
    N[a] = 0.125;
    for (int axis = 0; axis < 3; ++axis)
      N[a] *= ((a >> axis) & 1) != 0 ? 1 + xi[axis] : 1 - xi[axis];
  }
  return N;
}

BodyPoint ReferenceTissueModel::locate(const Vector3d& p_B) const {
  BodyPoint point;
  for (const int iy : cells_at(lines[1], p_B.y())) {
    for (const int ix : cells_at(lines[0], p_B.x())) {
      for (const int iz : cells_at(lines[2], p_B.z())) {
        point.locations.push_back(
            {element_index(ix, iy, iz),
             {local_coordinate(lines[0], ix, p_B.x()), local_coordinate(lines[1], iy, p_B.y()),
              local_coordinate(lines[2], iz, p_B.z())}});
      }
    }
  }
  return point;
}

GraspPatch ReferenceTissueModel::make_patch(const Vector2d& centre, double radius) const {
  const std::vector<PatchPoint> points = patch_points(free_sheet(), centre, radius);
  Vector2d mean = Vector2d::Zero();
  for (const PatchPoint& point : points) mean += point.weight * point.p;

  const double half = 0.5 * body.thickness;
  const int layers = cells(2);
  std::map<int, Eigen::Vector4d> rows;  // by node
  for (const PatchPoint& point : points) {
    const int ix = cells_at(lines[0], point.p.x()).front();
    const int iy = cells_at(lines[1], point.p.y()).front();
    for (int iz = 0; iz < layers; ++iz) {
      for (const double zeta : {-0.57735026918962576, 0.57735026918962576}) {  // Gauss
        const Vector3d xi(local_coordinate(lines[0], ix, point.p.x()),
                          local_coordinate(lines[1], iy, point.p.y()), zeta);
        const double z = 0.5 * (lines[2][iz] * (1 - zeta) + lines[2][iz + 1] * (1 + zeta));
        const Eigen::Vector4d row = point.weight / (2 * layers) *
                                    Eigen::Vector4d(1, (point.p.x() - mean.x()) / radius,
                                                    (point.p.y() - mean.y()) / radius, z / half);
        const std::array<double, 8> N = hex_functions(xi);
        const ReferenceElement& element = elements[element_index(ix, iy, iz)];
        for (int a = 0; a < 8; ++a)
          rows.try_emplace(element.node[a], Eigen::Vector4d::Zero()).first->second += N[a] * row;
      }
    }
  }
  GraspPatch patch;
  patch.weight.resize(static_cast<Eigen::Index>(rows.size()), GraspPatch::kRows);
  for (const auto& [node, row] : rows) {
    patch.weight.row(static_cast<Eigen::Index>(patch.node.size())) = row.transpose();
    patch.node.push_back(node);
  }
  int nearest = -1;
  double least = 0;
  for (int i = 0; i < static_cast<int>(body.particles.size()); ++i) {
    if (body.fixed[i] != 0) continue;
    const double distance = (body.particles[i].head<2>() - centre).norm();
    if (distance <= radius) patch.particles.push_back(i);
    if (nearest < 0 || distance < least) {
      nearest = i;
      least = distance;
    }
  }
  if (patch.particles.empty()) patch.particles.push_back(nearest);
  return patch;
}

}  // namespace omentum
