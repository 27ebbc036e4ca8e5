#pragma once

#include <cstdint>
#include <vector>

#include "sim_worker/scene/scene.h"

namespace omentum {

// Samples of the tumour as the camera sees it, and which of them triangles shadow: what the
// exposure is estimated from (docs/task.md 9).

/// A point of the tumour's surface as the camera sees it: on the tangent plane (u right, v up, at
/// unit depth), 1 / depth [1/m] and weight (solid angle: max(0, n . view) / distance^2).
struct ExposureSample {
  float u, v, inverse_depth, weight;
};

/// Points neither back-facing nor behind an organ: their weights sum to the denominator of the
/// exposure. Sorted into square bins of the window, so that a triangle looks only at those it may
/// cover.
struct ExposureSamples {
  std::vector<ExposureSample> sample;
  double total = 0;
  float u_min = 0, u_max = 0, v_min = 0, v_max = 0;
  int bins = 1;
  std::vector<std::int32_t> bin_begin;
  std::vector<float> u, v, inverse_depth;  ///< of the samples, and eight more that are read only

  int size() const { return static_cast<int>(sample.size()); }
};

constexpr float kNearestShadow = 1e-4F;  ///< [m] nothing nearer to the camera casts a shadow

/// A projected vertex: image coordinates and depth.
struct ImagePoint {
  float u, v, depth;
};

/// Samples of the surface, stratified by area, some 10,000 of which face the camera.
ExposureSamples sample_surface(const Scene& scene, const RigidShape& tumour);
/// `n` samples of equal weight, stratified over the image and by weight.
ExposureSamples choose_subset(const ExposureSamples& all, int n);
/// One sample for each of pixels x pixels that sees the tumour.
ExposureSamples sample_pixels(const Scene& scene, const RigidShape& tumour, int pixels);
/// Removes samples behind organs (they count in neither numerator nor denominator) and, for a
/// tumour that is not convex, behind the tumour itself.
void drop_hidden(ExposureSamples& samples, const Scene& scene);

/// Marks for shadow(), as many as it reads and writes.
std::vector<std::uint32_t> no_shadows(const ExposureSamples& samples);
/// Marks with ones the samples that a triangle shadows: inside it in the image and farther than its
/// plane there. Eight samples at a time, each by the same operations.
void shadow(const ExposureSamples& samples, ImagePoint a, ImagePoint b, ImagePoint c,
            std::vector<std::uint32_t>& shadowed);

}  // namespace omentum
