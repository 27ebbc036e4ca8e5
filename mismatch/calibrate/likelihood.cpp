#include "mismatch/calibrate/likelihood.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "mismatch/calibrate/likelihood_row.h"

namespace omentum {

using Eigen::Vector2d;
using Eigen::Vector3d;

Eigen::Vector4d course_of(const Observation& seen, const Prediction& predicted, std::size_t k) {
  const double height = predicted.frames[k].tip.z() - seen.track.p_WT.front().z();
  const double lift = predicted.lift > 0 ? std::clamp(height / predicted.lift, 0.0, 1.0) : 0;
  const double begin = seen.frames.front().t, all = seen.frames.back().t - begin;
  return frame_course(lift, all > 0 ? (seen.frames[k].t - begin) / all : 0);
}

Eigen::VectorXf column_step(const Layout& layout, const Eigen::VectorXd& delta) {
  Eigen::VectorXf step(layout.unknowns + kOwnColumns + layout.held);
  step.head(layout.unknowns) = delta.head(layout.unknowns).cast<float>();
  step[layout.stiffness] += static_cast<float>(delta[layout.factor()]);
  step.segment(layout.unknowns, kOwnColumns) =
      delta.segment(layout.pinch(), kOwnColumns).cast<float>();
  step.tail(layout.held) = delta.segment(layout.place(), layout.held).cast<float>();
  return step;
}

/// Derivatives by what the columns of a frame are by, into a row of a block.
void set_columns(const Layout& layout, const Eigen::VectorXf& columns, Eigen::VectorXd& J) {
  J.head(layout.unknowns) = columns.head(layout.unknowns).cast<double>();
  J.segment(layout.pinch(), kOwnColumns) =
      columns.segment(layout.unknowns, kOwnColumns).cast<double>();
  J.segment(layout.place(), layout.held) = columns.tail(layout.held).cast<double>();
  J[layout.factor()] = J[layout.stiffness];
}

Eigen::Matrix3d Registration6::rotation() const {
  return (Eigen::AngleAxisd(turn.z(), Vector3d::UnitZ()) *
          Eigen::AngleAxisd(turn.y(), Vector3d::UnitY()) *
          Eigen::AngleAxisd(turn.x(), Vector3d::UnitX()))
      .toRotationMatrix();
}

Likelihood::Likelihood(std::vector<Eigen::Vector3i> triangles, std::span<const Vector3d> rest,
                       std::vector<Vector2d> uv, const Vector3d& pivot)
    : surface_(std::move(triangles), rest), uv_(std::move(uv)), pivot_(pivot) {
  middle_ = Vector3d::Zero();
  for (const Vector3d& p : rest) middle_ += p / static_cast<double>(rest.size());
  mode_values_.resize(static_cast<Eigen::Index>(uv_.size()), kCosines);
  for (std::size_t p = 0; p < uv_.size(); ++p) {
    for (int i = 0; i < kModesPerSide; ++i) {
      for (int j = 0; j < kModesPerSide; ++j) {
        mode_values_(static_cast<Eigen::Index>(p), i * kModesPerSide + j) =
            std::cos(std::numbers::pi * i * uv_[p].x()) *
            std::cos(std::numbers::pi * j * uv_[p].y());
      }
    }
  }
}

Eigen::Vector4d frame_course(double lift, double share) {
  return {1, lift, lift * lift, lift * std::cos(std::numbers::pi * share)};
}

std::vector<Vector3d> Likelihood::moved(const PredictedFrame& frame, const Layout& layout,
                                        const Registration6& registration,
                                        const Eigen::VectorXd& delta,
                                        const Eigen::Vector4d& course) {
  std::vector<Vector3d> vertices;
  move_in_time(frame, -(delta[layout.clock()] + delta[layout.own_clock()]), vertices, velocity_);
  if (frame.columns.size() > 0) {
    const Eigen::VectorXf by = frame.columns * column_step(layout, delta);
    for (std::size_t i = 0; i < vertices.size(); ++i)
      vertices[i] += by.segment<3>(3 * static_cast<Eigen::Index>(i)).cast<double>();
  }
  const Eigen::Matrix3d R = registration.rotation();
  const Eigen::VectorXd modes = delta.segment(layout.modes(), kModes);
  Eigen::VectorXd bulge;
  std::vector<Vector3d> normal;
  if (!modes.isZero(0)) bulge = mode_values_ * (modes.reshaped(kCosines, kCourses) * course);
  if (bulge.size() > 0 || !markers_.empty()) {
    normal.assign(vertices.size(), Vector3d::Zero());
    for (const Eigen::Vector3i& t : surface_.triangles()) {
      const Vector3d n =
          (vertices[static_cast<std::size_t>(t[1])] - vertices[static_cast<std::size_t>(t[0])])
              .cross(vertices[static_cast<std::size_t>(t[2])] -
                     vertices[static_cast<std::size_t>(t[0])]);
      for (const int v : t) normal[static_cast<std::size_t>(v)] += n;
    }
  }
  const std::size_t places = uv_.size();
  bulge_along_.clear();
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    Vector3d p = vertices[i];
    // Both faces move the same way: that of the upper face.
    const double side = i < places ? 1 : -1;
    if (!markers_.empty()) bulge_along_.push_back(side * (R * normal[i].normalized()));
    if (bulge.size() > 0) {
      p += side * bulge[static_cast<Eigen::Index>(i % places)] * normal[i].normalized();
    }
    vertices[i] = pivot_ + R * (p - pivot_) + registration.shift;
  }
  return vertices;
}

void Likelihood::add_row(const Row& row, const PredictedFrame& predicted, const Layout& layout,
                         const NoiseModel& noise, Block& block) {
  const double sd = noise.sigma * row.sd_factor;
  const double squared = row.e * row.e / (sd * sd);
  block.cost += cost_of(squared, noise.freedom);
  const double weight = weight_of(squared, noise.freedom) / (sd * sd);
  const Vector3d along = turned_.transpose() * row.along;  // before the registration
  const Eigen::Vector3i& corner = surface_.triangles()[static_cast<std::size_t>(row.triangle)];
  Vector3d velocity = Vector3d::Zero();
  for (int k = 0; k < 3; ++k)
    velocity += row.share[k] * velocity_[static_cast<std::size_t>(corner[k])];
  const double late = -along.dot(velocity);
  motion_.information += weight * late * late;
  motion_.score += weight * late * row.e;
  if (block.A.size() == 0) return;
  Eigen::VectorXd J = Eigen::VectorXd::Zero(frame_.b.size());
  const auto places = static_cast<int>(uv_.size());
  Eigen::VectorXf columns = Eigen::VectorXf::Zero(predicted.columns.cols());
  Eigen::VectorXd modes = Eigen::VectorXd::Zero(kCosines);
  for (int k = 0; k < 3; ++k) {
    if (predicted.columns.size() > 0) {
      columns += static_cast<float>(row.share[k]) *
                 (predicted.columns.middleRows<3>(3 * corner[k]).transpose() * along.cast<float>());
    }
    modes += row.share[k] * mode_values_.row(corner[k] % places).transpose();
  }
  if (columns.size() > 0) {
    set_columns(layout, columns, J);
  }
  J.segment<3>(layout.registration()) = row.along;
  J.segment<3>(layout.registration() + 3) = (row.place - pivot_).cross(row.along);
  J[layout.clock()] = late;
  J[layout.own_clock()] = late;
  const double side = corner[0] < places ? 1 : -1;
  J.segment(layout.modes(), kCosines) = side * row.along.dot(row.normal) * modes;
  add_weighted(J, weight, row.e, late);
}

/// A row of the frame: its derivatives and its number `e`, which `late` is by its time.
void Likelihood::add_weighted(const Eigen::VectorXd& J, double weight, double e, double late) {
  const double root = std::sqrt(weight);
  for (Eigen::Index k = 0; k < J.size(); ++k) frame_.batch.push_back(root * J[k]);
  frame_.b += weight * e * J;
  motion_.shared_information += weight * late * J;
  constexpr std::size_t kBatch = 128;  // rows: a product of matrices is faster than one by one
  if (frame_.batch.size() >= kBatch * static_cast<std::size_t>(J.size())) add_batch();
}

void Likelihood::add_batch() {
  if (frame_.batch.empty()) return;
  const Eigen::Index size = frame_.b.size();
  const Eigen::Map<const Eigen::MatrixXd> rows(
      frame_.batch.data(), size, static_cast<Eigen::Index>(frame_.batch.size()) / size);
  frame_.A.selfadjointView<Eigen::Lower>().rankUpdate(rows);
  frame_.batch.clear();
}

/// A frame may be somewhat earlier or later on its way than its clock says, by as much as moves the
/// surface by noise.along_motion: that time is eliminated, to first order.
void Likelihood::eliminate_motion(const NoiseModel& noise, Block& block) {
  double squares = 0;
  for (const Vector3d& v : velocity_) squares += v.squaredNorm();
  const double speed = std::sqrt(squares / static_cast<double>(velocity_.size()));
  const double belief = speed / noise.along_motion;  // 1 / standard deviation of the time [1/s]
  const double information = motion_.information + belief * belief;
  constexpr double kStill = 1e-12;  // [1/s^2]
  if (!(information > kStill)) return;
  block.cost -= 0.5 * motion_.score * motion_.score / information;
  if (block.A.size() == 0) return;
  const Eigen::VectorXd& J = motion_.shared_information;
  frame_.A.selfadjointView<Eigen::Lower>().rankUpdate(J, -1 / information);
  frame_.b -= motion_.score / information * J;
}

/// The frame, each of its cosines as `course` says.
void Likelihood::add_to(Block& block, const Layout& layout, const Eigen::Vector4d& course) const {
  const int n = layout.modes();
  block.A.topLeftCorner(n, n) += frame_.A.topLeftCorner(n, n);
  block.b.head(n) += frame_.b.head(n);
  for (int i = 0; i < kCourses; ++i) {
    const int row = n + i * kCosines;
    block.A.block(row, 0, kCosines, n) += course[i] * frame_.A.bottomLeftCorner(kCosines, n);
    block.b.segment(row, kCosines) += course[i] * frame_.b.tail(kCosines);
    const Eigen::MatrixXd among =
        frame_.A.bottomRightCorner(kCosines, kCosines).selfadjointView<Eigen::Lower>();
    for (int j = 0; j <= i; ++j) {
      block.A.block(row, n + j * kCosines, kCosines, kCosines) += course[i] * course[j] * among;
    }
  }
}

/// The force at a frame. Its clock is not the camera's, so it is as uncertain as it changes.
void Likelihood::add_force(const SeenForce& seen, const PredictedFrame& predicted,
                           const Layout& layout, const Eigen::VectorXd& delta,
                           const NoiseModel& noise, Block& block) {
  constexpr double kClock = 0.05;  // [s] between camera and sensor
  const bool with_columns = predicted.columns.size() > 0;
  Vector3d force = predicted.force;
  if (with_columns)
    force += (predicted.columns.bottomRows<3>() * column_step(layout, delta)).cast<double>();
  const double sd = std::hypot(noise.force, kClock * seen.change);
  for (int axis = 0; axis < 3; ++axis) {
    const double e = seen.value[axis] - (1 + delta[layout.force_gain()]) * force[axis] -
                     delta[layout.force_zero() + axis];
    const double squared = e * e / (sd * sd);
    block.cost += cost_of(squared, noise.freedom);
    block.force_deviation.push_back(e * noise.force / sd);
    if (block.A.size() == 0) continue;
    Eigen::VectorXd J = Eigen::VectorXd::Zero(layout.size());
    if (with_columns) {
      const Eigen::RowVectorXf row = predicted.columns.row(predicted.columns.rows() - 3 + axis);
      set_columns(layout, row.transpose(), J);
    }
    J[layout.force_gain()] = force[axis];
    J[layout.force_zero() + axis] = 1;
    const double weight = weight_of(squared, noise.freedom) / (sd * sd);
    block.A.selfadjointView<Eigen::Lower>().rankUpdate(J, weight);
    block.b += weight * e * J;
  }
}

Block Likelihood::compare(const Observation& seen, const Prediction& predicted,
                          const Layout& layout, const Registration6& registration,
                          const Eigen::VectorXd& delta, const NoiseModel& noise,
                          bool with_columns) {
  Block block;
  if (with_columns) {
    block.A = Eigen::MatrixXd::Zero(layout.size(), layout.size());
    block.b = Eigen::VectorXd::Zero(layout.size());
  }
  turned_ = registration.rotation();
  marker_before_.assign(markers_.size(), std::nullopt);
  for (std::size_t k = 0; k < seen.frames.size(); ++k) {
    const PredictedFrame& frame = predicted.frames[k];
    if (!frame.valid) {
      if (!markers_.empty()) miss_markers(seen.frames[k], noise, block);
      const double far = noise.reach / noise.sigma;
      block.no_tissue += seen.frames[k].points.size();
      block.cost +=
          static_cast<double>(seen.frames[k].points.size()) * cost_of(far * far, noise.freedom);
      continue;
    }
    const Eigen::Vector4d course = course_of(seen, predicted, k);
    surface_.fit(moved(frame, layout, registration, delta, course), seen.p_WC, seen.R_WC);
    const int columns = layout.modes() + kCosines;
    frame_.A.setZero(columns, columns);
    frame_.b.setZero(columns);
    motion_.information = motion_.score = 0;
    motion_.shared_information.setZero(columns);
    if (!seen.frames[k].points.empty() && seen.rays)
      add_rays(seen, seen.frames[k], frame, layout, registration, noise, block);
    if (!seen.frames[k].points.empty() && !seen.rays)
      add_nearest(seen, seen.frames[k], frame, layout, noise, block);
    if (!markers_.empty()) add_markers(seen.frames[k], frame, layout, delta, noise, block);
    add_batch();
    eliminate_motion(noise, block);
    if (with_columns) add_to(block, layout, course);
    if (const auto& force = seen.frames[k].force)
      add_force(*force, frame, layout, delta, noise, block);
  }
  if (with_columns) block.A = block.A.selfadjointView<Eigen::Lower>();
  return block;
}

std::vector<std::vector<double>> Likelihood::distances(const Observation& seen,
                                                       const Prediction& predicted,
                                                       const Layout& layout,
                                                       const Registration6& registration,
                                                       const Eigen::VectorXd& delta, double reach) {
  std::vector<std::vector<double>> all;
  for (std::size_t k = 0; k < seen.frames.size(); ++k) {
    std::vector<double>& list = all.emplace_back();
    const PredictedFrame& frame = predicted.frames[k];
    if (frame.valid) {
      const Eigen::Vector4d course = course_of(seen, predicted, k);
      surface_.fit(moved(frame, layout, registration, delta, course), seen.p_WC, seen.R_WC);
    }
    for (const Vector3d& p : seen.frames[k].points) {
      const TrianglePoint near = frame.valid ? surface_.nearest(p, reach) : TrianglePoint{};
      list.push_back(near.triangle < 0 ? std::numeric_limits<double>::quiet_NaN()
                                       : std::sqrt(near.squared));
    }
    const std::vector<Vector3d> places =
        marker_places(seen, predicted, k, layout, registration, delta);
    for (std::size_t m = 0; m < places.size(); ++m) {
      const double off = (seen.frames[k].markers[m].p - places[m]).norm();
      list.push_back(off < reach ? off : std::numeric_limits<double>::quiet_NaN());
    }
  }
  return all;
}

}  // namespace omentum