#include "sim_worker/backend/image_source.h"

#include <memory>

#include "core/check.h"
#include "core/constants.h"
#include "core/picture_shape.h"
#include "sim_worker/camera/camera.h"

namespace omentum {

static_assert(static_cast<int>(ObjectId::kObstacle) == kObjectIds);

SimBackend::ImageSource make_image_source(const SimSetup& setup) {
  const pb::Task& task = setup.config.task();
  if (task.observation() != pb::OBSERVATION_IMAGE) return {};
  const int size = static_cast<int>(task.image_size());
  const bool shaded = task.image() == pb::IMAGE_SHADED;
  auto camera = std::make_shared<Camera>(setup.scene, size, size, 1);
  const Eigen::Vector3d shaft = setup.mount.jaw_direction();
  const double roll = setup.config.scene().tool().roll_deg() * kPi / 180;
  return [camera, shaded, size, shaft, roll](std::span<const float> vertices,
                                             const Eigen::Vector3d& tip, double jaw_deg,
                                             std::span<float> out) {
    CameraFrame frame;
    frame.tissue_vertices_W = vertices;
    frame.tool = ToolPose{tip, shaft, roll, jaw_deg * kPi / 180};
    const Image image = shaded ? camera->draw_shaded(frame)
                               : camera->draw_ids(frame, camera->endoscope(), size, size);
    OMENTUM_CHECK(image.pixels.size() == out.size(), "image of {} values for {}",
                  image.pixels.size(), out.size());
    const float scale = 1.0F / (shaded ? 255.0F : static_cast<float>(kObjectIds));
    for (std::size_t i = 0; i < out.size(); ++i)
      out[i] = scale * static_cast<float>(image.pixels[i]);
  };
}

}  // namespace omentum
