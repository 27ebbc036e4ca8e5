#include "mismatch/calibrate/likelihood.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <compare>
#include <limits>
#include <numbers>

#include "core/check.h"

namespace omentum {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double kMostGap = 0.008;  // [m] from the next point: farther off nothing was looked at
constexpr double kShaftShadow = 0.012;  // [m] around the shaft no gap counts
constexpr double kCropped = 0.25;       // share of places without any point nearby

double cost_of(double squared, double freedom) {
  return 0.5 * (freedom + 1) * std::log1p(squared / freedom);
}
double weight_of(double squared, double freedom) { return (freedom + 1) / (freedom + squared); }

/// Points of a picture in rows of cells, to find the nearest one.
class PictureIndex {
 public:
  PictureIndex(std::vector<Vector2d> points, double reach)
      : points_(std::move(points)), reach_(reach) {
    for (std::size_t k = 0; k < points_.size(); ++k)
      entries_.push_back({cell_of(points_[k].y()), cell_of(points_[k].x()), k});
    std::ranges::sort(entries_);
  }
  /// Nearest within the reach; nothing beyond.
  std::optional<std::size_t> nearest(const Vector2d& q, std::size_t skip) const {
    std::optional<std::size_t> best;
    double least = reach_ * reach_;
    const int x = cell_of(q.x()), y = cell_of(q.y());
    // In ever larger squares, until no cell outside can have a nearer one.
    for (int around = 1; around <= kCells; around *= 2) {
      for (int row = y - around; row <= y + around; ++row) {
        auto entry = std::ranges::lower_bound(entries_, Entry{row, x - around, 0});
        for (; entry != entries_.end() && entry->y == row && entry->x <= x + around; ++entry) {
          const double squared = (points_[entry->point] - q).squaredNorm();
          if (entry->point == skip || !(squared < least)) continue;
          least = squared;
          best = entry->point;
        }
      }
      const double seen = around * reach_ / kCells;
      if (best && least <= seen * seen) break;
    }
    return best;
  }
  const Vector2d& at(std::size_t k) const { return points_[k]; }
  /// Median distance from a point to the next one; 0 where none has one.
  double spacing() const {
    std::vector<double> spacing;
    for (std::size_t k = 0; k < size(); k += 7) {
      if (const auto other = nearest(points_[k], k))
        spacing.push_back((points_[*other] - points_[k]).norm());
    }
    if (spacing.empty()) return 0;
    const auto middle = spacing.begin() + static_cast<std::ptrdiff_t>(spacing.size() / 2);
    std::nth_element(spacing.begin(), middle, spacing.end());
    return *middle;
  }
  std::size_t size() const { return points_.size(); }

 private:
  static constexpr int kCells = 8;  ///< of the reach
  struct Entry {
    int y, x;
    std::size_t point;
    auto operator<=>(const Entry&) const = default;
  };
  int cell_of(double at) const {
    constexpr double kFar = 1e9;  // beside the camera
    return static_cast<int>(std::floor(std::clamp(kCells * at / reach_, -kFar, kFar)));
  }
  std::vector<Vector2d> points_;
  double reach_;
  std::vector<Entry> entries_;
};

/// Distance of a point from the shaft, which stands up from the tip.
double shaft_distance(const Vector3d& p, const Vector3d& tip, const Vector3d& p_WC) {
  // Of the ray to the point, where it passes the line over the tip.
  const Vector3d d = (p - p_WC).normalized();
  const Vector3d w = p_WC - tip;
  const double b = d.z(), bottom = 1 - b * b;
  if (bottom < 1e-9) return (p - tip).head<2>().norm();
  double height = (w.z() - b * d.dot(w)) / bottom;
  height = std::clamp(height, 0.0, 0.3);
  const double s = height * b - d.dot(w);
  if (s > (p - p_WC).norm()) return std::numeric_limits<double>::infinity();
  return (w + s * d - height * Vector3d::UnitZ()).norm();
}

Eigen::Vector4d course_of(const Observation& seen, const Prediction& predicted, std::size_t k) {
  const double height = predicted.frames[k].tip.z() - seen.track.p_WT.front().z();
  const double lift = predicted.lift > 0 ? std::clamp(height / predicted.lift, 0.0, 1.0) : 0;
  const double begin = seen.frames.front().t, all = seen.frames.back().t - begin;
  return frame_course(lift, all > 0 ? (seen.frames[k].t - begin) / all : 0);
}

/// Step of what the columns of a frame are by.
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

}  // namespace

Eigen::Matrix3d Registration6::rotation() const {
  return (Eigen::AngleAxisd(turn.z(), Vector3d::UnitZ()) *
          Eigen::AngleAxisd(turn.y(), Vector3d::UnitY()) *
          Eigen::AngleAxisd(turn.x(), Vector3d::UnitX()))
      .toRotationMatrix();
}

/// One number that was seen, less what is predicted.
struct Likelihood::Row {
  double e = 0;          ///< [m]
  double sd_factor = 1;  ///< of sigma
  Vector3d along;        ///< d predicted / d place of the surface
  int triangle = -1;     ///< the place: of a triangle,
  Vector3d share;        ///< at barycentric coordinates
  Vector3d normal;       ///< of the surface there
  Vector3d place;        ///< p_W [m]
};

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

void Likelihood::add_frame(const Observation& seen, const SeenFrame& frame,
                           const PredictedFrame& predicted, const Layout& layout,
                           const Registration6& registration, const NoiseModel& noise,
                           Block& block) {
  constexpr double kEdgeOn = 0.15;  // cosine between ray and normal: flatter counts as this
  std::vector<Vector2d> picture;
  for (const Vector3d& p : frame.points) {
    if (const std::optional<Vector2d> place = surface_.project(p)) picture.push_back(*place);
  }
  const double depth = (middle_ - seen.p_WC).norm();
  const PictureIndex index(std::move(picture), 2 * kMostGap / depth);
  // Which rays met nothing no cloud says: an edge is known to a spacing only, and the body that was
  // seen may lack points within 1.4 spacings of a corner. So much more, on either side, does not
  // count: rows that pull one way where nothing is wrong would, in many frames, make another body.
  const double spacing = index.spacing();
  constexpr double kSlack = 1;  // [spacings]
  for (const Vector3d& p : frame.points) {
    Row row;
    const Vector3d d = (p - seen.p_WC).normalized();
    const std::optional<RayHit> hit = surface_.cast(p);
    const double range = (p - seen.p_WC).norm();
    // A ray that meets the surface within reach says where it is; else it is looked for.
    TrianglePoint near;
    if (!hit || !(std::fabs(range - hit->range) < noise.reach)) {
      near = surface_.nearest(p, noise.reach);
      if (near.triangle < 0) {
        ++block.no_tissue;
        const double far = noise.reach / noise.sigma;
        block.cost += cost_of(far * far, noise.freedom);
        continue;
      }
    }
    // A ray that passes the surface counts by its range against the face at the edge, continued, as
    // one that just meets it does, and by how far it passes: a body too small must not look better.
    RayHit met;
    Vector3d off = Vector3d::Zero();
    if (hit) {
      met = *hit;
    } else {
      constexpr double kInside = 1e-5;  // [m] of the edge: which of its faces the camera sees
      const TrianglePoint miss = surface_.nearest_to_ray(p, noise.reach);
      const TrianglePoint& edge = miss.triangle < 0 ? near : miss;
      met = {edge.triangle, edge.share, 0};
      row.place = surface_.at(met);
      off = p - row.place;
      const Vector3d w = (off - off.dot(d) * d).normalized();
      if (const auto face = surface_.cast(row.place - kInside * w)) met = *face;
    }
    row.triangle = met.triangle;
    row.share = met.share;
    row.normal = surface_.normal(row.triangle);
    const double cosine = row.normal.dot(d);
    const double flat = std::copysign(std::max(std::fabs(cosine), kEdgeOn), cosine);
    const double slope = 1 / (flat * flat) - 1;  // tan^2
    row.sd_factor =
        std::sqrt(1 + slope * noise.lateral * noise.lateral / (noise.sigma * noise.sigma));
    // In front of another part of the body: then it is that part's edge that was seen.
    const double limit = noise.reach / std::max(std::fabs(cosine), kEdgeOn);
    if (hit) {
      row.e = std::clamp(range - hit->range, -limit, limit);
      row.along = row.normal / flat;
      row.place = surface_.at(met);
      block.deviation.push_back(row.e / row.sd_factor);
      ++block.hits;
      add_row(row, predicted, layout, noise, block);
      continue;
    }
    row.e = std::clamp(off.dot(row.normal) / flat, -limit, limit);
    row.along = row.normal / flat;
    ++block.beside;
    add_row(row, predicted, layout, noise, block);
    const Vector3d w = off - off.dot(d) * d;
    row.e = w.norm() - kSlack * spacing * range;
    if (!(row.e > 1e-9)) continue;
    row.along = w.normalized();
    row.sd_factor = std::hypot(1, noise.lateral / noise.sigma);
    add_row(row, predicted, layout, noise, block);
  }
  // Places that should be seen and were not.
  constexpr std::size_t kLeast = 20;
  if (index.size() < kLeast || !(spacing > 0)) return;
  const Vector3d tip = pivot_ + turned_ * (predicted.tip - pivot_) + registration.shift;
  const double allowed = (1 + kSlack) * spacing;
  struct Gap {
    int vertex;
    double distance;
    Vector2d towards;
  };
  std::vector<Gap> gaps;
  std::size_t looked_at = 0, nothing_near = 0;
  for (int v = 0; v < static_cast<int>(surface_.vertices().size()); ++v) {
    const Vector3d& p = surface_.vertices()[static_cast<std::size_t>(v)];
    if (shaft_distance(p, tip, seen.p_WC) < kShaftShadow || !surface_.sees(v)) continue;
    ++looked_at;
    const Vector2d place = *surface_.project(p);
    const auto near = index.nearest(place, index.size());
    if (!near || (index.at(*near) - place).norm() > kMostGap / depth) {
      ++nothing_near;
      continue;
    }
    const Vector2d w = index.at(*near) - place;
    if (w.norm() > allowed) gaps.push_back({v, w.norm() - allowed, w.normalized()});
  }
  // Where much is missing the cloud was cut, by whatever: its edge is not that of the tissue.
  if (static_cast<double>(nothing_near) > kCropped * static_cast<double>(looked_at)) return;
  for (const Gap& gap : gaps) {
    Row row;
    const Vector3d& p = surface_.vertices()[static_cast<std::size_t>(gap.vertex)];
    const double z = -(seen.R_WC.transpose() * (p - seen.p_WC)).z();
    row.e = gap.distance * z;
    row.along = seen.R_WC.col(0) * gap.towards.x() + seen.R_WC.col(1) * gap.towards.y();
    row.sd_factor = std::hypot(1, 0.5 * allowed * z / noise.sigma);
    // A triangle with that corner.
    const TrianglePoint at = surface_.nearest(p, noise.reach);
    if (at.triangle < 0) continue;
    row.triangle = at.triangle;
    row.share = at.share;
    row.normal = surface_.normal(at.triangle);
    row.place = p;
    ++block.gaps;
    add_row(row, predicted, layout, noise, block);
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
    if (!seen.frames[k].points.empty())
      add_frame(seen, seen.frames[k], frame, layout, registration, noise, block);
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
