#include "sim_worker/backend/exposure.h"

#include <immintrin.h>

#include <algorithm>
#include <cmath>

namespace omentum {
namespace {

/// Lanes in which a number is below or above a limit.
std::uint64_t lanes_below(const float* number, float limit, int lanes) {
  if (lanes == 1) return number[0] < limit ? 1 : 0;
  std::uint64_t below = 0;
  for (int lane = 0; lane < lanes; lane += 8) {
    const __m256 is =
        _mm256_cmp_ps(_mm256_loadu_ps(number + lane), _mm256_set1_ps(limit), _CMP_LT_OQ);
    below |= static_cast<std::uint64_t>(_mm256_movemask_ps(is)) << lane;
  }
  return below;
}
std::uint64_t lanes_above(const float* number, float limit, int lanes) {
  if (lanes == 1) return number[0] > limit ? 1 : 0;
  std::uint64_t above = 0;
  for (int lane = 0; lane < lanes; lane += 8) {
    const __m256 is =
        _mm256_cmp_ps(_mm256_loadu_ps(number + lane), _mm256_set1_ps(limit), _CMP_GT_OQ);
    above |= static_cast<std::uint64_t>(_mm256_movemask_ps(is)) << lane;
  }
  return above;
}

double visible_fraction(const ExposureSamples& s, const std::vector<std::uint32_t>& shadowed) {
  if (!(s.total > 0)) return 0;
  double visible = 0;
  for (std::size_t i = 0; i < s.sample.size(); ++i)
    visible += shadowed[i] != 0 ? 0.0 : static_cast<double>(s.sample[i].weight);
  return visible / s.total;
}

}  // namespace

ExposureEstimator::ExposureEstimator(const Scene& scene, int reward_samples)
    : camera_(scene.camera) {
  for (const Eigen::Vector3i& t : scene.tissue.surface_triangles) {
    for (int k = 0; k < 3; ++k) triangles_.push_back(t[k]);
  }
  if (scene.soft_body) {
    const auto first = static_cast<std::int32_t>(scene.tissue.particles.size());
    for (const Eigen::Vector3i& t : scene.soft_body->body.surface_triangles) {
      for (int k = 0; k < 3; ++k) triangles_.push_back(first + t[k]);
    }
  }
  if (scene.tumour < 0) return;
  const RigidShape& tumour = scene.bodies[scene.tumour];
  full_ = sample_surface(scene, tumour);
  drop_hidden(full_, scene);
  subset_ = choose_subset(full_, reward_samples);
  pixels_ = sample_pixels(scene, tumour, 64);
  drop_hidden(pixels_, scene);
  shadowed_ = no_shadows(subset_);
}

double ExposureEstimator::estimate(const ExposureSamples& samples,
                                   std::span<const float> positions) const {
  // The same float operations as the lane kernel, so that subset() equals of_lanes() bit for bit.
  const auto image_of = [&](std::size_t vertex) -> ImagePoint {
    const float* p = &positions[3 * vertex];
    float r[9];
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) r[3 * i + j] = static_cast<float>(camera_.R_WC(j, i));
    }
    const float dx = p[0] - static_cast<float>(camera_.position.x());
    const float dy = p[1] - static_cast<float>(camera_.position.y());
    const float dz = p[2] - static_cast<float>(camera_.position.z());
    const float depth = std::fma(-r[8], dz, std::fma(-r[7], dy, -r[6] * dx));
    const float inverse = 1.0F / (depth > kNearestShadow ? depth : kNearestShadow);
    const float u = std::fma(r[2], dz, std::fma(r[1], dy, r[0] * dx));
    const float v = std::fma(r[5], dz, std::fma(r[4], dy, r[3] * dx));
    return {u * inverse, v * inverse, depth};
  };
  std::vector<ImagePoint> image;
  for (std::size_t vertex = 0; vertex < positions.size() / 3; ++vertex)
    image.push_back(image_of(vertex));
  std::vector<std::uint32_t> shadowed = no_shadows(samples);
  if (samples.size() == 0) return 0;
  for (std::size_t t = 0; t + 2 < triangles_.size(); t += 3) {
    shadow(samples, image[triangles_[t]], image[triangles_[t + 1]], image[triangles_[t + 2]],
           shadowed);
  }
  return visible_fraction(samples, shadowed);
}

double ExposureEstimator::full(std::span<const float> positions) const {
  return estimate(full_, positions);
}
double ExposureEstimator::subset(std::span<const float> positions) const {
  return estimate(subset_, positions);
}
double ExposureEstimator::seed_64px(std::span<const float> positions) const {
  return estimate(pixels_, positions);
}

// A triangle whose vertices lie beyond the same side of the window misses it.
void ExposureEstimator::find_hits(int vertices, int lanes, std::uint32_t wanted) {
  outside_.resize(vertices);
  for (int i = 0; i < vertices; ++i) {
    const float* const u = &projected_[3 * lanes * i];
    const float* const v = u + lanes;
    outside_[i] =
        lanes_below(u, subset_.u_min, lanes) | lanes_above(u, subset_.u_max, lanes) << 16 |
        lanes_below(v, subset_.v_min, lanes) << 32 | lanes_above(v, subset_.v_max, lanes) << 48;
  }
  hit_.clear();
  hit_lanes_.clear();
  for (std::size_t t = 0; t < triangles_.size(); t += 3) {
    std::uint64_t beyond =
        outside_[triangles_[t]] & outside_[triangles_[t + 1]] & outside_[triangles_[t + 2]];
    beyond |= beyond >> 32;
    beyond |= beyond >> 16;
    const std::uint32_t meets = wanted & ~static_cast<std::uint32_t>(beyond) & 0xFFFFU;
    if (meets == 0) continue;
    hit_.push_back(static_cast<std::int32_t>(t));
    hit_lanes_.push_back(meets);
  }
}

void ExposureEstimator::of_lanes(Tissue<float>& tissue, std::uint32_t wanted,
                                 std::span<float> exposure) {
  if (wanted == 0) return;
  const int W = tissue.lanes();
  if (subset_.size() == 0) {
    for (int lane = 0; lane < W; ++lane) {
      if ((wanted >> lane & 1U) != 0) exposure[lane] = 0;
    }
    return;
  }
  const int vertices = tissue.surface_vertices();
  projected_.resize(3 * vertices * W);
  ProjectArgs<float> args{};
  args.vertices = vertices;
  args.position = tissue.surface_positions();
  for (int i = 0; i < 3; ++i) {
    args.origin[i] = static_cast<float>(camera_.position[i]);
    for (int j = 0; j < 3; ++j) args.rotation[3 * i + j] = static_cast<float>(camera_.R_WC(j, i));
  }
  args.projected = projected_.data();
  tissue.kernel().project_surface(args);
  find_hits(vertices, W, wanted);
  for (int lane = 0; lane < W; ++lane) {
    if ((wanted >> lane & 1U) == 0) continue;
    std::fill(shadowed_.begin(), shadowed_.end(), 0U);
    const auto image = [&](std::int32_t corner) -> ImagePoint {
      const float* p = &projected_[3 * W * triangles_[corner] + lane];
      return {p[0], p[W], p[2 * W]};
    };
    for (std::size_t k = 0; k < hit_.size(); ++k) {
      if ((hit_lanes_[k] >> lane & 1U) == 0) continue;
      const std::int32_t first = hit_[k];
      shadow(subset_, image(first), image(first + 1), image(first + 2), shadowed_);
    }
    // Every sample of the subset weighs 1.
    const auto seen = std::count(shadowed_.begin(), shadowed_.begin() + subset_.size(), 0U);
    exposure[lane] = static_cast<float>(static_cast<double>(seen) / subset_.total);
  }
}

}  // namespace omentum
