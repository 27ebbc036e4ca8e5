#include "sim_worker/camera/depth_sensor.h"

#include <Eigen/Geometry>
#include <cmath>

#include "core/constants.h"
#include "core/rng.h"

namespace omentum {
namespace {

double unit(std::uint32_t word) { return (static_cast<double>(word) + 0.5) * 0x1p-32; }

/// Pose of the measured points in W: a rotation about the camera, then a shift.
Eigen::Isometry3d registration_of(const pb::DepthSensor& sensor, const Eigen::Vector3d& p_WC) {
  const pb::Vec3& angle = sensor.registration_deg();
  const pb::Vec3& shift = sensor.registration_m();
  const Eigen::AngleAxisd x(angle.x() * kDegree, Eigen::Vector3d::UnitX());
  const Eigen::AngleAxisd y(angle.y() * kDegree, Eigen::Vector3d::UnitY());
  const Eigen::AngleAxisd z(angle.z() * kDegree, Eigen::Vector3d::UnitZ());
  const Eigen::Matrix3d R = (z * y * x).toRotationMatrix();
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() = R;
  X.translation() = p_WC - R * p_WC + Eigen::Vector3d(shift.x(), shift.y(), shift.z());
  return X;
}

}  // namespace

std::vector<Eigen::Vector3f> sense_cloud(Camera& camera, const CameraFrame& frame,
                                         const pb::DepthSensor& sensor, std::uint64_t seed,
                                         std::uint32_t frame_number) {
  const int width = static_cast<int>(sensor.width_px());
  const int height = static_cast<int>(sensor.height_px());
  const CameraPose& pose = camera.endoscope();
  const DepthImage image = camera.draw_depth(frame, pose, width, height);
  const auto is_zero = [](const pb::Vec3& v) { return v.x() == 0 && v.y() == 0 && v.z() == 0; };
  const bool registered = !is_zero(sensor.registration_m()) || !is_zero(sensor.registration_deg());
  const Eigen::Isometry3d X = registration_of(sensor, pose.position);
  const double half = std::tan(pose.vertical_fov_rad / 2);  // of the image plane at unit depth
  std::vector<Eigen::Vector3f> points;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const std::uint32_t pixel = x + width * y;
      if (image.ids.pixels[pixel] != static_cast<std::uint8_t>(ObjectId::kTissue)) continue;
      const PhiloxWords words =
          random_words(seed, 0, Purpose::kObservationNoise, 0, frame_number, pixel);
      if (unit(words[0]) < sensor.dropout()) continue;
      const Eigen::Vector3d ray((2 * (x + 0.5) / width - 1) * half * width / height,
                                (1 - 2 * (y + 0.5) / height) * half, -1);
      // Box and Muller: noise along the ray, in metres of range.
      const double normal =
          std::sqrt(-2 * std::log(unit(words[1]))) * std::cos(2 * kPi * unit(words[2]));
      const auto seen = static_cast<double>(image.depth_m[pixel]);
      const double beyond = seen - sensor.bias_range_m();
      const double bias =
          sensor.bias_m() + seen * sensor.scale_change() + beyond * (beyond * sensor.bias_per_m());
      double depth = seen + bias + sensor.noise_m() * normal / ray.norm();
      if (sensor.depth_step_m() > 0)
        depth = sensor.depth_step_m() * std::round(depth / sensor.depth_step_m());
      Eigen::Vector3d p_W = pose.position + pose.R_WC * (depth * ray);
      if (registered) p_W = X * p_W;
      points.push_back(p_W.cast<float>());
    }
  }
  return points;
}

}  // namespace omentum
