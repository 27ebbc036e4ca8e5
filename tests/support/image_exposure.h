#pragma once

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "sim_worker/camera/camera.h"

namespace omentum::test {

/// Exposure of the tumour by counting pixels of id images (docs/task.md 9): what the estimate of
/// backend/exposure.h is compared with.
struct ImageExposure {
  int unoccluded = 0;      ///< tumour pixels without sheet and tool; organs and obstacles stay
  int visible = 0;         ///< tumour pixels with everything
  int hidden_by_tool = 0;  ///< tumour pixels that only the tool covers
  /// Fraction of the tumour that can be seen, 0 if it is out of view.
  double fraction() const { return unoccluded > 0 ? double(visible) / unoccluded : 0; }
};

inline ImageExposure count_exposure(Camera& camera, const CameraPose& view, int pixels,
                                    const CameraFrame& frame) {
  const auto count = [&](const CameraFrame& shown) {
    const Image ids = camera.draw_ids(shown, view, pixels, pixels);
    const auto tumour = static_cast<std::uint8_t>(ObjectId::kTumour);
    return static_cast<int>(std::count(ids.pixels.begin(), ids.pixels.end(), tumour));
  };
  CameraFrame without_tool = frame;
  without_tool.tool.reset();
  ImageExposure exposure;
  exposure.unoccluded = count(CameraFrame{});
  exposure.visible = count(frame);
  exposure.hidden_by_tool = frame.tool ? count(without_tool) - exposure.visible : 0;
  return exposure;
}

/// In the zoom view: from the endoscope's position aimed at the tumour's centre.
inline ImageExposure exposure_from_image(Camera& camera, const Scene& scene,
                                         const CameraFrame& frame) {
  CameraPose view = scene.camera;
  const Eigen::Vector3d& tumour = scene.bodies[scene.tumour].X_WS.translation();
  view.R_WC = look_at(view.position, tumour, scene.camera.R_WC.col(1), 1).R_WC;
  view.vertical_fov_rad = scene.exposure_fov_rad;
  return count_exposure(camera, view, scene.exposure_pixels, frame);
}

/// As the seed counts it: 60 deg, 64 x 64 pixels (the whole tumour is about 28 pixels).
inline ImageExposure exposure_seed_64px(Camera& camera, const CameraFrame& frame) {
  CameraPose view = camera.endoscope();
  view.vertical_fov_rad = kPi / 3;
  return count_exposure(camera, view, 64, frame);
}

}  // namespace omentum::test
