#pragma once

#include <Eigen/Core>
#include <cmath>
#include <optional>
#include <vector>

#include "mismatch/fit/likelihood.h"

namespace omentum {

/// One number that was seen, less what is predicted.
struct SeenRow {
  double e = 0;            ///< [m]
  double sd_factor = 1;    ///< of sigma
  Eigen::Vector3d along;   ///< d predicted / d place of the surface
  int triangle = -1;       ///< the place: of a triangle,
  Eigen::Vector3d share;   ///< at barycentric coordinates
  Eigen::Vector3d normal;  ///< of the surface there
  Eigen::Vector3d place;   ///< p_W [m]
};

/// Of Student's t: minus its logarithm but for constants, and the weight of a row in least squares,
/// by the square of a deviation over its standard deviation.
inline double cost_of(double squared, double freedom) {
  return 0.5 * (freedom + 1) * std::log1p(squared / freedom);
}
inline double weight_of(double squared, double freedom) {
  return (freedom + 1) / (freedom + squared);
}

/// Rows of one frame after the other of a recording, added to its normal equations. Part of
/// Likelihood, made for one comparison and thrown away with it.
class FrameRows {
 public:
  FrameRows(const Likelihood& likelihood, const Comparison& what);

  /// Puts the surface where frame k has it.
  void place(std::size_t k);
  /// Rows of frame k, which was placed, into `made`, with A and b where they have a size.
  void add_frame(std::size_t k, const NoiseModel& noise, NormalEquations& made);
  /// Of a frame that is not simulated: all that was seen is as far as can be.
  void miss_frame(std::size_t k, const NoiseModel& noise, NormalEquations& made) const;

  const SeenSurface& surface() const { return surface_; }
  /// Predicted vertices of frame k as the camera has them, with the smooth difference times `time`.
  std::vector<Eigen::Vector3d> vertices(std::size_t k, const Eigen::Vector4d& time);
  /// Values of the functions of time at frame k.
  Eigen::Vector4d in_time(std::size_t k) const;

 private:
  void add_rays(const SeenFrame& frame, const PredictedFrame& predicted, const NoiseModel& noise,
                NormalEquations& made);
  void add_gaps(const PredictedFrame& predicted, const class PictureIndex& index, double spacing,
                const NoiseModel& noise, NormalEquations& made);
  void add_nearest(const SeenFrame& frame, const PredictedFrame& predicted, const NoiseModel& noise,
                   NormalEquations& made);
  void add_row(const SeenRow& row, const PredictedFrame& predicted, const NoiseModel& noise,
               NormalEquations& made);
  void add_weighted(const Eigen::VectorXd& J, double weight, double e, double late);
  void add_markers(const SeenFrame& frame, const PredictedFrame& predicted, const NoiseModel& noise,
                   NormalEquations& made);
  void add_force(const SeenForce& seen, const PredictedFrame& predicted, const NoiseModel& noise,
                 NormalEquations& made) const;
  void add_batch();
  void eliminate_motion(const NoiseModel& noise, NormalEquations& made);
  void add_to(NormalEquations& made, const Eigen::Vector4d& time) const;
  Eigen::VectorXf column_step() const;
  void set_columns(const Eigen::VectorXf& columns, Eigen::VectorXd& J) const;

  const Likelihood& of_;
  const Comparison& what_;
  const Layout& layout_;
  SeenSurface surface_;
  Eigen::Matrix3d turned_;
  std::vector<std::optional<Eigen::Vector3d>> marker_before_;  ///< left a frame before [m]
  std::vector<Eigen::Vector3d> difference_along_;  ///< of the smooth difference at the vertices
  std::vector<Eigen::Vector3d> velocity_;          ///< of the vertices of the frame placed [m/s]
  // The frame by itself: columns as in Layout, but of the modes each cosine once.
  Eigen::MatrixXd A_;
  Eigen::VectorXd b_;
  std::vector<double> batch_;  ///< rows that wait to be added to A
  /// Of the rows of the frame, by its own time: sums of weight J J, weight J e and weight J (all
  /// J).
  struct {
    double information = 0, score = 0;
    Eigen::VectorXd shared_information;
  } motion_;
};

}  // namespace omentum
