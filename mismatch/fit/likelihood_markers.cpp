#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "mismatch/fit/frame_rows.h"
#include "mismatch/fit/likelihood.h"

// Markers of motion capture, row by row (docs/calibrate.md 8).
namespace omentum {

using Eigen::Vector3d;

void FrameRows::add_markers(const SeenFrame& frame, const PredictedFrame& predicted,
                            const NoiseModel& noise, NormalEquations& made) {
  const Eigen::VectorXd& delta = what_.delta;
  constexpr double kAxes = 3;
  constexpr double kOutlier = 5;  // standard deviations
  const auto places = static_cast<int>(of_.uv_.size());
  for (const SeenMarker& seen : frame.markers) {
    const MarkerPlace& place = of_.markers_[static_cast<std::size_t>(seen.marker)];
    if (!place.on_tissue()) continue;
    const PlacedMarker placed =
        place_marker(place, surface_.vertices(), delta.segment<3>(layout_.marker(seen.marker)));
    const Vector3d e = seen.p - placed.p;
    // Of three axes at once: a marker that jumps does so along all.
    const double squared = e.squaredNorm() / (noise.marker * noise.marker);
    made.cost +=
        noise.marker_share * 0.5 * (noise.freedom + kAxes) * std::log1p(squared / noise.freedom);
    const double weight = noise.marker_share * (noise.freedom + kAxes) / (noise.freedom + squared) /
                          (noise.marker * noise.marker);
    ++made.hits;
    for (const double x : e) made.marker_deviation.push_back(x);
    const double longest = kOutlier * noise.marker;
    const Vector3d shortened = e.norm() > longest ? Vector3d(longest * e.normalized()) : e;
    std::optional<Vector3d>& before = marker_before_[static_cast<std::size_t>(seen.marker)];
    if (before) {
      made.marker_squares += 0.5 * (shortened.squaredNorm() + before->squaredNorm());
      made.marker_products += shortened.dot(*before);
      ++made.marker_pairs;
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
      if (made.A.size() == 0) continue;
      Eigen::VectorXd J = Eigen::VectorXd::Zero(b_.size());
      Eigen::VectorXf columns = Eigen::VectorXf::Zero(predicted.columns.cols());
      Eigen::VectorXd modes = Eigen::VectorXd::Zero(layout_.cosines());
      for (int k = 0; k < 3; ++k) {
        const Vector3d& slope = slopes[static_cast<std::size_t>(k)];
        if (predicted.columns.size() > 0) {
          const Vector3d along = turned_.transpose() * slope;
          columns += predicted.columns.middleRows<3>(3 * place.corner[k]).transpose() *
                     along.cast<float>();
        }
        modes += slope.dot(difference_along_[static_cast<std::size_t>(place.corner[k])]) *
                 of_.cosines_.row(place.corner[k] % places).transpose();
      }
      if (columns.size() > 0) set_columns(columns, J);
      J[layout_.registration.begin + axis] = 1;
      J.segment<3>(layout_.registration.begin + 3) =
          (placed.p - of_.pivot_).cross(Vector3d::Unit(axis));
      J[layout_.clock.begin] = late;
      J[layout_.own_clock.begin] = late;
      J.segment<3>(layout_.marker(seen.marker)) = placed.frame.row(axis).transpose();
      J.segment(layout_.modes.begin, layout_.cosines()) = modes;
      add_weighted(J, weight, e[axis], late);
    }
  }
}

std::vector<Vector3d> Likelihood::marker_places(const Comparison& what, std::size_t k) const {
  std::vector<Vector3d> places;
  std::vector<Vector3d> vertices;
  if (what.predicted.frames[k].valid && !markers_.empty()) {
    FrameRows rows(*this, what);
    vertices = rows.vertices(k, rows.in_time(k));
  }
  for (const SeenMarker& marker : what.seen.frames[k].markers) {
    const auto m = static_cast<std::size_t>(marker.marker);
    places.push_back(Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
    if (vertices.empty() || !markers_[m].on_tissue()) continue;
    places.back() = place_marker(markers_[m], vertices,
                                 what.delta.segment<3>(what.layout.marker(marker.marker)))
                        .p;
  }
  return places;
}

}  // namespace omentum
