#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <functional>
#include <vector>

namespace omentum {

/// What the jaws hold of a sheet, the same for every model of it: the disc of rest tissue around
/// the point of the mid-surface nearest to the tip, as far as it is free. Held are the means of the
/// position and of its slopes over the disc, every part weighted by its area; so the grasp changes
/// continuously with the pinch point, whatever the mesh (docs/tissue.md 8).

/// Part of a disc: where it lies on the rest sheet, x_B and y_B [m], and its share of the area.
struct PatchPoint {
  Eigen::Vector2d p = Eigen::Vector2d::Zero();
  double weight = 0;
};

/// Quadrature of the disc inside `free`, which holds its centre; weights sum to 1. Points and
/// weights are continuous in centre and radius.
std::vector<PatchPoint> patch_points(const Eigen::AlignedBox2d& free, const Eigen::Vector2d& centre,
                                     double radius);

struct SheetPoint {
  Eigen::Vector2d X = Eigen::Vector2d::Zero();  ///< x_B, y_B at rest [m]
  double distance = 0;                          ///< from the tip [m]
};

/// Point of a sheet nearest to the tip: Gauss-Newton from `start`. `at` gives the place in W of a
/// rest point in `sheet`.
SheetPoint nearest_on_sheet(const std::function<Eigen::Vector3d(const Eigen::Vector2d&)>& at,
                            const Eigen::AlignedBox2d& sheet, const Eigen::Vector2d& start,
                            const Eigen::Vector3d& tip);

}  // namespace omentum
