#include "sim_worker/shell/plate_stencils.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "sim_worker/shell/shell_kernel.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::Vector4d;
using Weight = CurvatureStencil::Weight;

/// Stencils of a grid under construction.
struct GridStencils {
  std::span<const Vector3d> nodes;
  int nx = 0, ny = 0;
  double pitch = 0;
  const IsClamped& is_clamped;

  Vector3d place(int i) const { return nodes[i]; }

  /// 2 on the edge of the clamp across this stride.
  double clamp(int i, int stride) const {
    return is_clamped(i) && is_clamped(i - stride) != is_clamped(i + stride) ? 2 : 1;
  }

  /// Curvatures at a node along the axes along which it has two neighbours; the tangent along the
  /// other one ends at the rim.
  PlateStencil of_node(int ix, int iy) const {
    const int i = ny * ix + iy;
    const double second = 1 / (pitch * pitch);
    PlateStencil stencil;
    stencil.at.base = i;
    stencil.place = place(i);
    stencil.area = pitch * pitch;
    const std::array<bool, 2> inside = {ix > 0 && ix + 1 < nx, iy > 0 && iy + 1 < ny};
    const std::array<bool, 2> at_low_rim = {ix == 0, iy == 0};
    stencil.beam = !(inside[0] && inside[1]);
    for (std::size_t axis = 0; axis < 2; ++axis) {
      const int stride = axis == 0 ? ny : 1;
      Weight w = Weight::Zero();
      const auto tangent = static_cast<Eigen::Index>(3 + axis);
      if (!inside[axis]) {
        w[tangent] = at_low_rim[axis] ? 1 / pitch : -1 / pitch;
        stencil.at.add(at_low_rim[axis] ? i + stride : i - stride, w);
        continue;
      }
      const auto k = static_cast<Eigen::Index>(axis);
      w[k] = second;
      w[tangent] = 0.5 / pitch;
      stencil.at.add(i + stride, w);
      w[tangent] = -0.5 / pitch;
      stencil.at.add(i - stride, w);
      stencil.fraction[k] = stencil.beam ? 0.5 : 1;
      stencil.clamp[k] = clamp(i, stride);
    }
    stencil.fraction[2] = stencil.beam ? 0 : 1;
    return stencil;
  }

  /// Twist of the cell between four nodes.
  PlateStencil of_cell(int ix, int iy) const {
    const int i = ny * ix + iy;
    const double second = 1 / (pitch * pitch);
    const double half = 0.5 / pitch;
    PlateStencil stencil;
    stencil.at.base = i;
    stencil.at.add(i + 1, (Weight() << 0, 0, -second, -half, half).finished());
    stencil.at.add(i + ny, (Weight() << 0, 0, -second, half, -half).finished());
    stencil.at.add(i + ny + 1, (Weight() << 0, 0, second, half, half).finished());
    stencil.place = 0.5 * (place(i) + place(i + ny + 1));
    stencil.area = pitch * pitch;
    stencil.fraction[3] = 1;
    return stencil;
  }
};

}  // namespace

Vector3d curvature(const CurvatureStencil& stencil, std::span<const Vector3d> places) {
  const Vector3d& base = places[stencil.base];
  Eigen::Matrix<double, 3, 5> sum = Eigen::Matrix<double, 3, 5>::Zero();
  for (std::size_t k = 0; k < stencil.node.size(); ++k) {
    const Vector3d to = places[stencil.node[k]] - base;
    sum += to * stencil.weight[k].transpose();
  }
  const Vector3d normal = sum.col(3).cross(sum.col(4));
  return sum.leftCols<3>().transpose() * normal / std::max(normal.norm(), kLeastNormal);
}

std::vector<PlateStencil> grid_stencils(std::span<const Vector3d> nodes, int count_x, int count_y,
                                        double pitch, const IsClamped& is_clamped) {
  const GridStencils grid{nodes, count_x, count_y, pitch, is_clamped};
  std::vector<PlateStencil> stencils;
  for (int ix = 0; ix < count_x; ++ix)
    for (int iy = 0; iy < count_y; ++iy) stencils.push_back(grid.of_node(ix, iy));
  for (int ix = 0; ix + 1 < count_x; ++ix)
    for (int iy = 0; iy + 1 < count_y; ++iy) stencils.push_back(grid.of_cell(ix, iy));
  return stencils;
}

std::vector<PlateStencil> mesh_stencils(const SheetGeometry& mesh, std::span<const Vector3d> nodes,
                                        const IsClamped& is_clamped) {
  std::vector<PlateStencil> stencils;
  for (std::size_t i = 0; i < mesh.curvature.size(); ++i) {
    PlateStencil stencil;
    stencil.at = mesh.curvature[i];
    stencil.place = nodes[i];
    stencil.rest = curvature(stencil.at, nodes);
    stencil.fraction.setOnes();
    const auto& around = stencil.at.node;
    const bool edge =
        is_clamped(stencil.at.base) &&
        !std::all_of(around.begin(), around.end(), [&](std::int32_t j) { return is_clamped(j); });
    stencil.clamp.setConstant(edge ? 2 : 1);
    stencil.area = mesh.node_area[i];
    stencils.push_back(std::move(stencil));
  }
  return stencils;
}

Vector4d plate_stiffness(const PlateStencil& stencil, const Vector4d& fraction, double beam,
                         double nu) {
  const double bending = stencil.area * (stencil.beam ? beam : beam / (1 - nu * nu));
  return bending * fraction.cwiseProduct(Vector4d(1, 1, nu, 2 * (1 - nu)));
}

Vector3d plate_moments(const Vector4d& stiffness, const Vector3d& curvature) {
  return {stiffness[0] * curvature[0] + stiffness[2] * curvature[1],
          stiffness[1] * curvature[1] + stiffness[2] * curvature[0], stiffness[3] * curvature[2]};
}

NodeMatrix plate_matrix(int nodes, std::span<const PlateStencil> stencils,
                        std::span<const Vector4d> stiffness) {
  std::vector<std::map<std::int32_t, double>> rows(nodes);
  std::vector<std::pair<std::int32_t, Vector3d>> bends;  // nodes that the curvatures depend on
  for (std::size_t s = 0; s < stencils.size(); ++s) {
    const CurvatureStencil& at = stencils[s].at;
    bends.assign(1, {at.base, Vector3d::Zero()});
    for (std::size_t k = 0; k < at.node.size(); ++k) {
      const Vector3d second = at.weight[k].head<3>();
      if (second == Vector3d::Zero()) continue;
      bends.emplace_back(at.node[k], second);
      bends[0].second -= second;
    }
    for (const auto& [i, weight] : bends) {
      const Vector3d moments = plate_moments(stiffness[s], weight);
      // Also where the product is zero, so that every Poisson ratio gives one pattern.
      for (const auto& [j, other] : bends)
        if (i != j) rows[i][j] += moments.dot(other);
    }
  }
  NodeMatrix matrix;
  matrix.begin.push_back(0);
  for (const auto& row : rows) {
    for (const auto& [node, value] : row) {
      matrix.node.push_back(node);
      matrix.value.push_back(value);
    }
    matrix.begin.push_back(static_cast<std::int32_t>(matrix.node.size()));
  }
  return matrix;
}

}  // namespace omentum
