#include "sim_worker/camera/camera.h"

#include <gtest/gtest.h>

#include <set>
#include <thread>

#include "tests/support/image_exposure.h"
#include "tests/support/paper_scene.h"
#include "tests/support/screen.h"

namespace omentum {
namespace {

using test::exposure_from_image;
using test::exposure_seed_64px;
using test::make_paper_scene;
using test::scene_with_one_rectangle;
using test::screen;

TEST(Exposure, UnoccludedTumourOfThePaperScene) {
  const Scene scene = make_paper_scene();
  Camera camera(scene, 320, 240);
  const test::ImageExposure zoom = exposure_from_image(camera, scene, {});
  // Disc of radius 160 tan(asin(13.7 / 252.7)) / tan(3.88 deg) = 128.1 px; 0.5 % for edges and
  // tessellation.
  EXPECT_NEAR(zoom.unoccluded, 51'400, 257);
  EXPECT_EQ(zoom.visible, zoom.unoccluded);
  EXPECT_EQ(zoom.fraction(), 1);
  const test::ImageExposure seed = exposure_seed_64px(camera, {});
  EXPECT_NEAR(seed.unoccluded, 28, 3);
  EXPECT_EQ(seed.fraction(), 1);
}

TEST(Exposure, HalfCovered) {
  const Scene scene = scene_with_one_rectangle();
  Camera camera(scene, 64, 64);
  for (const auto& [low, high] : {std::pair{-4.0, 0.0}, {0.0, 4.0}}) {
    const std::vector<float> positions = screen(scene, low, high);
    const test::ImageExposure exposure = exposure_from_image(camera, scene, {positions, {}});
    EXPECT_NEAR(exposure.fraction(), 0.5, 0.01);  // required: within 1 %
  }
  // A chord at half the radius leaves 1 - (1/3 - sqrt(3) / (4 pi)) = 0.8045 of the disc.
  const std::vector<float> positions = screen(scene, 0.5, 4);
  EXPECT_NEAR(exposure_from_image(camera, scene, {positions, {}}).fraction(), 0.8045, 0.005);
}

TEST(Exposure, FullAndNone) {
  const Scene scene = scene_with_one_rectangle();
  Camera camera(scene, 64, 64);
  const std::vector<float> beside = screen(scene, 1.1, 4);
  EXPECT_EQ(exposure_from_image(camera, scene, {beside, {}}).fraction(), 1);
  const std::vector<float> before = screen(scene, -4, 4);
  EXPECT_EQ(exposure_from_image(camera, scene, {before, {}}).fraction(), 0);
  EXPECT_EQ(exposure_seed_64px(camera, {before, {}}).fraction(), 0);
}

TEST(Exposure, FlatSheetHidesTheTumour) {
  const Scene scene = make_paper_scene();
  Camera camera(scene, 64, 64);
  EXPECT_LT(exposure_from_image(camera, scene, {test::rest_positions(scene), {}}).fraction(), 0.01);
}

TEST(Exposure, ToolIsCountedApart) {
  const Scene scene = make_paper_scene();
  Camera camera(scene, 64, 64);
  ToolPose tool;
  const Eigen::Vector3d& centre = scene.bodies[0].X_WS.translation();
  tool.p_WT = centre + 0.1 * (scene.camera.position - centre) - Eigen::Vector3d(0, 0, 0.02);
  const test::ImageExposure exposure = exposure_from_image(camera, scene, {{}, tool});
  EXPECT_GT(exposure.hidden_by_tool, 1000);
  EXPECT_EQ(exposure.visible + exposure.hidden_by_tool, exposure.unoccluded);
}

TEST(Camera, PicturesOfDifferentViewsInTurnAreThoseOfCamerasOfTheirOwn) {
  const Scene scene = make_paper_scene();
  const std::vector<float> lifted = test::lifted_positions(scene, 0.02, 0.03, scene.target, 0.8);
  CameraPose near = scene.camera;
  near.position = 0.7 * near.position + 0.3 * scene.target;
  const auto draw = [&](Camera& camera, int view) {
    CameraFrame frame{lifted, ToolPose{}};
    frame.tool->p_WT = scene.target + Eigen::Vector3d(0.004 * view, 0, 0);
    frame.tool->jaw_rad = 0.1 * (view % 2);
    switch (view % 4) {
      case 0:
        return camera.draw_ids(frame);
      case 1:
        return camera.draw_shaded(frame);
      case 2:
        return camera.draw_ids(frame, near, 64, 64);
      default:
        return camera.draw_ids(frame, near, 16, 16);
    }
  };
  Camera camera(scene, 64, 64);
  for (const int view : {0, 1, 0, 2, 3, 2, 1, 4, 5}) {
    Camera own(scene, 64, 64);
    EXPECT_EQ(draw(camera, view).pixels, draw(own, view).pixels) << "view " << view;
  }
}

TEST(Exposure, IsAPureFunctionOfTheFrame) {
  const Scene scene = make_paper_scene();
  Camera camera(scene, 64, 64);
  const std::vector<float> lifted = test::lifted_positions(scene, 0.02, 0.03, scene.target, 0.8);
  const int first = exposure_from_image(camera, scene, {lifted, {}}).visible;
  (void)camera.draw_shaded({});
  EXPECT_EQ(exposure_from_image(camera, scene, {lifted, {}}).visible, first);
  Camera other(scene, 32, 32);
  EXPECT_EQ(exposure_from_image(other, scene, {lifted, {}}).visible, first);
  EXPECT_GT(first, 5'000);
  EXPECT_LT(first, 51'000);
}

TEST(Camera, ObjectIdsTakeLegalValuesOnly) {
  const Scene scene = make_paper_scene();
  Camera camera(scene, 160, 120);
  ToolPose tool;
  tool.p_WT = scene.tool_start;
  const std::vector<float> lifted = test::lifted_positions(scene, 0.02, 0.03, scene.target, 0.8);
  const Image ids = camera.draw_ids({lifted, tool});
  ASSERT_EQ(ids.pixels.size(), 160U * 120U);
  std::set<int> seen(ids.pixels.begin(), ids.pixels.end());
  EXPECT_EQ(seen, (std::set<int>{0, 1, 2, 3, 4, 5}));
}

TEST(Camera, UpIsUpAndRightIsRight) {
  const Scene scene = make_paper_scene();
  Camera camera(scene, 100, 100);
  // The kidney is beyond the tumour as seen from the camera, so it stands above it in the image.
  // +x_W is to the left: the camera looks along -y with z up.
  const Image ids = camera.draw_ids({});
  double tumour_row = 0, tumour_column = 0, organ_row = 0;
  int tumour = 0, organ = 0;
  for (int y = 0; y < 100; ++y) {
    for (int x = 0; x < 100; ++x) {
      const int id = ids.pixels[ids.offset(x, y)];
      if (id == static_cast<int>(ObjectId::kTumour)) ++tumour, tumour_row += y, tumour_column += x;
      if (id == static_cast<int>(ObjectId::kOrgan)) ++organ, organ_row += y;
    }
  }
  ASSERT_GT(tumour, 0);
  ASSERT_GT(organ, 0);
  EXPECT_LT(organ_row / organ, tumour_row / tumour - 5);
  EXPECT_NEAR(tumour_column / tumour, 49.5, 1.5);  // 0.2 deg off the axis is 0.3 px
  ToolPose tool;
  tool.p_WT = Eigen::Vector3d(0.05, 0.05, 0.05);
  const Image with_tool = camera.draw_ids({{}, tool});
  int left = 0, right = 0;
  for (int y = 0; y < 100; ++y) {
    for (int x = 0; x < 100; ++x) {
      if (with_tool.pixels[with_tool.offset(x, y)] == static_cast<int>(ObjectId::kTool))
        ++(x < 50 ? left : right);
    }
  }
  EXPECT_GT(left, 20);
  EXPECT_EQ(right, 0);
}

TEST(Camera, ShadedPictureShowsTheTissueColours) {
  const Scene scene = make_paper_scene();
  Camera camera(scene, 96, 72, 2);
  const Image picture = camera.draw_shaded({test::rest_positions(scene), {}});
  ASSERT_EQ(picture.pixels.size(), 96U * 72U * 3U);
  const std::size_t middle = picture.offset(55, 36);
  EXPECT_GT(picture.pixels[middle], picture.pixels[middle + 2] + 40)
      << "fat is yellow: red above blue";
  const std::string png = encode_png(picture);
  EXPECT_EQ(png.substr(1, 3), "PNG");
}

TEST(Camera, DifferentCamerasMayRunInDifferentThreads) {
  const Scene scene = make_paper_scene();
  std::vector<int> counts(4, -1);
  {
    std::vector<std::jthread> threads;
    for (std::size_t k = 0; k < counts.size(); ++k) {
      threads.emplace_back([&scene, &counts, k] {
        Camera camera(scene, 32, 32);
        counts[k] = exposure_from_image(camera, scene, {}).visible;
      });
    }
  }
  for (const int count : counts) EXPECT_EQ(count, counts[0]);
}

}  // namespace
}  // namespace omentum
