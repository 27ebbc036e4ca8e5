#include "sim_worker/depth_sensor.h"

#include <cmath>
#include <numbers>

#include "core/rng.h"

namespace omentum {
namespace {

double unit(std::uint32_t word) { return (static_cast<double>(word) + 0.5) * 0x1p-32; }

}  // namespace

std::vector<Eigen::Vector3f> sense_cloud(Camera& camera, const CameraFrame& frame,
                                         const pb::DepthSensor& sensor, std::uint64_t seed,
                                         std::uint32_t frame_number) {
  const int width = static_cast<int>(sensor.width_px());
  const int height = static_cast<int>(sensor.height_px());
  const CameraPose& pose = camera.endoscope();
  const DepthImage image = camera.draw_depth(frame, pose, width, height);
  const double half = std::tan(pose.vertical_fov_rad / 2);  // of the image plane at unit depth
  std::vector<Eigen::Vector3f> points;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto pixel = static_cast<std::size_t>(x + width * y);
      if (image.ids.pixels[pixel] != static_cast<std::uint8_t>(ObjectId::kTissue)) continue;
      const PhiloxWords words = random_words(seed, 0, Purpose::kObservationNoise, 0, frame_number,
                                             static_cast<std::uint32_t>(pixel));
      if (unit(words[0]) < sensor.dropout()) continue;
      const Eigen::Vector3d ray((2 * (x + 0.5) / width - 1) * half * width / height,
                                (1 - 2 * (y + 0.5) / height) * half, -1);
      // Box and Muller: noise along the ray, in metres of range.
      const double normal = std::sqrt(-2 * std::log(unit(words[1]))) *
                            std::cos(2 * std::numbers::pi * unit(words[2]));
      double depth =
          static_cast<double>(image.depth_m[pixel]) + sensor.noise_m() * normal / ray.norm();
      if (sensor.depth_step_m() > 0)
        depth = sensor.depth_step_m() * std::round(depth / sensor.depth_step_m());
      points.push_back((pose.position + pose.R_WC * (depth * ray)).cast<float>());
    }
  }
  return points;
}

}  // namespace omentum
