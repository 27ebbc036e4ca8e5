#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

// Geometry of the middle surface of a shell, a triangle mesh of any outline, flat or curved: for
// load time and grasps. Free functions on plain structs: any thread may call them. Positions at
// rest are in B [m].

namespace omentum {

/// A triangle at rest. Its frame lies in its plane, x along the projection of x_B (of y_B where x_B
/// is nearly normal to it).
struct SheetTriangle {
  std::array<std::int32_t, 3> node{};  ///< counter-clockwise about the normal
  double area = 0;                     ///< [m^2]
  /// Of the matrix of rest edges (1 - 0, 2 - 0) [1/m]: F = [x1 - x0, x2 - x0] inverse, 3 x 2.
  Eigen::Matrix2d inverse = Eigen::Matrix2d::Zero();
};

/// Curvatures of a sheet from the positions x of a few nodes: n . D x, the second fundamental form
/// in the coordinates of the sheet at rest, with D the second derivatives xx, yy, xy along it and n
/// the normal. Derivatives are sums of weight (x_node - x_base).
struct CurvatureStencil {
  /// Weights of the second derivatives xx, yy, xy [1/m^2] and of the tangents x, y [1/m].
  using Weight = Eigen::Matrix<double, 5, 1>;

  std::int32_t base = 0;
  std::vector<std::int32_t> node;  ///< the others
  std::vector<Weight> weight;

  void add(std::int32_t i, const Weight& w) {
    node.push_back(i);
    weight.push_back(w);
  }
};

/// Thickness of a sheet relative to scene.tissue.thickness_m, bilinear over a rectangle of x_B,
/// y_B.
struct ThicknessMap {
  int count_x = 0, count_y = 0;  ///< 0 = 1 everywhere
  Eigen::Vector2d low = Eigen::Vector2d::Zero(), high = Eigen::Vector2d::Zero();  ///< [m]
  std::vector<double> ratio;  ///< [count_y i + j]

  double at(const Eigen::Vector3d& p_B) const;
};

/// Measures of a middle surface. Empty = the scene has none.
struct SheetGeometry {
  std::vector<SheetTriangle> triangles;
  /// One per node, its base, in its tangent plane: exact for quadratic functions.
  std::vector<CurvatureStencil> curvature;
  std::vector<double> node_area;  ///< a third of each triangle around [m^2]
  double edge = 0;                ///< mean length of the triangles' edges [m]
};

/// Measures a surface that passes require_sheet (mesh.h). The derivatives at a node are those of
/// the quadratic function through it that fits its neighbours best (moving least squares
/// [Lancaster81], weights 1 / distance^2), or neighbours of neighbours where those do not determine
/// the fit. Throws Error naming `name` and the place where neither do.
SheetGeometry measure_sheet(const std::string& name, std::span<const Eigen::Vector3d> nodes,
                            std::span<const Eigen::Vector3i> triangles);

/// Quadrature point of a disc of tissue around a point of the middle surface.
struct DiscPoint {
  std::size_t triangle = 0;
  std::array<double, 3> share{};  ///< barycentric coordinates
  double weight = 0;              ///< fraction of the disc's area
  /// From the disc's middle, along the sheet, over its radius.
  Eigen::Vector2d arm = Eigen::Vector2d::Zero();
};

/// The disc of `radius` around `centre`, both at rest, as far as triangles with a free node reach;
/// weights sum to 1 and change continuously with the centre. Empty where there is no tissue.
std::vector<DiscPoint> sample_disc(const SheetGeometry& sheet,
                                   std::span<const Eigen::Vector3d> nodes,
                                   std::span<const std::uint8_t> fixed,
                                   const Eigen::Vector3d& centre, double radius);

/// The point of the deformed sheet (node positions `places`) nearest to `tip`, both in W: its
/// position at rest and the distance [m].
std::pair<Eigen::Vector3d, double> nearest_on_mesh(const SheetGeometry& sheet,
                                                   std::span<const Eigen::Vector3d> rest,
                                                   std::span<const Eigen::Vector3d> places,
                                                   const Eigen::Vector3d& tip);

}  // namespace omentum
