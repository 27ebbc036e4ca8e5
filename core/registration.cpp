#include "core/registration.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>

#include "core/check.h"
#include "core/decompositions.h"

namespace omentum {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;

// Square root of the 99.9 % point of chi-squared with 3 degrees of freedom (16.27), for errors
// whose length is touch_noise: 1 / sqrt(3) of it per axis.
constexpr double kOutlierFactor = 2.33;
constexpr std::size_t kFewest = 4;  // 3 fit exactly and leave nothing to check them by
constexpr std::size_t kMost = 100;  // 161,700 triples: half a second

using Points = std::span<const TouchedPoint>;
using Indices = std::vector<std::size_t>;

Isometry3d fit_of(Points points, const Indices& chosen) {
  std::vector<Vector3d> from, to;
  for (const std::size_t i : chosen) {
    from.push_back(points[i].p_RT);
    to.push_back(points[i].p_WT);
  }
  return fit_rigid(from, to);
}

double residual_of(const Isometry3d& X_WR, const TouchedPoint& point) {
  return (X_WR * point.p_RT - point.p_WT).norm();
}

/// The `count` points that a fit is nearest to, and the sum of their squared residuals.
double nearest(Points points, const Isometry3d& X_WR, std::size_t count, Indices& chosen) {
  chosen.resize(points.size());
  std::iota(chosen.begin(), chosen.end(), std::size_t{0});
  std::vector<double> squares;
  for (const TouchedPoint& point : points) {
    const double residual = residual_of(X_WR, point);
    squares.push_back(residual * residual);
  }
  std::sort(chosen.begin(), chosen.end(), [&](std::size_t a, std::size_t b) {
    return squares[a] != squares[b] ? squares[a] < squares[b] : a < b;
  });
  chosen.resize(count);
  double sum = 0;
  for (const std::size_t i : chosen) sum += squares[i];
  return sum;
}

/// Least trimmed squares over `count` points: each step of concentration fits the points that the
/// last fit is nearest to, and never raises the sum.
Isometry3d fit_trimmed(Points points, std::size_t count) {
  struct Candidate {
    double sum;
    Indices chosen;
  };
  std::vector<Candidate> best;
  constexpr std::size_t kKept = 10;
  const std::size_t n = points.size();
  Indices chosen;
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = i + 1; j < n; ++j) {
      for (std::size_t k = j + 1; k < n; ++k) {
        const double sum = nearest(points, fit_of(points, {i, j, k}), count, chosen);
        if (best.size() == kKept && !(sum < best.back().sum)) continue;
        best.push_back({sum, chosen});
        std::stable_sort(best.begin(), best.end(),
                         [](const Candidate& a, const Candidate& b) { return a.sum < b.sum; });
        if (best.size() > kKept) best.pop_back();
      }
    }
  }
  Isometry3d fitted = Isometry3d::Identity();
  double least = std::numeric_limits<double>::infinity();
  for (Candidate& candidate : best) {
    for (double before = std::numeric_limits<double>::infinity(); candidate.sum < before;) {
      before = candidate.sum;
      const Isometry3d X_WR = fit_of(points, candidate.chosen);
      candidate.sum = nearest(points, X_WR, count, candidate.chosen);
      if (candidate.sum < least) {
        least = candidate.sum;
        fitted = X_WR;
      }
    }
  }
  return fitted;
}

/// Principal axes (columns) of points in W about their centre, and their mean squares along them.
struct Spread {
  Vector3d centre = Vector3d::Zero();
  Matrix3d axes = Matrix3d::Identity();
  Vector3d mean_squares = Vector3d::Zero();  ///< ascending
  double count = 0;

  /// Mean squared distance of the points from the axis k.
  double from_axis(int k) const { return mean_squares.sum() - mean_squares[k]; }
};

template <typename Range, typename PointOf>
Spread spread_of(const Range& range, PointOf point_of) {
  Spread spread;
  for (const auto& item : range) {
    spread.centre += point_of(item);
    ++spread.count;
  }
  spread.centre /= spread.count;
  Matrix3d second = Matrix3d::Zero();
  for (const auto& item : range) {
    const Vector3d from_centre = point_of(item) - spread.centre;
    second += from_centre * from_centre.transpose() / spread.count;
  }
  const PrincipalAxes3 principal = principal_axes(second);
  spread.axes = principal.axes;
  spread.mean_squares = principal.values.cwiseMax(0);
  return spread;
}

Spread spread_of(const Registration& registration) {
  std::vector<Vector3d> used;
  for (const RegisteredPoint& point : registration.points) {
    if (!point.outlier) used.push_back(point.touched.p_WT);
  }
  return spread_of(used, [](const Vector3d& p) { return p; });
}

/// Of points on a line nothing fixes the turn about it.
Result<void> check_spread(const Spread& spread, double needed, const char* where) {
  const double from_line = std::sqrt(spread.from_axis(2));
  if (from_line >= needed) return {};
  return Failure{fmt::format(
      "the points are {:.3g} mm from one line in {} (root mean square), needed {:.3g} mm: nothing "
      "fixes the turn about it",
      1e3 * from_line, where, 1e3 * needed)};
}

Result<void> check_points(Points points, double min_spread) {
  if (points.size() < kFewest || points.size() > kMost) {
    return Failure{fmt::format("{} points, allowed {} ... {}", points.size(), kFewest, kMost)};
  }
  std::set<std::string> names;
  for (const TouchedPoint& point : points) {
    if (!names.insert(point.name).second)
      return Failure{fmt::format("two points are called {}", point.name)};
    if (!point.p_WT.allFinite() || !point.p_RT.allFinite())
      return Failure{fmt::format("point {} is not finite", point.name)};
  }
  const Result<void> in_W = check_spread(
      spread_of(points, [](const TouchedPoint& p) { return p.p_WT; }), min_spread, "W");
  if (!in_W) return in_W;
  return check_spread(spread_of(points, [](const TouchedPoint& p) { return p.p_RT; }), min_spread,
                      "R");
}

/// All of `chosen` lie within `cut` of their fit once i and j have changed places.
bool fits_exchanged(Points points, const Indices& chosen, std::size_t i, std::size_t j,
                    double cut) {
  std::vector<TouchedPoint> exchanged(points.begin(), points.end());
  std::swap(exchanged[i].p_RT, exchanged[j].p_RT);
  const Isometry3d X_WR = fit_of(exchanged, chosen);
  return std::all_of(chosen.begin(), chosen.end(),
                     [&](std::size_t k) { return residual_of(X_WR, exchanged[k]) <= cut; });
}

/// Two points that were touched in each other's place, or that could have been: with both exchanged
/// the points fit as well, as those of a square do.
Result<void> check_exchanges(Points points, const Indices& inliers, double cut) {
  const auto in_fit = [&](std::size_t i) {
    return std::find(inliers.begin(), inliers.end(), i) != inliers.end();
  };
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (std::size_t j = i + 1; j < points.size(); ++j) {
      if ((points[i].p_WT - points[j].p_WT).norm() <= 2 * cut) continue;
      Indices chosen = inliers;
      for (const std::size_t k : {i, j}) {
        if (!in_fit(k)) chosen.push_back(k);
      }
      if (chosen.size() < kFewest || !fits_exchanged(points, chosen, i, j, cut)) continue;
      if (in_fit(i) && in_fit(j)) {
        return Failure{fmt::format(
            "points {} and {} could be exchanged and fit as well: touch more points, without "
            "symmetry",
            points[i].name, points[j].name)};
      }
      return Failure{fmt::format("points {} and {} were touched in each other's place",
                                 points[i].name, points[j].name)};
    }
  }
  return {};
}

}  // namespace

Isometry3d fit_rigid(std::span<const Vector3d> from, std::span<const Vector3d> to) {
  OMENTUM_CHECK(from.size() == to.size() && from.size() >= 3, "{} and {} points", from.size(),
                to.size());
  Vector3d centre_from = Vector3d::Zero();
  Vector3d centre_to = Vector3d::Zero();
  for (const Vector3d& p : from) centre_from += p;
  for (const Vector3d& p : to) centre_to += p;
  centre_from /= static_cast<double>(from.size());
  centre_to /= static_cast<double>(to.size());
  Matrix3d covariance = Matrix3d::Zero();
  for (std::size_t i = 0; i < from.size(); ++i)
    covariance += (to[i] - centre_to) * (from[i] - centre_from).transpose();
  Isometry3d X = Isometry3d::Identity();
  X.linear() = nearest_rotation(covariance);
  X.translation() = centre_to - X.linear() * centre_from;
  return X;
}

Result<Registration> register_points(Points points, const pb::RegistrationRules& rules,
                                     const Vector3d& workspace_min, const Vector3d& workspace_max) {
  if (const Result<void> checked = check_points(points, rules.min_spread_m()); !checked)
    return Failure{checked.error()};
  const std::size_t n = points.size();
  const double cut = kOutlierFactor * rules.touch_noise_m();
  const Isometry3d trimmed = fit_trimmed(points, n - n / 3);
  Indices inliers;
  std::vector<std::string> outliers;
  for (std::size_t i = 0; i < n; ++i) {
    if (residual_of(trimmed, points[i]) <= cut) {
      inliers.push_back(i);
    } else {
      outliers.push_back(
          fmt::format("{} by {:.3g} mm", points[i].name, 1e3 * residual_of(trimmed, points[i])));
    }
  }
  if (const Result<void> checked = check_exchanges(points, inliers, cut); !checked)
    return Failure{checked.error()};
  if (inliers.size() < std::max(kFewest, n - n / 3)) {
    return Failure{
        fmt::format("{} of {} points do not fit the others within {:.3g} mm: {}; touch them again",
                    n - inliers.size(), n, 1e3 * cut, fmt::join(outliers, ", "))};
  }
  std::vector<TouchedPoint> used;
  for (const std::size_t i : inliers) used.push_back(points[i]);
  if (const Result<void> checked = check_points(used, rules.min_spread_m()); !checked)
    return Failure{checked.error()};

  Registration registration;
  registration.X_WR = fit_of(points, inliers);
  double residuals = 0;
  double left_out = 0;
  for (std::size_t i = 0; i < n; ++i) {
    RegisteredPoint point{points[i], residual_of(registration.X_WR, points[i]), 0, true};
    point.leave_one_out = point.residual;
    if (const auto at = std::find(inliers.begin(), inliers.end(), i); at != inliers.end()) {
      Indices others = inliers;
      others.erase(others.begin() + (at - inliers.begin()));
      point.outlier = false;
      point.leave_one_out = residual_of(fit_of(points, others), points[i]);
      residuals += point.residual * point.residual;
      left_out += point.leave_one_out * point.leave_one_out;
    }
    registration.points.push_back(std::move(point));
  }
  const double count = static_cast<double>(inliers.size());
  registration.residual_rms = std::sqrt(residuals / count);
  registration.leave_one_out_rms = std::sqrt(left_out / count);
  registration.touch_error = std::sqrt(residuals / (count - 2));
  registration.warnings = registration_warnings(registration, rules, workspace_min, workspace_max);
  return registration;
}

double predicted_error(const Registration& registration, double touch_error, const Vector3d& p_WT) {
  const Spread spread = spread_of(registration);
  const Vector3d along = spread.axes.transpose() * (p_WT - spread.centre);
  double sum = 0;
  for (int k = 0; k < 3; ++k)
    sum += (along.squaredNorm() - along[k] * along[k]) / spread.from_axis(k);
  return touch_error * std::sqrt((1 + sum / 3) / spread.count);
}

Matrix3d tip_covariance(const Registration& registration, double touch_error,
                        const Vector3d& p_WT) {
  const auto cross = [](const Vector3d& v) {
    Matrix3d m;
    m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
    return m;
  };
  // Turn about the centre of the points, and its shift: the two do not depend on each other.
  const Spread spread = spread_of(registration);
  Matrix3d turn = Matrix3d::Zero();
  for (const RegisteredPoint& point : registration.points) {
    if (point.outlier) continue;
    const Matrix3d J = cross(point.touched.p_WT - spread.centre);
    turn += J.transpose() * J;
  }
  const double per_axis = touch_error * touch_error / 3;
  const Matrix3d J = cross(p_WT - spread.centre);
  return per_axis * (J * turn.inverse() * J.transpose() + Matrix3d::Identity() / spread.count);
}

double worst_predicted_error(const Registration& registration, double touch_error,
                             const Vector3d& box_min, const Vector3d& box_max) {
  double worst = 0;
  for (int corner = 0; corner < 8; ++corner) {
    Vector3d p_WT;
    for (int k = 0; k < 3; ++k) p_WT[k] = (corner >> k & 1) != 0 ? box_max[k] : box_min[k];
    worst = std::max(worst, predicted_error(registration, touch_error, p_WT));
  }
  return worst;
}

std::vector<std::string> registration_warnings(const Registration& registration,
                                               const pb::RegistrationRules& rules,
                                               const Vector3d& box_min, const Vector3d& box_max) {
  std::vector<std::string> warnings;
  std::size_t used = 0;
  for (const RegisteredPoint& point : registration.points) {
    used += point.outlier ? 0 : 1;
    if (!point.outlier) continue;
    warnings.push_back(fmt::format("point {} is {:.3g} mm off and left out: touch it again",
                                   point.touched.name, 1e3 * point.residual));
  }
  if (used < 6)
    warnings.push_back(fmt::format("{} points in the fit, 6 and more check each other", used));

  // Distances between the points by the robot over those in W; known to touch_error / spread.
  const Spread spread = spread_of(registration);
  double along = 0;
  double of_robot = 0;
  Vector3d centre_R = registration.X_WR.inverse() * spread.centre;
  for (const RegisteredPoint& point : registration.points) {
    if (point.outlier) continue;
    const Vector3d turned = registration.X_WR.linear() * (point.touched.p_RT - centre_R);
    along += turned.dot(point.touched.p_WT - spread.centre);
    of_robot += turned.squaredNorm();
  }
  const double scale = of_robot / along;
  const double uncertain = registration.touch_error / std::sqrt(3 * along);
  if (std::abs(scale - 1) > std::max(4 * uncertain, 0.005)) {
    warnings.push_back(
        fmt::format("distances by the robot are {:.4f} times those in W: is the instrument, its "
                    "tip offset or the unit of the points right?",
                    scale));
  }
  const double error = std::max(registration.touch_error, rules.touch_noise_m());
  const double worst = worst_predicted_error(registration, error, box_min, box_max);
  if (worst > rules.max_predicted_error_m()) {
    warnings.push_back(fmt::format(
        "predicted error of the tip up to {:.3g} mm in the workspace, allowed {:.3g} mm: touch "
        "more points, farther apart and at several heights",
        1e3 * worst, 1e3 * rules.max_predicted_error_m()));
  }
  return warnings;
}

std::string age_warning(const Registration& registration, const pb::RegistrationRules& rules,
                        std::int64_t now_ns) {
  const double age_h = static_cast<double>(now_ns - registration.date_ns) / 3.6e12;
  if (age_h < 0) return fmt::format("registration is dated {:.1f} h in the future", -age_h);
  if (age_h <= rules.max_age_h()) return {};
  return fmt::format("registration is {:.1f} h old, allowed {} h: was the robot moved since?",
                     age_h, rules.max_age_h());
}

Result<TipPivot> pivot_tip(std::span<const PsmPose> poses_RC) {
  constexpr double kWorstCondition = 30;
  if (poses_RC.size() < kFewest)
    return Failure{fmt::format("{} poses, needed {}", poses_RC.size(), kFewest)};
  const auto rows = static_cast<Eigen::Index>(3 * poses_RC.size());
  Eigen::MatrixXd equations(rows, 6);
  Eigen::VectorXd right(rows);
  for (std::size_t i = 0; i < poses_RC.size(); ++i) {
    const PsmPose& pose = poses_RC[i];
    if (!pose.R.allFinite() || !pose.p.allFinite())
      return Failure{fmt::format("pose {} is not finite", i + 1)};
    const auto row = static_cast<Eigen::Index>(3 * i);
    equations.block<3, 3>(row, 0) = pose.R;
    equations.block<3, 3>(row, 3) = -Matrix3d::Identity();
    right.segment<3>(row) = -pose.p;
  }
  const SingularValues svd = singular_values(equations);
  TipPivot pivot;
  pivot.condition = svd.values[0] / svd.values[5];
  if (!(pivot.condition <= kWorstCondition)) {
    return Failure{fmt::format(
        "the instrument was turned too little to find its tip: condition {:.3g}, allowed {}; turn "
        "it to all sides about the point",
        pivot.condition, kWorstCondition)};
  }
  const Eigen::VectorXd solution =
      svd.V * svd.values.cwiseInverse().asDiagonal() * (svd.U.transpose() * right);
  pivot.p_CT = solution.head<3>();
  pivot.p_RP = solution.tail<3>();
  const double sum = (equations * solution - right).squaredNorm();
  pivot.residual_rms = std::sqrt(sum / static_cast<double>(poses_RC.size()));
  const double per_axis = sum / static_cast<double>(rows - 6);
  const Eigen::MatrixXd covariance =
      svd.V * svd.values.cwiseAbs2().cwiseInverse().asDiagonal() * svd.V.transpose() * per_axis;
  pivot.p_CT_std = covariance.diagonal().head<3>().cwiseSqrt();
  return pivot;
}

}  // namespace omentum
