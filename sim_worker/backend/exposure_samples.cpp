#include "sim_worker/backend/exposure_samples.h"

#include <immintrin.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>

#include "core/rng.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kFullSamples = 40000;  // on the surface; a quarter to a half face the camera

ImagePoint project(const CameraPose& camera, const Vector3d& p) {
  const Vector3d c = camera.R_WC.transpose() * (p - camera.position);
  const double depth = -c.z();
  const double inverse = 1 / std::max(depth, static_cast<double>(kNearestShadow));
  return {static_cast<float>(c.x() * inverse), static_cast<float>(c.y() * inverse),
          static_cast<float>(depth)};
}

int bin_index(float x, float min, float max, int bins) {
  return std::clamp(static_cast<int>((x - min) / (max - min) * static_cast<float>(bins)), 0,
                    bins - 1);
}

/// Bins of four numbers at once.
struct alignas(16) Bins {
  std::int32_t u0, u1, v0, v1;
};
Bins bin_range(const ExposureSamples& s, float u_low, float u_high, float v_low, float v_high) {
  const __m128 x = _mm_setr_ps(u_low, u_high, v_low, v_high);
  const __m128 min = _mm_setr_ps(s.u_min, s.u_min, s.v_min, s.v_min);
  const __m128 max = _mm_setr_ps(s.u_max, s.u_max, s.v_max, s.v_max);
  const __m128 share = _mm_div_ps(_mm_sub_ps(x, min), _mm_sub_ps(max, min));
  const __m128i bin = _mm_cvttps_epi32(_mm_mul_ps(share, _mm_set1_ps(static_cast<float>(s.bins))));
  Bins bins;
  _mm_store_si128(
      reinterpret_cast<__m128i*>(&bins),
      _mm_min_epi32(_mm_max_epi32(bin, _mm_setzero_si128()), _mm_set1_epi32(s.bins - 1)));
  return bins;
}

/// Sorts samples into bins of about four and sets window and total.
void arrange(ExposureSamples& s) {
  s.bin_begin.clear();
  s.total = 0;
  for (std::vector<float>* numbers : {&s.u, &s.v, &s.inverse_depth})
    numbers->assign(s.sample.size() + 8, 0.0F);
  if (s.sample.empty()) return;
  const float margin = 1e-6F;
  const auto [left, right] = std::ranges::minmax(s.sample, {}, &ExposureSample::u);
  const auto [low, high] = std::ranges::minmax(s.sample, {}, &ExposureSample::v);
  s.u_min = left.u - margin;
  s.u_max = right.u + margin;
  s.v_min = low.v - margin;
  s.v_max = high.v + margin;
  s.bins = std::max(1, static_cast<int>(std::sqrt(s.size() / 4.0)));
  const auto bin = [&s](const ExposureSample& p) {
    return bin_index(p.v, s.v_min, s.v_max, s.bins) * s.bins +
           bin_index(p.u, s.u_min, s.u_max, s.bins);
  };
  std::ranges::stable_sort(s.sample, {}, bin);
  for (std::size_t i = 0; i < s.sample.size(); ++i) {
    s.u[i] = s.sample[i].u;
    s.v[i] = s.sample[i].v;
    s.inverse_depth[i] = s.sample[i].inverse_depth;
  }
  s.bin_begin.assign(s.bins * s.bins + 1, 0);
  for (const ExposureSample& p : s.sample) {
    ++s.bin_begin[bin(p) + 1];
    s.total += static_cast<double>(p.weight);
  }
  std::partial_sum(s.bin_begin.begin(), s.bin_begin.end(), s.bin_begin.begin());
}

/// A triangle of the tumour and its bounds in the image, a little wider than they are.
struct SeenTriangle {
  Vector3d a, e1, e2;  ///< a corner and the two edges from it, in W
  double u_min, u_max, v_min, v_max;
};

std::vector<SeenTriangle> seen_triangles(const Scene& scene, const RigidShape& tumour) {
  constexpr double kMargin = 1e-6;  // far above the rounding of first_hit()
  const double everywhere = std::numeric_limits<double>::infinity();
  std::vector<SeenTriangle> seen;
  for (const Eigen::Vector3i& t : tumour.surface.triangles) {
    const Vector3d a = tumour.X_WS * tumour.surface.vertices[t[0]];
    SeenTriangle triangle{a,
                          tumour.X_WS * tumour.surface.vertices[t[1]] - a,
                          tumour.X_WS * tumour.surface.vertices[t[2]] - a,
                          everywhere,
                          -everywhere,
                          everywhere,
                          -everywhere};
    for (const int corner : t) {
      const Vector3d c = scene.camera.R_WC.transpose() *
                         (tumour.X_WS * tumour.surface.vertices[corner] - scene.camera.position);
      if (!(-c.z() >
            static_cast<double>(kNearestShadow))) {  // beside or behind the camera: no bounds
        triangle.u_min = triangle.v_min = -everywhere;
        triangle.u_max = triangle.v_max = everywhere;
        break;
      }
      triangle.u_min = std::min(triangle.u_min, c.x() / -c.z() - kMargin);
      triangle.u_max = std::max(triangle.u_max, c.x() / -c.z() + kMargin);
      triangle.v_min = std::min(triangle.v_min, c.y() / -c.z() - kMargin);
      triangle.v_max = std::max(triangle.v_max, c.y() / -c.z() + kMargin);
    }
    seen.push_back(triangle);
  }
  return seen;
}

/// Nearest hit of the ray through (u, v) of the image, for the pixel count of the derived project.
double first_hit(std::span<const SeenTriangle> triangles, const Vector3d& origin,
                 const Vector3d& direction, double u, double v) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const SeenTriangle& t : triangles) {
    if (u < t.u_min || u > t.u_max || v < t.v_min || v > t.v_max) continue;
    const Vector3d p = direction.cross(t.e2);
    const double determinant = t.e1.dot(p);
    if (std::fabs(determinant) < 1e-18) continue;
    const Vector3d s = origin - t.a;
    const double b1 = s.dot(p) / determinant;
    const Vector3d q = s.cross(t.e1);
    const double b2 = direction.dot(q) / determinant;
    const double distance = t.e2.dot(q) / determinant;
    if (b1 >= 0 && b2 >= 0 && b1 + b2 <= 1 && distance > 0) nearest = std::min(nearest, distance);
  }
  return nearest;
}

}  // namespace

void shadow(const ExposureSamples& s, ImagePoint a, ImagePoint b, ImagePoint c,
            std::vector<std::uint32_t>& shadowed) {
  if (a.depth < kNearestShadow || b.depth < kNearestShadow || c.depth < kNearestShadow) return;
  const float u_low = std::min({a.u, b.u, c.u});
  const float u_high = std::max({a.u, b.u, c.u});
  const float v_low = std::min({a.v, b.v, c.v});
  const float v_high = std::max({a.v, b.v, c.v});
  if (!(u_low < s.u_max && s.u_min < u_high && v_low < s.v_max && s.v_min < v_high)) return;
  const float area = (b.u - a.u) * (c.v - a.v) - (c.u - a.u) * (b.v - a.v);
  if (!(std::fabs(area) > 0)) return;
  // 1 / depth is linear in the image.
  alignas(16) float inverse[4];
  _mm_store_ps(inverse,
               _mm_div_ps(_mm_set1_ps(1.0F), _mm_setr_ps(area, a.depth, b.depth, c.depth)));
  const __m256 inverse_area = _mm256_set1_ps(inverse[0]);
  const __m256 depth_a = _mm256_set1_ps(inverse[1]);
  const __m256 depth_b = _mm256_set1_ps(inverse[2]);
  const __m256 depth_c = _mm256_set1_ps(inverse[3]);
  const __m256 ab_u = _mm256_set1_ps(b.u - a.u);
  const __m256 ab_v = _mm256_set1_ps(b.v - a.v);
  const __m256 ac_u = _mm256_set1_ps(c.u - a.u);
  const __m256 ac_v = _mm256_set1_ps(c.v - a.v);
  const __m256 zero = _mm256_setzero_ps();
  const Bins bin = bin_range(s, u_low, u_high, v_low, v_high);
  const float* const sample_u = s.u.data();
  const float* const sample_v = s.v.data();
  const float* const sample_depth = s.inverse_depth.data();
  auto* const marks = reinterpret_cast<float*>(shadowed.data());
  for (int bv = bin.v0; bv <= bin.v1; ++bv) {
    const std::int32_t end = s.bin_begin[bv * s.bins + bin.u1 + 1];
    for (std::int32_t i = s.bin_begin[bv * s.bins + bin.u0]; i < end; i += 8) {
      const __m256 u = _mm256_sub_ps(_mm256_loadu_ps(sample_u + i), _mm256_set1_ps(a.u));
      const __m256 v = _mm256_sub_ps(_mm256_loadu_ps(sample_v + i), _mm256_set1_ps(a.v));
      const __m256 wb = _mm256_mul_ps(_mm256_sub_ps(_mm256_mul_ps(u, ac_v), _mm256_mul_ps(ac_u, v)),
                                      inverse_area);
      const __m256 wc = _mm256_mul_ps(_mm256_sub_ps(_mm256_mul_ps(ab_u, v), _mm256_mul_ps(u, ab_v)),
                                      inverse_area);
      const __m256 wa = _mm256_sub_ps(_mm256_sub_ps(_mm256_set1_ps(1.0F), wb), wc);
      const __m256 depth =
          _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(wa, depth_a), _mm256_mul_ps(wb, depth_b)),
                        _mm256_mul_ps(wc, depth_c));
      // 1e-4 of the depth: a surface does not shadow itself.
      const __m256 limit =
          _mm256_mul_ps(_mm256_loadu_ps(sample_depth + i), _mm256_set1_ps(1.0001F));
      const __m256 inside = _mm256_and_ps(
          _mm256_cmp_ps(wa, zero, _CMP_GE_OQ),
          _mm256_and_ps(_mm256_cmp_ps(wb, zero, _CMP_GE_OQ), _mm256_cmp_ps(wc, zero, _CMP_GE_OQ)));
      const __m256i of_bins =
          _mm256_cmpgt_epi32(_mm256_set1_epi32(end - i), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
      const __m256 hidden =
          _mm256_and_ps(_mm256_and_ps(inside, _mm256_cmp_ps(depth, limit, _CMP_GT_OQ)),
                        _mm256_castsi256_ps(of_bins));
      _mm256_storeu_ps(marks + i, _mm256_or_ps(_mm256_loadu_ps(marks + i), hidden));
    }
  }
}

std::vector<std::uint32_t> no_shadows(const ExposureSamples& s) {
  return std::vector<std::uint32_t>(s.sample.size() + 8, 0);
}

void drop_hidden(ExposureSamples& s, const Scene& scene) {
  std::vector<std::uint32_t> hidden = no_shadows(s);
  for (const RigidShape& body : scene.bodies) {
    if (body.role == pb::ROLE_BOARD || body.kind == RigidShape::Kind::kHalfSpace) continue;
    std::vector<ImagePoint> image;
    for (const Vector3d& p : body.surface.vertices) {
      image.push_back(project(scene.camera, body.X_WS * p));
      // Moved 1 mm away from the camera, a face does not shadow its own samples.
      if (body.role == pb::ROLE_TUMOUR) image.back().depth += 1e-3F;
    }
    for (const Eigen::Vector3i& t : body.surface.triangles)
      shadow(s, image[t[0]], image[t[1]], image[t[2]], hidden);
  }
  if (scene.soft_body) {
    const TissueBody& soft = scene.soft_body->body;
    std::vector<ImagePoint> image;
    for (const Vector3d& p : soft.particles) image.push_back(project(scene.camera, soft.X_WB * p));
    for (const Eigen::Vector3i& t : soft.surface_triangles) {
      shadow(s, image[t[0]], image[t[1]], image[t[2]], hidden);
    }
  }
  std::vector<ExposureSample> seen;
  for (std::size_t i = 0; i < s.sample.size(); ++i) {
    if (hidden[i] == 0) seen.push_back(s.sample[i]);
  }
  s.sample = std::move(seen);
  arrange(s);
}

ExposureSamples sample_surface(const Scene& scene, const RigidShape& tumour) {
  ExposureSamples s;
  const auto& mesh = tumour.surface;
  std::vector<double> cumulative;
  double total = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Vector3d& a = mesh.vertices[t[0]];
    total += 0.5 * (mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a).norm();
    cumulative.push_back(total);
  }
  for (std::uint32_t i = 0; i < kFullSamples; ++i) {
    // Stratified by area: one sample in each of kFullSamples equal pieces of the cumulative area.
    const PhiloxWords words = philox({i, 1, 0, 0}, {0, 0});
    const double where = (i + static_cast<double>(words[0]) * 0x1p-32) / kFullSamples * total;
    const auto k = static_cast<std::size_t>(std::min<std::ptrdiff_t>(
        std::upper_bound(cumulative.begin(), cumulative.end(), where) - cumulative.begin(),
        static_cast<std::ptrdiff_t>(cumulative.size()) - 1));
    const Eigen::Vector3i& t = mesh.triangles[k];
    const Vector3d a = tumour.X_WS * mesh.vertices[t[0]];
    const Vector3d b = tumour.X_WS * mesh.vertices[t[1]];
    const Vector3d c = tumour.X_WS * mesh.vertices[t[2]];
    double x = static_cast<double>(words[1]) * 0x1p-32;
    double y = static_cast<double>(words[2]) * 0x1p-32;
    if (x + y > 1) {
      x = 1 - x;
      y = 1 - y;
    }
    const Vector3d p = a + x * (b - a) + y * (c - a);
    const Vector3d view = scene.camera.position - p;
    const double facing = (b - a).cross(c - a).normalized().dot(view.normalized());
    if (!(facing > 0)) continue;
    const ImagePoint q = project(scene.camera, p);
    s.sample.push_back({q.u, q.v, 1.0F / q.depth, static_cast<float>(facing / view.squaredNorm())});
  }
  arrange(s);
  return s;
}

// Equal-weight subset: walk the samples along a Z curve of the image and take one in every total /
// n of weight, so that the subset is stratified both over the image and by weight.
ExposureSamples choose_subset(const ExposureSamples& all, int n) {
  constexpr int kCells = 1024;
  const auto spread = [](std::uint32_t x) {
    std::uint64_t r = x;
    r = (r | (r << 16)) & 0x0000FFFF0000FFFFULL;
    r = (r | (r << 8)) & 0x00FF00FF00FF00FFULL;
    r = (r | (r << 4)) & 0x0F0F0F0F0F0F0F0FULL;
    r = (r | (r << 2)) & 0x3333333333333333ULL;
    return (r | (r << 1)) & 0x5555555555555555ULL;
  };
  const auto code = [&](const ExposureSample& p) {
    const auto u = static_cast<std::uint32_t>(bin_index(p.u, all.u_min, all.u_max, kCells));
    const auto v = static_cast<std::uint32_t>(bin_index(p.v, all.v_min, all.v_max, kCells));
    return spread(u) | spread(v) << 1;
  };
  std::vector<ExposureSample> ordered = all.sample;
  std::ranges::stable_sort(ordered, {}, code);
  ExposureSamples subset;
  double walked = 0;
  for (ExposureSample& p : ordered) {
    walked += static_cast<double>(p.weight);
    const int taken = subset.size();
    if (taken >= n || walked < (taken + 0.5) / n * all.total) continue;
    p.weight = 1.0F;
    subset.sample.push_back(p);
  }
  arrange(subset);
  return subset;
}

ExposureSamples sample_pixels(const Scene& scene, const RigidShape& tumour, int pixels) {
  ExposureSamples s;
  const std::vector<SeenTriangle> triangles = seen_triangles(scene, tumour);
  const double half = trig::tan(0.5 * scene.camera.vertical_fov_rad);
  for (int row = 0; row < pixels; ++row) {
    for (int column = 0; column < pixels; ++column) {
      const double u = half * (2 * (column + 0.5) / pixels - 1);
      const double v = half * (2 * (row + 0.5) / pixels - 1);
      const Vector3d direction = scene.camera.R_WC * Vector3d(u, v, -1);
      const double depth = first_hit(triangles, scene.camera.position, direction, u, v);
      if (!std::isfinite(depth)) continue;
      s.sample.push_back(
          {static_cast<float>(u), static_cast<float>(v), static_cast<float>(1 / depth), 1.0F});
    }
  }
  arrange(s);
  return s;
}

}  // namespace omentum
