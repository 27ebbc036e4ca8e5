#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sim_worker/backend/exposure_samples.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Exposure of the tumour: visible weight / weight visible without the sheet (docs/task.md 9). A
/// soft body that moves before the tumour shadows it; what it hides at rest counts in neither
/// number. The tool does not shadow. No rendering. Rays from the camera are tested against the
/// sheet's triangles.
class ExposureEstimator {
 public:
  /// `reward_samples` is the size of the fixed stratified subset. Without a tumour every exposure
  /// is 0.
  ExposureEstimator(const Scene& scene, int reward_samples);

  /// Full estimate (>= 10,000 samples in view) for vertex positions x y z interleaved in W [m].
  double full(std::span<const float> surface_positions) const;
  /// The subset's estimate for the same input; same bits as `of_lanes`.
  double subset(std::span<const float> surface_positions) const;
  /// Subset estimate of the lanes in `wanted`, straight from the lane arrays; other entries are
  /// left alone.
  void of_lanes(Tissue<float>& tissue, std::uint32_t wanted, std::span<float> exposure);
  /// The count of the derived project: fraction of the 64 x 64 pixels at 60 deg that see the
  /// tumour.
  double seed_64px(std::span<const float> surface_positions) const;

  const ExposureSamples& full_samples() const { return full_; }
  const ExposureSamples& subset_samples() const { return subset_; }

 private:
  double estimate(const ExposureSamples& samples, std::span<const float> surface_positions) const;
  /// Of the vertices as projected: triangles that may meet the window, and in which lanes.
  void find_hits(int vertices, int lanes, std::uint32_t wanted);

  CameraPose camera_;
  std::vector<std::int32_t> triangles_;  ///< of the sheet
  ExposureSamples full_, subset_, pixels_;
  // Scratch of of_lanes.
  std::vector<float> projected_;
  std::vector<std::uint64_t> outside_;  ///< per vertex: lanes beyond each side of the window
  std::vector<std::int32_t> hit_;       ///< triangles that may meet the window
  std::vector<std::uint32_t> hit_lanes_, shadowed_;
};

}  // namespace omentum
