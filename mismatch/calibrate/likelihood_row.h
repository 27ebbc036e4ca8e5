#pragma once

#include <Eigen/Core>
#include <cmath>

#include "mismatch/calibrate/likelihood.h"

namespace omentum {

/// One number that was seen, less what is predicted.
struct Likelihood::Row {
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

/// Step of what the columns of a frame are by.
Eigen::VectorXf column_step(const Layout& layout, const Eigen::VectorXd& delta);
/// Derivatives by what the columns of a frame are by, into a row of a block.
void set_columns(const Layout& layout, const Eigen::VectorXf& columns, Eigen::VectorXd& J);

/// How the smooth difference goes at a frame (frame_course()).
Eigen::Vector4d course_of(const Observation& seen, const Prediction& predicted, std::size_t frame);

}  // namespace omentum
