#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "mismatch/calibrate/likelihood.h"
#include "mismatch/calibrate/likelihood_row.h"

// Markers of motion capture, row by row (docs/calibrate.md 8).
namespace omentum {

using Eigen::Vector3d;

void Likelihood::add_markers(const SeenFrame& frame, const PredictedFrame& predicted,
                             const Layout& layout, const Eigen::VectorXd& delta,
                             const NoiseModel& noise, Block& block) {
  constexpr double kAxes = 3;
  constexpr double kOutlier = 5;  // standard deviations
  const auto places = static_cast<int>(uv_.size());
  for (const SeenMarker& seen : frame.markers) {
    const MarkerPlace& place = markers_[static_cast<std::size_t>(seen.marker)];
    if (!place.on_tissue()) continue;
    const PlacedMarker placed =
        place_marker(place, surface_.vertices(), delta.segment<3>(layout.marker(seen.marker)));
    const Vector3d e = seen.p - placed.p;
    // Of three axes at once: a marker that jumps does so along all.
    const double squared = e.squaredNorm() / (noise.marker * noise.marker);
    block.cost +=
        noise.marker_share * 0.5 * (noise.freedom + kAxes) * std::log1p(squared / noise.freedom);
    const double weight = noise.marker_share * (noise.freedom + kAxes) / (noise.freedom + squared) /
                          (noise.marker * noise.marker);
    ++block.hits;
    for (const double x : e) block.marker_deviation.push_back(x);
    const double longest = kOutlier * noise.marker;
    const Vector3d shortened = e.norm() > longest ? Vector3d(longest * e.normalized()) : e;
    std::optional<Vector3d>& before = marker_before_[static_cast<std::size_t>(seen.marker)];
    if (before) {
      block.marker_squares += 0.5 * (shortened.squaredNorm() + before->squaredNorm());
      block.marker_products += shortened.dot(*before);
      ++block.marker_pairs;
    }
    before = shortened;
    for (int axis = 0; axis < 3; ++axis) {
      const std::array<Vector3d, 3> slopes =
          corner_slopes(place, placed, surface_.vertices(), Vector3d::Unit(axis));
      double late = 0;
      for (int k = 0; k < 3; ++k) {
        // Velocities are those before the registration.
        late -= (turned_.transpose() * slopes[static_cast<std::size_t>(k)])
                    .dot(velocity_[static_cast<std::size_t>(place.corner[k])]);
      }
      motion_.information += weight * late * late;
      motion_.score += weight * late * e[axis];
      if (block.A.size() == 0) continue;
      Eigen::VectorXd J = Eigen::VectorXd::Zero(frame_.b.size());
      Eigen::VectorXf columns = Eigen::VectorXf::Zero(predicted.columns.cols());
      Eigen::VectorXd modes = Eigen::VectorXd::Zero(kCosines);
      for (int k = 0; k < 3; ++k) {
        const Vector3d& slope = slopes[static_cast<std::size_t>(k)];
        if (predicted.columns.size() > 0) {
          const Vector3d along = turned_.transpose() * slope;
          columns += predicted.columns.middleRows<3>(3 * place.corner[k]).transpose() *
                     along.cast<float>();
        }
        modes += slope.dot(bulge_along_[static_cast<std::size_t>(place.corner[k])]) *
                 mode_values_.row(place.corner[k] % places).transpose();
      }
      if (columns.size() > 0) set_columns(layout, columns, J);
      J[layout.registration() + axis] = 1;
      J.segment<3>(layout.registration() + 3) = (placed.p - pivot_).cross(Vector3d::Unit(axis));
      J[layout.clock()] = late;
      J[layout.own_clock()] = late;
      J.segment<3>(layout.marker(seen.marker)) = placed.frame.row(axis).transpose();
      J.segment(layout.modes(), kCosines) = modes;
      add_weighted(J, weight, e[axis], late);
    }
  }
}

/// Markers of a frame that is not simulated are as far from it as can be.
void Likelihood::miss_markers(const SeenFrame& frame, const NoiseModel& noise, Block& block) const {
  constexpr double kFar = 0.03;  // [m]
  for (const SeenMarker& seen : frame.markers) {
    if (!markers_[static_cast<std::size_t>(seen.marker)].on_tissue()) continue;
    const double far = kFar / noise.marker;
    block.cost +=
        noise.marker_share * 0.5 * (noise.freedom + 3) * std::log1p(far * far / noise.freedom);
    ++block.no_tissue;
  }
}

std::vector<Vector3d> Likelihood::marker_places(const Observation& seen,
                                                const Prediction& predicted, std::size_t k,
                                                const Layout& layout,
                                                const Registration6& registration,
                                                const Eigen::VectorXd& delta) {
  const PredictedFrame& frame = predicted.frames[k];
  std::vector<Vector3d> places;
  std::vector<Vector3d> vertices;
  if (frame.valid && !markers_.empty())
    vertices = moved(frame, layout, registration, delta, course_of(seen, predicted, k));
  for (const SeenMarker& marker : seen.frames[k].markers) {
    const auto m = static_cast<std::size_t>(marker.marker);
    places.push_back(Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
    if (vertices.empty() || !markers_[m].on_tissue()) continue;
    places.back() =
        place_marker(markers_[m], vertices, delta.segment<3>(layout.marker(marker.marker))).p;
  }
  return places;
}

}  // namespace omentum
