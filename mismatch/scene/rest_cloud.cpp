#include "mismatch/scene/rest_cloud.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "mismatch/scene/believed_scene.h"

namespace omentum {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::size_t kFewest = 100;  // points of a cloud
constexpr double kOutside = 0.005;    // share of the points beyond each edge

struct Rectangle {
  double angle = 0;                                          ///< of its first axis from x_W [rad]
  Vector2d low = Vector2d::Zero(), high = Vector2d::Zero();  ///< along its axes
  double area() const { return (high - low).prod(); }
};

Rectangle around(const std::vector<Vector2d>& points, double angle) {
  const Eigen::Rotation2Dd turn(-angle);
  Rectangle r;
  r.angle = angle;
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double> along;
    for (const Vector2d& p : points) along.push_back((turn * p)[axis]);
    const auto rank = [&](double share) {
      const auto at = along.begin() +
                      static_cast<std::ptrdiff_t>(share * static_cast<double>(along.size() - 1));
      std::nth_element(along.begin(), at, along.end());
      return *at;
    };
    r.low[axis] = rank(kOutside);
    r.high[axis] = rank(1 - kOutside);
  }
  // What lies outside of a body that is seen evenly.
  const Vector2d beyond = kOutside / (1 - 2 * kOutside) * (r.high - r.low);
  r.low -= beyond;
  r.high += beyond;
  return r;
}

Rectangle smallest_around(const std::vector<Vector2d>& points) {
  Rectangle best = around(points, 0);
  double step = kPi / 180, centre = kPi / 4;
  double range = kPi / 4;
  for (int round = 0; round < 3; ++round) {
    for (double angle = centre - range; angle < centre + range; angle += step) {
      const Rectangle r = around(points, angle);
      if (r.area() < best.area() - 1e-12) best = r;
    }
    centre = best.angle;
    range = step;
    step /= 8;
  }
  return best;
}

void add_prior(pb::Priors& priors, const std::string& path, double sd) {
  pb::Prior& prior = *priors.add_prior();
  prior.set_path(path);
  prior.set_sd(sd);
  prior.set_source("cloud at rest");
}

}  // namespace

RestScene scene_of_cloud(const std::string& name, const Cloud& cloud,
                         const RestCloudSettings& settings) {
  if (cloud.size() < kFewest)
    throw_error("{}: {} points, needed {} or more", name, cloud.size(), kFewest);
  Eigen::AlignedBox3d box;
  std::vector<Vector2d> flat;
  for (const Eigen::Vector3f& p : cloud) {
    box.extend(p.cast<double>());
    flat.push_back(p.cast<double>().head<2>());
  }
  if (!(box.sizes().maxCoeff() >= 0.002 && box.sizes().maxCoeff() <= 1)) {
    throw_error("{}: the cloud is {:.4g} m across, allowed 0.002 ... 1 m: in metres?", name,
                box.sizes().maxCoeff());
  }
  RestScene made;
  const Rectangle outline = smallest_around(flat);
  const Vector2d size = outline.high - outline.low;
  const double spacing = std::sqrt(size.prod() / static_cast<double>(cloud.size()));
  // y_B points from the fixed edge: the axis of the rectangle that is nearest to that.
  const Eigen::Rotation2Dd turn(outline.angle);
  Vector2d y = Vector2d::UnitY();
  double best = -2;
  int along = 1;
  for (int axis = 0; axis < 2; ++axis) {
    for (const double sign : {1.0, -1.0}) {
      const Vector2d direction = sign * (turn * Vector2d::Unit(axis));
      const double agrees = -direction.dot(settings.fixed.normalized());
      if (agrees <= best) continue;
      best = agrees;
      y = direction;
      along = axis;
    }
  }
  if (!(best > 0.8)) {
    made.warnings.push_back(
        fmt::format("{}: no edge of the body lies across the direction of --fixed ({:.0f} deg off)",
                    name, std::acos(std::clamp(best, -1.0, 1.0)) / kDegree));
  }
  SheetPlace place;
  place.size_x = size[1 - along];
  place.size_y = size[along];
  place.clamp = settings.clamp;
  const Vector2d centre = turn * (0.5 * (outline.low + outline.high));
  // Heights over the sheet: constant, slopes, curvatures, twist.
  const Vector2d x(y.y(), -y.x());
  Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
  Eigen::Matrix<double, 6, 1> b = Eigen::Matrix<double, 6, 1>::Zero();
  const auto row = [&](const Vector2d& p) {
    const double u = x.dot(p - centre), v = y.dot(p - centre);
    Eigen::Matrix<double, 6, 1> r;
    r << 1, u, v, 0.5 * u * u, 0.5 * v * v, u * v;
    return r;
  };
  for (std::size_t k = 0; k < cloud.size(); ++k) {
    const auto r = row(flat[k]);
    A += r * r.transpose();
    b += r * (static_cast<double>(cloud[k].z()) - settings.board_z);
  }
  const Eigen::Matrix<double, 6, 1> shape = A.ldlt().solve(b);
  double squares = 0;
  for (std::size_t k = 0; k < cloud.size(); ++k) {
    const double e = static_cast<double>(cloud[k].z()) - settings.board_z - row(flat[k]).dot(shape);
    squares += e * e;
  }
  const double noise = std::sqrt(squares / static_cast<double>(cloud.size() - 6));
  const Eigen::Matrix<double, 6, 1> sd = noise * A.inverse().diagonal().cwiseMax(0).cwiseSqrt();
  const double height = shape[0];
  if (!(height > 0)) {
    throw_error("{}: the cloud lies {:.3g} m below the board at z = {} m: --board?", name, -height,
                settings.board_z);
  }
  place.thickness = settings.thickness > 0 ? settings.thickness : height;
  place.X_WB.linear().col(0) = Vector3d(x.x(), x.y(), 0);
  place.X_WB.linear().col(1) = Vector3d(y.x(), y.y(), 0);
  place.X_WB.linear().col(2) = Vector3d::UnitZ();
  place.X_WB.translation() =
      Vector3d(centre.x(), centre.y(), settings.board_z + 0.5 * place.thickness);
  pb::Scene& scene = made.scene;
  scene.set_format_version(1);
  scene.set_name(name);
  scene.set_source("mismatch scene");
  scene.mutable_tissue()->set_model(pb::TISSUE_ELASTIC);
  place_sheet(place, scene, made.warnings);
  pb::RigidBody& board = *scene.add_rigid_body();
  board.set_name("board");
  board.set_role(pb::ROLE_BOARD);
  board.set_half_space(true);
  board.mutable_pose()->mutable_translation_m()->set_z(settings.board_z);
  pb::Camera& camera = *scene.mutable_camera();
  camera.mutable_position_m()->set_x(centre.x());
  camera.mutable_position_m()->set_y(centre.y());
  camera.mutable_position_m()->set_z(settings.board_z + 0.3);
  camera.mutable_axis()->set_z(-1);
  camera.mutable_up()->set_y(1);
  camera.set_far_m(1);
  scene.mutable_tool()->set_contact(false);
  // A curvature that is seen: three times its uncertainty and a tenth of a millimetre over the
  // body.
  pb::RestShape& rest = *scene.mutable_tissue()->mutable_effects()->mutable_rest_shape();
  const double half = 0.5 * size.minCoeff();
  const auto curved = [&](int k) {
    return std::fabs(shape[k]) > 3 * sd[k] && std::fabs(shape[k]) * 0.5 * half * half > 1e-4;
  };
  if (curved(3)) rest.set_curvature_x_per_m(shape[3]);
  if (curved(4)) rest.set_curvature_y_per_m(shape[4]);
  if (curved(5)) rest.set_twist_per_m(shape[5]);
  const char* path = "scene.tissue.effects.rest_shape.";
  add_prior(made.priors, std::string(path) + "curvature_x_per_m", sd[3]);
  add_prior(made.priors, std::string(path) + "curvature_y_per_m", sd[4]);
  add_prior(made.priors, std::string(path) + "twist_per_m", sd[5]);
  // An edge is known to half the distance of the points.
  add_prior(made.priors, "scene.tissue.grid.pitch_m",
            spacing / std::sqrt(2.0) / (scene.tissue().grid().count_x() - 1));
  add_prior(made.priors, "scene.tissue.anchor_max_y_m", 0.5 * spacing);
  add_prior(made.priors, "scene.tissue.thickness_m",
            settings.thickness > 0 ? 0.05 * settings.thickness : std::max(sd[0], 0.02 * height));
  // Cells of the rectangle in which the body is seen.
  constexpr int kCells = 12;
  std::vector<std::uint8_t> seen(kCells * kCells, 0);
  for (const Vector2d& p : flat) {
    const Vector2d at = (turn.inverse() * p - outline.low).cwiseQuotient(size);
    if (!(at.minCoeff() >= 0 && at.maxCoeff() < 1)) continue;
    seen[static_cast<std::size_t>(at.x() * kCells) * kCells +
         static_cast<std::size_t>(at.y() * kCells)] = 1;
  }
  const auto filled =
      static_cast<double>(std::count(seen.begin(), seen.end(), 1)) / (kCells * kCells);
  if (filled < 0.9) {
    made.warnings.push_back(
        fmt::format("{}: the body fills {:.0f} % of its rectangle: another outline needs a mesh "
                    "(scene.tissue.sheet.mesh)",
                    name, 100 * filled));
  }
  if (settings.thickness > 0 && std::fabs(height - settings.thickness) > 0.2 * settings.thickness) {
    made.warnings.push_back(fmt::format(
        "{}: the cloud lies {:.2f} mm above the board, the body is stated to be {:.2f} mm thick",
        name, 1e3 * height, 1e3 * settings.thickness));
  }
  return made;
}

}  // namespace omentum
