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

/// How the jaws hold (scene.tool.grip).
struct Grip {
  bool pad = false;        ///< every point of both faces, instead of the means
  bool rectangle = false;  ///< instead of a disc
  Eigen::Vector2d half = Eigen::Vector2d::Zero();   ///< sizes of the rectangle [m]
  Eigen::Vector2d axis = Eigen::Vector2d::UnitX();  ///< of the first one, in x_B, y_B
  double stiffness = 0;        ///< of the pad's bed, per area [N/m^3]; 0 = rigid
  double turn_compliance = 0;  ///< of the pad [rad/(N m)]; 0 = from its size

  /// Half sizes of the box along x_B, y_B around the grip, whose disc has this radius [m].
  Eigen::Vector2d box(double radius) const;
  /// Whether a point at `p` from the centre is under the grip, rim included.
  bool covers(const Eigen::Vector2d& p, double radius) const;
};

/// Part of a disc: where it lies on the rest sheet, x_B and y_B [m], and its share of the area.
struct PatchPoint {
  Eigen::Vector2d p = Eigen::Vector2d::Zero();
  double weight = 0;
};

/// Quadrature of the disc inside `free`, which must hold its centre; weights sum to 1. Points and
/// weights are continuous in centre and radius. Precondition: radius > 0 and `free` has an area,
/// else the weights are NaN.
std::vector<PatchPoint> patch_points(const Eigen::AlignedBox2d& free, const Eigen::Vector2d& centre,
                                     double radius);

struct SheetPoint {
  Eigen::Vector2d X = Eigen::Vector2d::Zero();  ///< x_B, y_B at rest [m]
  double distance = 0;                          ///< from the tip [m]
};

/// Point of a sheet nearest to the tip: Gauss-Newton from `start`. `at` gives the place in W of a
/// rest point in `sheet` and is not asked outside. `sheet` must have an area and
/// hold `start`.
SheetPoint nearest_on_sheet(const std::function<Eigen::Vector3d(const Eigen::Vector2d&)>& at,
                            const Eigen::AlignedBox2d& sheet, const Eigen::Vector2d& start,
                            const Eigen::Vector3d& tip);

}  // namespace omentum
