#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

// The middle surface of a shell as a triangle mesh, measured at rest: what the elastic model needs
// of any outline and any triangles, flat or curved. Measured at load time, asked once per grasp.
// Free functions on plain structs: any thread may call them. All places at rest are in B [m].

namespace omentum {

/// A triangle at rest. Its frame lies in its plane, x along the projection of x_B (of y_B where x_B
/// stands upright on it).
struct SheetTriangle {
  std::array<std::int32_t, 3> node{};  ///< counter-clockwise seen against the normal
  double area = 0;                     ///< [m^2]
  /// Of the matrix of rest edges (1 - 0, 2 - 0) [1/m]: F = [x1 - x0, x2 - x0] inverse, 3 x 2.
  Eigen::Matrix2d inverse = Eigen::Matrix2d::Zero();
};

/// Second derivatives along the sheet at a node, in the frame of its tangent plane, of any function
/// f given at the nodes: f_xx = sum_k weight[k][0] f(node[k]), f_yy by [1], f_xy by [2]. Exact for
/// quadratic f; the weights sum to zero.
struct CurvatureStencil {
  std::vector<std::int32_t> node;                  ///< the node itself first
  std::vector<Eigen::Vector3d> weight;             ///< [1/m^2]
  Eigen::Vector3d rest = Eigen::Vector3d::Zero();  ///< curvatures xx, yy, xy of the rest shape
                                                   ///< towards its normal [1/m]
};

/// Thickness of a sheet relative to scene.tissue.thickness_m, bilinear over a rectangle of x_B,
/// y_B.
struct ThicknessMap {
  int count_x = 0, count_y = 0;  ///< 0 = 1 everywhere
  Eigen::Vector2d low = Eigen::Vector2d::Zero(), high = Eigen::Vector2d::Zero();  ///< [m]
  std::vector<double> ratio;  ///< [count_y i + j]

  double at(const Eigen::Vector3d& p_B) const;
};

/// A middle surface, measured. Empty = the scene has none.
struct SheetGeometry {
  std::vector<SheetTriangle> triangles;
  std::vector<CurvatureStencil> curvature;  ///< per node
  std::vector<double> node_area;            ///< a third of each triangle around [m^2]
  double edge = 0;                          ///< mean length of the triangles' edges [m]
};

/// Measures a surface that require_sheet (mesh.h) lets pass. The derivatives at a node are those of
/// the quadratic function through it that fits its neighbours best (weights 1 / distance^2, moving
/// least squares [Lancaster81]): those of its triangles, and theirs in turn where these do not
/// determine the fit. Throws Error naming `name` and the place where neither do.
SheetGeometry measure_sheet(const std::string& name, std::span<const Eigen::Vector3d> nodes,
                            std::span<const Eigen::Vector3i> triangles);

/// Part of a disc of tissue around a point of the middle surface.
struct DiscPoint {
  std::size_t triangle = 0;
  std::array<double, 3> share{};                  ///< of its corners
  double weight = 0;                              ///< share of the disc's area
  Eigen::Vector2d arm = Eigen::Vector2d::Zero();  ///< from the disc's middle, along the sheet,
                                                  ///< over its radius
};

/// The disc of `radius` around `centre`, both at rest, as far as triangles with a free node reach;
/// weights sum to 1 and change continuously with the centre. Empty where there is no tissue.
std::vector<DiscPoint> sample_disc(const SheetGeometry& sheet,
                                   std::span<const Eigen::Vector3d> nodes,
                                   std::span<const std::uint8_t> fixed,
                                   const Eigen::Vector3d& centre, double radius);

/// The point of the deformed sheet nearest to `tip`, both in W: its place at rest and the distance
/// [m].
std::pair<Eigen::Vector3d, double> nearest_on_mesh(const SheetGeometry& sheet,
                                                   std::span<const Eigen::Vector3d> rest,
                                                   std::span<const Eigen::Vector3d> places,
                                                   const Eigen::Vector3d& tip);

}  // namespace omentum
