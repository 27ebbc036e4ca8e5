#include "mismatch/fit/likelihood.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "core/check.h"
#include "mismatch/fit/frame_rows.h"

namespace omentum {

using Eigen::Vector2d;
using Eigen::Vector3d;

FrameRows::FrameRows(const Likelihood& likelihood, const Comparison& what)
    : of_(likelihood),
      what_(what),
      layout_(what.layout),
      surface_(likelihood.surface_),
      turned_(what.registration.rotation()),
      marker_before_(likelihood.markers_.size()) {}

Eigen::Vector4d FrameRows::in_time(std::size_t k) const {
  const Observation& seen = what_.seen;
  const Prediction& predicted = what_.predicted;
  const double height = predicted.frames[k].tip.z() - seen.track.p_WT.front().z();
  const double lift = predicted.lift > 0 ? std::clamp(height / predicted.lift, 0.0, 1.0) : 0;
  const double begin = seen.frames.front().t, all = seen.frames.back().t - begin;
  return discrepancy_in_time(lift, all > 0 ? (seen.frames[k].t - begin) / all : 0);
}

/// Step of what the columns of a frame are by.
Eigen::VectorXf FrameRows::column_step() const {
  const Eigen::VectorXd& delta = what_.delta;
  const int n = layout_.unknowns.count;
  Eigen::VectorXf step(n + kOwnColumns + layout_.held_place.count);
  step.head(n) = delta.head(n).cast<float>();
  step[kStiffnessUnknown] += static_cast<float>(delta[layout_.stiffness_factor.begin]);
  step.segment(n, kOwnColumns) = delta.segment(layout_.pinch.begin, kOwnColumns).cast<float>();
  step.tail(layout_.held_place.count) =
      delta.segment(layout_.held_place.begin, layout_.held_place.count).cast<float>();
  return step;
}

/// Derivatives by what the columns of a frame are by, into a row of the normal equations.
void FrameRows::set_columns(const Eigen::VectorXf& columns, Eigen::VectorXd& J) const {
  const int n = layout_.unknowns.count;
  J.head(n) = columns.head(n).cast<double>();
  J.segment(layout_.pinch.begin, kOwnColumns) = columns.segment(n, kOwnColumns).cast<double>();
  J.segment(layout_.held_place.begin, layout_.held_place.count) =
      columns.tail(layout_.held_place.count).cast<double>();
  J[layout_.stiffness_factor.begin] = J[kStiffnessUnknown];
}

Eigen::Matrix3d Registration6::rotation() const {
  return (Eigen::AngleAxisd(turn.z(), Vector3d::UnitZ()) *
          Eigen::AngleAxisd(turn.y(), Vector3d::UnitY()) *
          Eigen::AngleAxisd(turn.x(), Vector3d::UnitX()))
      .toRotationMatrix();
}

Likelihood::Likelihood(std::vector<Eigen::Vector3i> triangles, std::span<const Vector3d> rest,
                       std::vector<Vector2d> uv, const Vector3d& pivot, int cosines_per_side)
    : surface_(std::move(triangles), rest),
      uv_(std::move(uv)),
      pivot_(pivot),
      covered_(rest.size(), false) {
  middle_ = Vector3d::Zero();
  for (const Vector3d& p : rest) middle_ += p / static_cast<double>(rest.size());
  cosines_.resize(static_cast<Eigen::Index>(uv_.size()), cosines_per_side * cosines_per_side);
  for (std::size_t p = 0; p < uv_.size(); ++p) {
    for (int i = 0; i < cosines_per_side; ++i) {
      for (int j = 0; j < cosines_per_side; ++j) {
        cosines_(static_cast<Eigen::Index>(p), i * cosines_per_side + j) =
            std::cos(std::numbers::pi * i * uv_[p].x()) *
            std::cos(std::numbers::pi * j * uv_[p].y());
      }
    }
  }
}

void Likelihood::set_covered(std::vector<bool> covered) {
  OMENTUM_CHECK(covered.size() == covered_.size(), "{} of {}", covered.size(), covered_.size());
  covered_ = std::move(covered);
}

Eigen::Vector4d discrepancy_in_time(double lift, double share) {
  return {1, lift, lift * lift, lift * std::cos(std::numbers::pi * share)};
}

std::vector<Vector3d> FrameRows::vertices(std::size_t k, const Eigen::Vector4d& time) {
  const PredictedFrame& frame = what_.predicted.frames[k];
  const Eigen::VectorXd& delta = what_.delta;
  std::vector<Vector3d> vertices;
  move_in_time(frame, -(delta[layout_.clock.begin] + delta[layout_.own_clock.begin]), vertices,
               velocity_);
  if (frame.columns.size() > 0) {
    const Eigen::VectorXf by = frame.columns * column_step();
    for (std::size_t i = 0; i < vertices.size(); ++i)
      vertices[i] += by.segment<3>(3 * static_cast<Eigen::Index>(i)).cast<double>();
  }
  const Eigen::VectorXd modes = delta.segment(layout_.modes.begin, layout_.modes.count);
  Eigen::VectorXd height;
  std::vector<Vector3d> normal;
  if (!modes.isZero(0))
    height = of_.cosines_ * (modes.reshaped(layout_.cosines(), kTimeFunctions) * time);
  if (height.size() > 0 || !of_.markers_.empty()) {
    normal.assign(vertices.size(), Vector3d::Zero());
    for (const Eigen::Vector3i& t : surface_.triangles()) {
      const Vector3d n =
          (vertices[static_cast<std::size_t>(t[1])] - vertices[static_cast<std::size_t>(t[0])])
              .cross(vertices[static_cast<std::size_t>(t[2])] -
                     vertices[static_cast<std::size_t>(t[0])]);
      for (const int v : t) normal[static_cast<std::size_t>(v)] += n;
    }
  }
  const std::size_t places = of_.uv_.size();
  difference_along_.clear();
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    Vector3d p = vertices[i];
    // Both faces move the same way: that of the upper face.
    const double side = i < places ? 1 : -1;
    if (!of_.markers_.empty())
      difference_along_.push_back(side * (turned_ * normal[i].normalized()));
    if (height.size() > 0)
      p += side * height[static_cast<Eigen::Index>(i % places)] * normal[i].normalized();
    vertices[i] = of_.pivot_ + turned_ * (p - of_.pivot_) + what_.registration.shift;
  }
  return vertices;
}

void FrameRows::place(std::size_t k) {
  surface_.fit(vertices(k, in_time(k)), what_.seen.p_WC, what_.seen.R_WC);
}

void FrameRows::add_row(const SeenRow& row, const PredictedFrame& predicted,
                        const NoiseModel& noise, NormalEquations& made) {
  const double sd = noise.sigma * row.sd_factor;
  const double squared = row.e * row.e / (sd * sd);
  made.cost += cost_of(squared, noise.freedom);
  const double weight = weight_of(squared, noise.freedom) / (sd * sd);
  const Vector3d along = turned_.transpose() * row.along;  // before the registration
  const Eigen::Vector3i& corner = surface_.triangles()[static_cast<std::size_t>(row.triangle)];
  Vector3d velocity = Vector3d::Zero();
  for (int k = 0; k < 3; ++k)
    velocity += row.share[k] * velocity_[static_cast<std::size_t>(corner[k])];
  const double late = -along.dot(velocity);
  motion_.information += weight * late * late;
  motion_.score += weight * late * row.e;
  if (made.A.size() == 0) return;
  Eigen::VectorXd J = Eigen::VectorXd::Zero(b_.size());
  const auto places = static_cast<int>(of_.uv_.size());
  Eigen::VectorXf columns = Eigen::VectorXf::Zero(predicted.columns.cols());
  Eigen::VectorXd modes = Eigen::VectorXd::Zero(layout_.cosines());
  for (int k = 0; k < 3; ++k) {
    if (predicted.columns.size() > 0) {
      columns += static_cast<float>(row.share[k]) *
                 (predicted.columns.middleRows<3>(3 * corner[k]).transpose() * along.cast<float>());
    }
    modes += row.share[k] * of_.cosines_.row(corner[k] % places).transpose();
  }
  if (columns.size() > 0) {
    set_columns(columns, J);
  }
  J.segment<3>(layout_.registration.begin) = row.along;
  J.segment<3>(layout_.registration.begin + 3) = (row.place - of_.pivot_).cross(row.along);
  J[layout_.clock.begin] = late;
  J[layout_.own_clock.begin] = late;
  const double side = corner[0] < places ? 1 : -1;
  J.segment(layout_.modes.begin, layout_.cosines()) = side * row.along.dot(row.normal) * modes;
  add_weighted(J, weight, row.e, late);
}

/// A row of the frame: its derivatives and its number `e`, which `late` is by its time.
void FrameRows::add_weighted(const Eigen::VectorXd& J, double weight, double e, double late) {
  const double root = std::sqrt(weight);
  for (Eigen::Index k = 0; k < J.size(); ++k) batch_.push_back(root * J[k]);
  b_ += weight * e * J;
  motion_.shared_information += weight * late * J;
  constexpr std::size_t kBatch = 128;  // rows: a product of matrices is faster than one by one
  if (batch_.size() >= kBatch * static_cast<std::size_t>(J.size())) add_batch();
}

void FrameRows::add_batch() {
  if (batch_.empty()) return;
  const Eigen::Index size = b_.size();
  const Eigen::Map<const Eigen::MatrixXd> rows(batch_.data(), size,
                                               static_cast<Eigen::Index>(batch_.size()) / size);
  A_.selfadjointView<Eigen::Lower>().rankUpdate(rows);
  batch_.clear();
}

/// A frame may be somewhat earlier or later on its way than its clock says, by as much as moves the
/// surface by noise.along_motion: that time is eliminated, to first order.
void FrameRows::eliminate_motion(const NoiseModel& noise, NormalEquations& made) {
  double squares = 0;
  for (const Vector3d& v : velocity_) squares += v.squaredNorm();
  const double speed = std::sqrt(squares / static_cast<double>(velocity_.size()));
  const double belief = speed / noise.along_motion;  // 1 / standard deviation of the time [1/s]
  const double information = motion_.information + belief * belief;
  constexpr double kStill = 1e-12;  // [1/s^2]
  if (!(information > kStill)) return;
  made.cost -= 0.5 * motion_.score * motion_.score / information;
  if (made.A.size() == 0) return;
  const Eigen::VectorXd& J = motion_.shared_information;
  A_.selfadjointView<Eigen::Lower>().rankUpdate(J, -1 / information);
  b_ -= motion_.score / information * J;
}

/// The frame, each of its cosines times the functions of time.
void FrameRows::add_to(NormalEquations& made, const Eigen::Vector4d& time) const {
  const int n = layout_.modes.begin, cosines = layout_.cosines();
  made.A.topLeftCorner(n, n) += A_.topLeftCorner(n, n);
  made.b.head(n) += b_.head(n);
  for (int i = 0; i < kTimeFunctions; ++i) {
    const int row = n + i * cosines;
    made.A.block(row, 0, cosines, n) += time[i] * A_.bottomLeftCorner(cosines, n);
    made.b.segment(row, cosines) += time[i] * b_.tail(cosines);
    const Eigen::MatrixXd among =
        A_.bottomRightCorner(cosines, cosines).selfadjointView<Eigen::Lower>();
    for (int j = 0; j <= i; ++j) {
      made.A.block(row, n + j * cosines, cosines, cosines) += time[i] * time[j] * among;
    }
  }
}

/// The force at a frame. Its clock is not the camera's, so it is as uncertain as it changes.
void FrameRows::add_force(const SeenForce& seen, const PredictedFrame& predicted,
                          const NoiseModel& noise, NormalEquations& made) const {
  const Eigen::VectorXd& delta = what_.delta;
  constexpr double kClock = 0.05;  // [s] between camera and sensor
  const bool with_columns = predicted.columns.size() > 0;
  Vector3d force = predicted.force;
  if (with_columns) force += (predicted.columns.bottomRows<3>() * column_step()).cast<double>();
  const double sd = std::hypot(noise.force, kClock * seen.change);
  for (int axis = 0; axis < 3; ++axis) {
    const double e = seen.value[axis] - (1 + delta[layout_.force_gain.begin]) * force[axis] -
                     delta[layout_.force_zero.begin + axis];
    const double squared = e * e / (sd * sd);
    made.cost += cost_of(squared, noise.freedom);
    made.force_deviation.push_back(e * noise.force / sd);
    if (made.A.size() == 0) continue;
    Eigen::VectorXd J = Eigen::VectorXd::Zero(layout_.size());
    if (with_columns) {
      const Eigen::RowVectorXf row = predicted.columns.row(predicted.columns.rows() - 3 + axis);
      set_columns(row.transpose(), J);
    }
    J[layout_.force_gain.begin] = force[axis];
    J[layout_.force_zero.begin + axis] = 1;
    const double weight = weight_of(squared, noise.freedom) / (sd * sd);
    made.A.selfadjointView<Eigen::Lower>().rankUpdate(J, weight);
    made.b += weight * e * J;
  }
}

void FrameRows::add_frame(std::size_t k, const NoiseModel& noise, NormalEquations& made) {
  const SeenFrame& seen = what_.seen.frames[k];
  const PredictedFrame& frame = what_.predicted.frames[k];
  const int columns = layout_.modes.begin + layout_.cosines();
  A_.setZero(columns, columns);
  b_.setZero(columns);
  motion_.information = motion_.score = 0;
  motion_.shared_information.setZero(columns);
  if (!seen.points.empty() && what_.seen.rays) add_rays(seen, frame, noise, made);
  if (!seen.points.empty() && !what_.seen.rays) add_nearest(seen, frame, noise, made);
  if (!of_.markers_.empty()) add_markers(seen, frame, noise, made);
  add_batch();
  eliminate_motion(noise, made);
  if (made.A.size() > 0) add_to(made, in_time(k));
  if (seen.force) add_force(*seen.force, frame, noise, made);
}

void FrameRows::miss_frame(std::size_t k, const NoiseModel& noise, NormalEquations& made) const {
  const SeenFrame& seen = what_.seen.frames[k];
  constexpr double kFar = 0.03;  // [m] of a marker
  for (const SeenMarker& marker : seen.markers) {
    if (!of_.markers_[static_cast<std::size_t>(marker.marker)].on_tissue()) continue;
    const double far = kFar / noise.marker;
    made.cost +=
        noise.marker_share * 0.5 * (noise.freedom + 3) * std::log1p(far * far / noise.freedom);
    ++made.no_tissue;
  }
  const double far = noise.reach / noise.sigma;
  made.no_tissue += seen.points.size();
  made.cost += static_cast<double>(seen.points.size()) * cost_of(far * far, noise.freedom);
}

NormalEquations Likelihood::compare(const Comparison& what, const NoiseModel& noise,
                                    bool with_columns) const {
  NormalEquations made;
  if (with_columns) {
    made.A = Eigen::MatrixXd::Zero(what.layout.size(), what.layout.size());
    made.b = Eigen::VectorXd::Zero(what.layout.size());
  }
  FrameRows rows(*this, what);
  for (std::size_t k = 0; k < what.seen.frames.size(); ++k) {
    if (!what.predicted.frames[k].valid) {
      rows.miss_frame(k, noise, made);
      continue;
    }
    rows.place(k);
    rows.add_frame(k, noise, made);
  }
  if (with_columns) made.A = made.A.selfadjointView<Eigen::Lower>();
  return made;
}

std::vector<std::vector<double>> Likelihood::distances(const Comparison& what, double reach) const {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  std::vector<std::vector<double>> all;
  FrameRows rows(*this, what);
  for (std::size_t k = 0; k < what.seen.frames.size(); ++k) {
    std::vector<double>& list = all.emplace_back();
    const SeenFrame& seen = what.seen.frames[k];
    const bool valid = what.predicted.frames[k].valid;
    if (valid) rows.place(k);
    for (const Vector3d& p : seen.points) {
      const TrianglePoint near = valid ? rows.surface().nearest(p, reach) : TrianglePoint{};
      if (near.triangle < 0) {
        list.push_back(kNone);
        continue;
      }
      const SeenSurface& surface = rows.surface();
      const double outside =
          (p - surface.at(near.triangle, near.share)).dot(surface.normal(near.triangle));
      list.push_back(std::copysign(std::sqrt(near.squared), outside));
    }
    const std::vector<Vector3d> places = marker_places(what, k);
    for (std::size_t m = 0; m < places.size(); ++m) {
      const double off = (seen.markers[m].p - places[m]).norm();
      list.push_back(off < reach ? off : kNone);
    }
  }
  return all;
}

std::vector<Vector3d> Likelihood::vertices(const Comparison& what, std::size_t frame) const {
  return FrameRows(*this, what).vertices(frame, Eigen::Vector4d::Zero());
}

}  // namespace omentum
