#include "sim_worker/geometry/sheet_mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "core/decompositions.h"
#include "sim_worker/geometry/surface_search.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

using Neighbours = std::vector<std::vector<std::int32_t>>;

// Smallest singular value of a fit relative to its largest: on a regular mesh 0.2.
constexpr double kLeastCondition = 0.03;

/// Axes x, y of a triangle's or node's frame (SheetTriangle) as columns.
Eigen::Matrix<double, 3, 2> tangent_axes(const Vector3d& normal) {
  Vector3d x = Vector3d::UnitX() - normal.x() * normal;
  if (x.norm() < 0.2) x = Vector3d::UnitY() - normal.y() * normal;
  Eigen::Matrix<double, 3, 2> axes;
  axes.col(0) = x.normalized();
  axes.col(1) = normal.cross(axes.col(0));
  return axes;
}

void sort_unique(std::vector<std::int32_t>& list) {
  std::sort(list.begin(), list.end());
  list.erase(std::unique(list.begin(), list.end()), list.end());
}

/// Nodes that share a triangle, ascending.
Neighbours find_neighbours(std::size_t nodes, std::span<const Eigen::Vector3i> triangles) {
  Neighbours neighbours(nodes);
  for (const Eigen::Vector3i& t : triangles) {
    for (int k = 0; k < 3; ++k) {
      neighbours[t[k]].push_back(t[(k + 1) % 3]);
      neighbours[t[k]].push_back(t[(k + 2) % 3]);
    }
  }
  for (auto& list : neighbours) sort_unique(list);
  return neighbours;
}

/// `ring` and the neighbours of its nodes, ascending, without `node`.
std::vector<std::int32_t> widen(const std::vector<std::int32_t>& ring, std::int32_t node,
                                const Neighbours& neighbours) {
  std::vector<std::int32_t> wide = ring;
  for (const std::int32_t i : ring) {
    const auto& more = neighbours[i];
    wide.insert(wide.end(), more.begin(), more.end());
  }
  sort_unique(wide);
  std::erase(wide, node);
  return wide;
}

/// Least squares fit of f(u) - f(0) = g . u + (a u_x^2 + b u_y^2) / 2 + c u_x u_y to neighbours:
/// (a, b, c, g) = result (differences of f). Empty where they do not determine it.
Eigen::Matrix<double, 5, Eigen::Dynamic> fit_quadratic(
    const Vector3d& centre, const Eigen::Matrix<double, 3, 2>& axes,
    std::span<const Vector3d> nodes, const std::vector<std::int32_t>& neighbours) {
  const auto count = static_cast<Eigen::Index>(neighbours.size());
  if (count < 5) return {};
  Eigen::Matrix<double, Eigen::Dynamic, 2> u(count, 2);
  for (Eigen::Index k = 0; k < count; ++k)
    u.row(k) = axes.transpose() * (nodes[neighbours[k]] - centre);
  const double scale = u.rowwise().norm().mean();
  u /= scale;
  Eigen::MatrixXd rows(count, 5);
  Eigen::VectorXd weight(count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const double x = u(k, 0);
    const double y = u(k, 1);
    weight[k] = 1 / u.row(k).norm();
    rows.row(k) << 0.5 * x * x, 0.5 * y * y, x * y, x, y;
    rows.row(k) *= weight[k];
  }
  const SingularValues svd = singular_values(rows);
  if (!(svd.values[4] >= kLeastCondition * svd.values[0])) return {};
  Eigen::MatrixXd inverse =
      svd.V * svd.values.cwiseInverse().asDiagonal() * svd.U.transpose() * weight.asDiagonal();
  inverse.topRows<3>() /= scale * scale;
  inverse.bottomRows<2>() /= scale;
  return inverse;
}

}  // namespace

double ThicknessMap::at(const Vector3d& p_B) const {
  if (count_x == 0) return 1;
  const auto cell = [](double x, double from, double to, int count) {
    const double u = to > from ? std::clamp((x - from) / (to - from), 0.0, 1.0) * (count - 1) : 0;
    const int k = std::min(static_cast<int>(u), count - 2);
    return std::pair{k, u - k};
  };
  const auto [i, u] = cell(p_B.x(), low.x(), high.x(), count_x);
  const auto [j, v] = cell(p_B.y(), low.y(), high.y(), count_y);
  const auto value = [this](int a, int b) { return ratio[count_y * a + b]; };
  return (1 - u) * ((1 - v) * value(i, j) + v * value(i, j + 1)) +
         u * ((1 - v) * value(i + 1, j) + v * value(i + 1, j + 1));
}

SheetGeometry measure_sheet(const std::string& name, std::span<const Vector3d> nodes,
                            std::span<const Eigen::Vector3i> triangles) {
  SheetGeometry sheet;
  sheet.node_area.assign(nodes.size(), 0.0);
  std::vector<Vector3d> normal(nodes.size(), Vector3d::Zero());
  for (const Eigen::Vector3i& t : triangles) {
    const Vector3d& origin = nodes[t[0]];
    const Vector3d e1 = nodes[t[1]] - origin;
    const Vector3d e2 = nodes[t[2]] - origin;
    const Vector3d twice = e1.cross(e2);
    const Eigen::Matrix<double, 3, 2> axes = tangent_axes(twice.normalized());
    Eigen::Matrix2d rest;
    rest << axes.transpose() * e1, axes.transpose() * e2;
    SheetTriangle triangle;
    triangle.area = 0.5 * twice.norm();
    triangle.inverse = rest.inverse();
    for (int k = 0; k < 3; ++k) {
      triangle.node[k] = t[k];
      sheet.node_area[t[k]] += triangle.area / 3;
      normal[t[k]] += twice;
    }
    sheet.edge += (e1.norm() + e2.norm() + (e2 - e1).norm()) / 3;
    sheet.triangles.push_back(triangle);
  }
  sheet.edge /= static_cast<double>(triangles.size());
  const Neighbours neighbours = find_neighbours(nodes.size(), triangles);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const Eigen::Matrix<double, 3, 2> axes = tangent_axes(normal[i].normalized());
    std::vector<std::int32_t> around = neighbours[i];
    auto fit = fit_quadratic(nodes[i], axes, nodes, around);
    if (fit.cols() == 0) {
      around = widen(around, static_cast<std::int32_t>(i), neighbours);
      fit = fit_quadratic(nodes[i], axes, nodes, around);
    }
    if (fit.cols() == 0) {
      throw_error(
          "{}: the {} nodes around ({:.5g}, {:.5g}, {:.5g}) m do not determine a curvature, "
          "allowed at least two rows of triangles in each direction",
          name, around.size(), nodes[i].x(), nodes[i].y(), nodes[i].z());
    }
    CurvatureStencil stencil;
    stencil.base = static_cast<std::int32_t>(i);
    for (std::size_t k = 0; k < around.size(); ++k)
      stencil.add(around[k], fit.col(static_cast<Eigen::Index>(k)));
    sheet.curvature.push_back(std::move(stencil));
  }
  return sheet;
}

std::vector<DiscPoint> sample_disc(const SheetGeometry& sheet, std::span<const Vector3d> nodes,
                                   std::span<const std::uint8_t> fixed, const Vector3d& centre,
                                   double radius) {
  // Midpoint rule: each triangle as parts^2 small ones, a third of the radius wide or less.
  const int parts = std::clamp(static_cast<int>(3 * sheet.edge / radius) + 1, 4, 64);
  const double blur = 0.5 * sheet.edge / parts;  // of the rim, so that weights are continuous
  std::vector<DiscPoint> points;
  std::vector<Vector3d> places;
  double total = 0;
  Vector3d mean = Vector3d::Zero();
  Vector3d normal = Vector3d::Zero();
  for (std::size_t t = 0; t < sheet.triangles.size(); ++t) {
    const SheetTriangle& triangle = sheet.triangles[t];
    const auto corner = [&](int k) -> const Vector3d& { return nodes[triangle.node[k]]; };
    const auto is_fixed = [&](std::int32_t i) { return fixed[i] != 0; };
    if (std::all_of(triangle.node.begin(), triangle.node.end(), is_fixed)) continue;
    const Vector3d e1 = corner(1) - corner(0);
    const Vector3d e2 = corner(2) - corner(0);
    const double reach = radius + blur + e1.norm() + e2.norm();
    if (!((corner(0) - centre).norm() < reach)) continue;
    const Vector3d n = e1.cross(e2).normalized();
    for (int i = 0; i < parts; ++i) {
      for (int j = 0; i + j < parts; ++j) {
        for (int upper = 0; upper < (i + j + 1 < parts ? 2 : 1); ++upper) {
          const double u = (i + (1 + upper) / 3.0) / parts;
          const double v = (j + (1 + upper) / 3.0) / parts;
          const Vector3d p = corner(0) + u * e1 + v * e2;
          const double inside = ((radius - (p - centre).norm()) / blur + 1) / 2;
          if (!(inside > 0)) continue;
          DiscPoint point;
          point.triangle = t;
          point.share = {1 - u - v, u, v};
          point.weight = std::min(1.0, inside) * triangle.area / (parts * parts);
          total += point.weight;
          mean += point.weight * p;
          normal += point.weight * n;
          points.push_back(point);
          places.push_back(p);
        }
      }
    }
  }
  if (points.size() < 6) return {};  // fewer may lie in line and determine no slopes
  mean /= total;
  const Eigen::Matrix<double, 3, 2> axes = tangent_axes(normal.normalized());
  for (std::size_t k = 0; k < points.size(); ++k) {
    points[k].weight /= total;
    points[k].arm = axes.transpose() * (places[k] - mean) / radius;
  }
  return points;
}

std::pair<Vector3d, double> nearest_on_mesh(const SheetGeometry& sheet,
                                            std::span<const Vector3d> rest,
                                            std::span<const Vector3d> places, const Vector3d& tip) {
  TrianglePoint best;
  best.squared = 1e9;
  for (std::size_t t = 0; t < sheet.triangles.size(); ++t) {
    const auto& node = sheet.triangles[t].node;
    TrianglePoint point =
        nearest_on_triangle(tip, places[node[0]], places[node[1]], places[node[2]]);
    if (!(point.squared < best.squared)) continue;
    best = point;
    best.triangle = static_cast<int>(t);
  }
  if (best.triangle < 0) return {Vector3d::Zero(), std::sqrt(best.squared)};
  Vector3d place = Vector3d::Zero();
  for (int k = 0; k < 3; ++k) place += best.share[k] * rest[sheet.triangles[best.triangle].node[k]];
  return {place, std::sqrt(best.squared)};
}

}  // namespace omentum
