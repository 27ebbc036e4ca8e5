#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/psm.h"
#include "core/result.h"
#include "proto/registration.pb.h"

namespace omentum {

/// Where the base R of a robot stands in W, from points of known place that its tip has touched
/// (docs/dvrk.md 6). Points in m. Functions are pure; any thread.

struct TouchedPoint {
  std::string name;
  Eigen::Vector3d p_WT = Eigen::Vector3d::Zero();  ///< where the point is
  Eigen::Vector3d p_RT = Eigen::Vector3d::Zero();  ///< tip by the robot's joints, touching it
};

struct RegisteredPoint {
  TouchedPoint touched;
  double residual = 0;       ///< |X_WR p_RT - p_WT| [m]
  double leave_one_out = 0;  ///< the same under the fit of the other points [m]
  bool outlier = false;      ///< takes no part in the fit
};

struct Registration {
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  std::vector<RegisteredPoint> points;
  double residual_rms = 0;       ///< of the points of the fit [m]
  double leave_one_out_rms = 0;  ///< of them [m]
  /// Error of one touch, root mean square of its length, by the residuals: six numbers were fitted,
  /// so sum r^2 / (N - 2) [Fitzpatrick98] [m].
  double touch_error = 0;
  std::int64_t date_ns = 0;  ///< since 1970-01-01 UTC
  std::string instrument;
  Eigen::Vector3d p_CT = Eigen::Vector3d::Zero();  ///< tip in the frame of the control point [m]
  std::vector<std::string> warnings;  ///< one line each, as it was made; a file has none
};

/// Least squares X with to = X from [Umeyama91], without scale. Aborts unless there are as many of
/// each, 3 and more.
Eigen::Isometry3d fit_rigid(std::span<const Eigen::Vector3d> from,
                            std::span<const Eigen::Vector3d> to);

/// Robust fit: least trimmed squares over two thirds of the points [Rousseeuw84], from every three
/// points and concentrated; then least squares over all that lie within 2.33 `touch_noise_m` of it
/// (99.9 % of normal touches); the others are outliers. Fails with one line that names the points:
/// fewer than 4, equal names, numbers that are not finite, points near a line, two that were
/// touched in each other's place or could have been, too few left. A warning each: outliers, fewer
/// than 6 points, distances that do not agree with those in W, a predicted error beyond
/// `max_predicted_error_m` in the corners of the box `workspace_min` ... `workspace_max` (W).
Result<Registration> register_points(std::span<const TouchedPoint> points,
                                     const pb::RegistrationRules& rules,
                                     const Eigen::Vector3d& workspace_min,
                                     const Eigen::Vector3d& workspace_max);

/// Root mean square error of a tip at p_WT that a fit of these points gives, where each touch errs
/// by `touch_error` in all directions alike [Fitzpatrick98] eq. 46 [m].
double predicted_error(const Registration& registration, double touch_error,
                       const Eigen::Vector3d& p_WT);

/// Covariance of that tip in W by the linearised fit; its trace is the square of
/// predicted_error(). [m^2]
Eigen::Matrix3d tip_covariance(const Registration& registration, double touch_error,
                               const Eigen::Vector3d& p_WT);

/// Largest predicted_error() in a box, which one of its corners has.
double worst_predicted_error(const Registration& registration, double touch_error,
                             const Eigen::Vector3d& box_min, const Eigen::Vector3d& box_max);

/// What speaks against it, one line each: points left out, few points, distances that do not agree,
/// a large predicted error in the box [m]. The same of one that was just made and of a file.
std::vector<std::string> registration_warnings(const Registration& registration,
                                               const pb::RegistrationRules& rules,
                                               const Eigen::Vector3d& box_min,
                                               const Eigen::Vector3d& box_max);

/// Empty, or one line: older than `max_age_h`, or of the future. Times since 1970 UTC.
std::string age_warning(const Registration& registration, const pb::RegistrationRules& rules,
                        std::int64_t now_ns);

/// Tip of an instrument by turning it about one point that the tip does not leave.
struct TipPivot {
  Eigen::Vector3d p_CT = Eigen::Vector3d::Zero();  ///< tip in the frame of the control point [m]
  Eigen::Vector3d p_RP = Eigen::Vector3d::Zero();  ///< the point [m]
  double residual_rms = 0;                         ///< of its distance from the tips [m]
  Eigen::Vector3d p_CT_std = Eigen::Vector3d::Zero();  ///< by the residuals [m]
  double condition = 0;  ///< largest over smallest singular value of the equations
};

/// Least squares over R_RC p_CT + p_RC = p_RP, linear in both points. Fails below 4 poses, on
/// numbers that are not finite, and where the poses are turned too little: condition above 30, some
/// 5 degrees about all axes.
Result<TipPivot> pivot_tip(std::span<const PsmPose> poses_RC);

}  // namespace omentum
