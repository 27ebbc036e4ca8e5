// Errors of a depth camera that are not noise (docs/mismatch.md 1 rows 26 and 28).
#include "sim_worker/camera/depth_sensor.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/paper_scene.h"
#include "tests/support/screen.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::scene_with_one_rectangle;
using test::screen;

struct Seen {
  explicit Seen(const pb::DepthSensor& sensor)
      : scene(scene_with_one_rectangle()),
        camera(scene, 64, 64),
        positions(screen(scene, -4.0, 4.0)),
        points(sense_cloud(camera, {positions, {}}, sensor, 7, 0)) {}
  Scene scene;
  Camera camera;
  std::vector<float> positions;
  std::vector<Eigen::Vector3f> points;
};

pb::DepthSensor plain() {
  pb::DepthSensor sensor;
  sensor.set_width_px(24);
  sensor.set_height_px(24);
  return sensor;
}

TEST(DepthSensor, BiasFollowsItsQuadratic) {
  const Seen truth(plain());
  pb::DepthSensor sensor = plain();
  sensor.set_bias_m(0.002);
  sensor.set_scale_change(0.01);
  sensor.set_bias_per_m(0.05);
  const Seen biased(sensor);
  ASSERT_EQ(biased.points.size(), truth.points.size());
  ASSERT_GT(truth.points.size(), 50U);
  const CameraPose& pose = truth.scene.camera;
  const auto depth = [&](const Eigen::Vector3f& p) {
    return -(pose.R_WC.transpose() * (p.cast<double>() - pose.position)).z();
  };
  for (std::size_t i = 0; i < truth.points.size(); ++i) {
    const double z = depth(truth.points[i]);
    EXPECT_NEAR(depth(biased.points[i]), z + 0.002 + 0.01 * z + 0.05 * z * z,
                1e-6);  // float points
  }
}

TEST(DepthSensor, RegistrationTurnsAboutTheCameraThenShifts) {
  const Seen truth(plain());
  pb::DepthSensor sensor = plain();
  sensor.mutable_registration_m()->set_x(0.003);
  sensor.mutable_registration_deg()->set_z(90);
  const Seen moved(sensor);
  ASSERT_EQ(moved.points.size(), truth.points.size());
  const Vector3d eye = truth.scene.camera.position;
  for (std::size_t i = 0; i < truth.points.size(); ++i) {
    const Vector3d d = truth.points[i].cast<double>() - eye;
    const Vector3d expected = eye + Vector3d(-d.y() + 0.003, d.x(), d.z());
    EXPECT_LT((moved.points[i].cast<double>() - expected).norm(), 1e-6);
  }
}

TEST(DepthSensor, ErrorsAtZeroChangeNoBit) {
  pb::DepthSensor zero = plain();
  zero.set_noise_m(0.001);
  pb::DepthSensor given = zero;
  given.set_bias_m(0);
  given.set_scale_change(0);
  given.mutable_registration_deg();
  given.mutable_registration_m();
  const Seen a(zero);
  const Seen b(given);
  ASSERT_EQ(a.points.size(), b.points.size());
  for (std::size_t i = 0; i < a.points.size(); ++i) EXPECT_EQ(a.points[i], b.points[i]);
}

}  // namespace
}  // namespace omentum
