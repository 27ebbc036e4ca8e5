#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "mismatch/fit/forward.h"
#include "mismatch/fit/layout.h"
#include "mismatch/seen/marker_place.h"
#include "mismatch/seen/observation.h"
#include "mismatch/seen/seen_surface.h"

namespace omentum {

/// Where the camera believes to stand against where it stands: its points are turned about `pivot`,
/// the camera, and moved, p' = pivot + R (p - pivot) + shift, R = Rz Ry Rx.
struct Registration6 {
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();   ///< about x_W, then y_W, then z_W [rad]
  Eigen::Matrix3d rotation() const;
};

/// Values of the functions of time of the smooth difference: constant, with the lift (0 - 1), with
/// its square, and with the lift early against late (what the way back does differently). `share`
/// of the time from the first frame to the last.
Eigen::Vector4d discrepancy_in_time(double lift, double share);

struct NoiseModel {
  double sigma = 1e-3;    ///< of a point along its ray [m]
  double lateral = 5e-4;  ///< of where a ray goes [m]: counts where the surface is seen edge-on
  double reach = 0.01;    ///< farther from the surface a point is no tissue [m]
  double freedom = 4;     ///< of Student's t; the weight of a point falls with its distance
  /// How far, in the mean over the surface, model and tissue may be apart along the motion of a
  /// frame [m]: where tissue hardly moves this hides what time it was.
  double along_motion = 1e-4;
  double force = 0.01;   ///< of a force sensor, each axis [N]
  double marker = 1e-3;  ///< of a marker, each axis [m]
  /// What a frame of a marker counts for: what a model leaves is alike from frame to frame.
  double marker_share = 1;
};

/// The normal equations of a recording against a prediction, to first order about it, and what was
/// met on the way.
struct NormalEquations {
  Eigen::MatrixXd A;              ///< sum of weight J J^T, [size x size]
  Eigen::VectorXd b;              ///< sum of weight J e
  double cost = 0;                ///< - log likelihood but for constants
  std::size_t hits = 0;           ///< rays that meet the predicted surface
  std::size_t passing = 0;        ///< rays that pass it nearby
  std::size_t gaps = 0;           ///< places that should be seen and were not
  std::size_t no_tissue = 0;      ///< points farther than the reach
  std::vector<double> deviation;  ///< of hits: distance along the ray over its sd, at sigma 1 m
  std::vector<double> force_deviation;   ///< the same of forces, at 1 N
  std::vector<double> marker_deviation;  ///< of markers, each axis [m]
  /// Of a marker, outliers shortened: sums of squares and of products with the frame before [m^2].
  double marker_squares = 0, marker_products = 0;
  std::size_t marker_pairs = 0;  ///< in those sums
};

/// What of a recording is compared with what, at which numbers.
struct Comparison {
  const Observation& seen;
  const Prediction& predicted;
  const Layout& layout;
  Registration6 registration;  ///< absolute, as offsets of markers in `delta` are
  /// Step in the unknowns and own numbers from those of the prediction, [Layout::size()]. The
  /// clocks move a frame along its trajectory.
  Eigen::VectorXd delta;
};

/// Compares what was seen along the rays of the camera: the range of the point against that of the
/// predicted surface; a ray that passes the surface by its distance; a place of the upper face that
/// the camera should see and that has no point nearby by its distance from the nearest one. Where
/// no ray is known (Observation::rays) points and places of the surface count by their distances
/// from what is nearest. Any number of threads at a time.
class Likelihood {
 public:
  /// `rest`: vertices of the body at rest; `uv`: places of the grid in 0 ... 1. Cosines of the
  /// smooth difference: so many along each side, of which the first is constant.
  Likelihood(std::vector<Eigen::Vector3i> triangles, std::span<const Eigen::Vector3d> rest,
             std::vector<Eigen::Vector2d> uv, const Eigen::Vector3d& pivot, int cosines_per_side);

  /// Vertices that a camera which could see them need not have seen, as under the bar of a clamp;
  /// none at first.
  void set_covered(std::vector<bool> covered);

  /// Where those of Observation::markers are; none: they are not compared.
  void set_markers(std::vector<MarkerPlace> markers) { markers_ = std::move(markers); }
  const std::vector<MarkerPlace>& markers() const { return markers_; }

  /// Without columns A and b are left empty.
  NormalEquations compare(const Comparison& what, const NoiseModel& noise, bool with_columns) const;
  /// Distances of the points of every frame from the predicted surface, above zero outside of it,
  /// then of its markers from where they are predicted [m], NaN beyond `reach` and of markers on no
  /// tissue.
  std::vector<std::vector<double>> distances(const Comparison& what, double reach) const;
  /// Where the markers of a frame are predicted, in the order of SeenFrame::markers [m]; NaN where
  /// they are not.
  std::vector<Eigen::Vector3d> marker_places(const Comparison& what, std::size_t frame) const;
  /// Predicted vertices as the camera has them, without the smooth difference.
  std::vector<Eigen::Vector3d> vertices(const Comparison& what, std::size_t frame) const;

  const std::vector<Eigen::Vector3i>& triangles() const { return surface_.triangles(); }

 private:
  friend class FrameRows;  ///< one frame after the other, with what it needs on the way
  SeenSurface surface_;    ///< of the body at rest
  std::vector<Eigen::Vector2d> uv_;
  Eigen::MatrixXd cosines_;         ///< [place of the grid][cosine]
  Eigen::Vector3d pivot_, middle_;  ///< the latter of the body at rest
  std::vector<MarkerPlace> markers_;
  std::vector<bool> covered_;  ///< [vertex]
};

}  // namespace omentum
