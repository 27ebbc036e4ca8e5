#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include "mismatch/calibrate/forward.h"
#include "mismatch/calibrate/marker_place.h"
#include "mismatch/calibrate/observation.h"
#include "mismatch/calibrate/seen_surface.h"

namespace omentum {

/// Where the camera believes to stand against where it stands: its points are turned about `pivot`,
/// the camera, and moved, p' = pivot + R (p - pivot) + shift, R = Rz Ry Rx.
struct Registration6 {
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();   ///< about x_W, then y_W, then z_W [rad]
  Eigen::Matrix3d rotation() const;
};

/// Smooth difference between model and tissue, along the surface's normal: so many cosines along
/// each side of the sheet, each times four functions of the frame (frame_course()).
inline constexpr int kModesPerSide = 4;
inline constexpr int kCosines = kModesPerSide * kModesPerSide;
inline constexpr int kCourses = 4;
inline constexpr int kModes = kCourses * kCosines;

/// How the smooth difference goes with the frames: constant, with the lift (0 - 1), with its
/// square, and with the lift early against late (what the way back does differently). `share` of
/// the time from the first frame to the last.
Eigen::Vector4d frame_course(double lift, double share);

/// Columns of a block: the shared ones (unknowns, further columns, registration, common clock,
/// offsets of the markers), then a recording's own (pinch, stiffness, clock, zero and gain of the
/// force sensor, where the body was held at the start, modes of the discrepancy).
struct Layout {
  int unknowns = 0;   ///< shared numbers the simulation depends on
  int stiffness = 0;  ///< which of them is E
  int markers = 0;    ///< on the tissue
  int held = 0;       ///< 3 where bodies are held at the start, else 0
  int registration() const { return unknowns; }
  int clock() const { return unknowns + 6; }
  int marker(int k) const { return unknowns + 7 + 3 * k; }
  int shared() const { return marker(markers); }
  int pinch() const { return shared(); }
  int factor() const { return shared() + 2; }
  int own_clock() const { return shared() + 3; }
  static constexpr int kOwnForce = 4;  ///< among the own ones: three of the zero, then the gain
  int force_zero() const { return shared() + kOwnForce; }
  int force_gain() const { return force_zero() + 3; }
  static constexpr int kOwnPlace = 8;  ///< among the own ones: where the body was held
  int place() const { return shared() + kOwnPlace; }
  int modes() const { return place() + held; }
  int own() const { return kOwnPlace + held + kModes; }
  int size() const { return shared() + own(); }
};

struct NoiseModel {
  double sigma = 1e-3;  ///< of a point along its ray [m]
  double lateral =
      5e-4;             ///< of where a ray goes [m]: what counts where the surface is seen edge-on
  double reach = 0.01;  ///< farther from the surface a point is no tissue [m]
  double freedom = 4;   ///< of Student's t; the weight of a point falls with its distance
  /// How far, in the mean over the surface, model and tissue may be apart along the motion of a
  /// frame [m]: where tissue hardly moves this hides what time it was.
  double along_motion = 1e-4;
  double force = 0.01;   ///< of a force sensor, each axis [N]
  double marker = 1e-3;  ///< of a marker, each axis [m]
  /// What a frame of a marker counts for: what a model leaves is alike from frame to frame.
  double marker_share = 1;
};

/// A recording against a prediction, to first order about it.
struct Block {
  Eigen::MatrixXd A;              ///< sum of weight J J^T, [size x size]
  Eigen::VectorXd b;              ///< sum of weight J e
  double cost = 0;                ///< - log likelihood but for constants
  std::size_t hits = 0;           ///< rays that meet the predicted surface
  std::size_t beside = 0;         ///< rays that pass it nearby
  std::size_t gaps = 0;           ///< places that should be seen and were not
  std::size_t no_tissue = 0;      ///< points farther than the reach
  std::vector<double> deviation;  ///< of hits: distance along the ray over its sd, at sigma 1 m
  std::vector<double> force_deviation;   ///< the same of forces, at 1 N
  std::vector<double> marker_deviation;  ///< of markers, each axis [m]
  /// Of a marker, outliers shortened: sums of squares and of products with the frame before [m^2].
  double marker_squares = 0, marker_products = 0;
  std::size_t marker_pairs = 0;  ///< in those sums
};

/// Compares what was seen along the rays of the camera: the range of the point against that of the
/// predicted surface; a ray that passes the surface by its distance; a place that the camera should
/// see and that has no point nearby by its distance from the nearest one. Where no ray is known
/// (Observation::rays) points and places of the surface count by their distances from what is
/// nearest. `uv`: places of the grid in 0 ... 1. Without columns A and b are left empty.
class Likelihood {
 public:
  Likelihood(std::vector<Eigen::Vector3i> triangles, std::span<const Eigen::Vector3d> rest,
             std::vector<Eigen::Vector2d> uv, const Eigen::Vector3d& pivot);

  /// Where those of Observation::markers are; none: they are not compared.
  void set_markers(std::vector<MarkerPlace> markers) { markers_ = std::move(markers); }

  /// `delta`: step in the unknowns and own numbers from the prediction's, [Layout::size()]; that of
  /// the registration is absolute, in `registration`, and those of markers are. The clocks move a
  /// frame along its way.
  Block compare(const Observation& seen, const Prediction& predicted, const Layout& layout,
                const Registration6& registration, const Eigen::VectorXd& delta,
                const NoiseModel& noise, bool with_columns);

  /// Distances of the points of every frame from the predicted surface, then of its markers from
  /// where they are predicted [m], NaN beyond `reach` and of markers on no tissue.
  std::vector<std::vector<double>> distances(const Observation& seen, const Prediction& predicted,
                                             const Layout& layout,
                                             const Registration6& registration,
                                             const Eigen::VectorXd& delta, double reach);
  /// Where the markers of a frame are predicted, as the cameras have them, in the order of
  /// SeenFrame::markers [m]; NaN where they are not.
  std::vector<Eigen::Vector3d> marker_places(const Observation& seen, const Prediction& predicted,
                                             std::size_t frame, const Layout& layout,
                                             const Registration6& registration,
                                             const Eigen::VectorXd& delta);
  /// Predicted vertices as the camera has them.
  std::vector<Eigen::Vector3d> moved(const PredictedFrame& frame, const Layout& layout,
                                     const Registration6& registration,
                                     const Eigen::VectorXd& delta, const Eigen::Vector4d& course);
  const std::vector<Eigen::Vector3i>& triangles() const { return surface_.triangles(); }

 private:
  struct Row;
  void add_rays(const Observation& seen, const SeenFrame& frame, const PredictedFrame& predicted,
                const Layout& layout, const Registration6& registration, const NoiseModel& noise,
                Block& block);
  void add_nearest(const Observation& seen, const SeenFrame& frame, const PredictedFrame& predicted,
                   const Layout& layout, const NoiseModel& noise, Block& block);
  void add_row(const Row& row, const PredictedFrame& predicted, const Layout& layout,
               const NoiseModel& noise, Block& block);
  void add_weighted(const Eigen::VectorXd& J, double weight, double e, double late);
  void add_markers(const SeenFrame& frame, const PredictedFrame& predicted, const Layout& layout,
                   const Eigen::VectorXd& delta, const NoiseModel& noise, Block& block);
  void miss_markers(const SeenFrame& frame, const NoiseModel& noise, Block& block) const;
  void add_batch();
  void eliminate_motion(const NoiseModel& noise, Block& block);
  void add_to(Block& block, const Layout& layout, const Eigen::Vector4d& course) const;
  static void add_force(const SeenForce& seen, const PredictedFrame& predicted,
                        const Layout& layout, const Eigen::VectorXd& delta, const NoiseModel& noise,
                        Block& block);

  SeenSurface surface_;
  std::vector<Eigen::Vector2d> uv_;
  Eigen::MatrixXd mode_values_;     ///< [place of the grid][cosine]
  Eigen::Vector3d pivot_, middle_;  ///< the latter of the body at rest
  Eigen::Matrix3d turned_ = Eigen::Matrix3d::Identity();
  std::vector<MarkerPlace> markers_;
  std::vector<std::optional<Eigen::Vector3d>> marker_before_;  ///< what was left a frame before [m]
  std::vector<Eigen::Vector3d> bulge_along_;  ///< ways of the smooth difference at the vertices
  std::vector<Eigen::Vector3d> velocity_;     ///< of the vertices of the last moved() [m/s]
  /// A frame by itself: columns as in Layout, but of the modes each cosine once.
  struct {
    Eigen::MatrixXd A;
    Eigen::VectorXd b;
    std::vector<double> batch;  ///< rows that wait to be added to A
  } frame_;
  /// Of the rows of a frame, by its own time: sums of weight J J, weight J e and weight J (all J).
  struct {
    double information = 0, score = 0;
    Eigen::VectorXd shared_information;
  } motion_;
};

}  // namespace omentum
