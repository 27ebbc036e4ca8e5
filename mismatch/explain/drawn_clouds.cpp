#include "mismatch/explain/drawn_clouds.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "core/constants.h"
#include "core/rng.h"
#include "mismatch/seen/seen_surface.h"

namespace omentum {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

double unit(std::uint32_t word) { return (static_cast<double>(word) + 0.5) * 0x1p-32; }

/// A regular picture at unit depth: its first pixel and the distance of pixels.
struct Picture {
  Vector2d low, high;
  double pitch = 0;
};

/// One in which so many rays meet the upper face of the surface.
std::optional<Picture> picture_of(const SeenSurface& surface, std::size_t places,
                                  std::size_t points) {
  Eigen::AlignedBox2d box;
  double area = 0;
  for (const Eigen::Vector3i& t : surface.triangles()) {
    if (static_cast<std::size_t>(t.maxCoeff()) >= places) continue;  // the lower face, the rim
    std::array<Vector2d, 3> corner;
    for (int k = 0; k < 3; ++k) {
      const auto seen = surface.project(surface.vertices()[static_cast<std::size_t>(t[k])]);
      if (!seen) return std::nullopt;
      corner[static_cast<std::size_t>(k)] = *seen;
      box.extend(*seen);
    }
    const Vector2d a = corner[1] - corner[0], b = corner[2] - corner[0];
    area += 0.5 * std::fabs(a.x() * b.y() - a.y() * b.x());
  }
  constexpr double kFinest = 1.0 / 200;  // of the box: a sheet that is seen edge-on has no area
  const double pitch =
      std::max(std::sqrt(area / static_cast<double>(points)), kFinest * box.sizes().maxCoeff());
  const Vector2d beside = 0.5 * box.sizes();  // where a lift may lead it to
  return Picture{box.min() - beside, box.max() + beside, pitch};
}

}  // namespace

void draw_clouds(const DrawnClouds& drawn, std::size_t r, BaseFit& base) {
  const TissueBody& body = base.data.made.tissue;
  std::vector<Vector3d> rest;
  for (const double side : {0.5, -0.5}) {
    for (const Vector3d& p : body.particles)
      rest.push_back(body.X_WB * (p + side * body.thickness * Vector3d::UnitZ()));
  }
  constexpr double kFlattest = 0.15;  // cosine between ray and normal: flatter counts as this
  SeenSurface surface(base.data.likelihood.triangles(), rest);
  Observation& seen = base.data.observations[r];
  std::optional<Picture> picture;
  for (std::size_t f = 0; f < seen.frames.size(); ++f) {
    seen.frames[f].points.clear();
    const PredictedFrame& frame = base.surfaces[r].frames[f];
    if (!frame.valid) continue;
    surface.fit(frame.vertices, seen.p_WC, seen.R_WC);
    if (!picture) picture = picture_of(surface, body.particles.size(), drawn.points);
    if (!picture) return;  // behind the camera
    std::uint32_t pixel = 0;
    for (double y = picture->low.y(); y <= picture->high.y(); y += picture->pitch) {
      for (double x = picture->low.x(); x <= picture->high.x(); x += picture->pitch) {
        const Vector3d ray = seen.R_WC * Vector3d(x, y, -1).normalized();
        const std::uint32_t number = pixel++;
        const auto hit = surface.cast(seen.p_WC + ray);
        if (!hit) continue;
        const PhiloxWords words = random_words(drawn.seed, static_cast<std::uint32_t>(r),
                                               Purpose::kObservationNoise, 0, f, number);
        const double normal =
            std::sqrt(-2 * std::log(unit(words[0]))) * std::cos(2 * kPi * unit(words[1]));
        const double cosine = surface.normal(hit->triangle).dot(ray);
        const double range = hit->range + hit->bulge / std::min(cosine, -kFlattest);
        seen.frames[f].points.push_back(seen.p_WC + (range + drawn.noise_m * normal) * ray);
      }
    }
  }
}

}  // namespace omentum
