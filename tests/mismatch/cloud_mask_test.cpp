// What is no tissue is taken out of clouds by what is believed of the set-up.
#include "mismatch/seen/cloud_mask.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/config.h"
#include "mismatch/scene/believed_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using testing::HasSubstr;

constexpr double kThickness = 0.006, kNoise = 5e-4;  // [m]

/// A sheet of 80 x 60 mm around the origin, on a board at z = 0.
Scene sheet() {
  SheetPlace place;
  place.size_x = 0.08;
  place.size_y = 0.06;
  place.thickness = kThickness;
  place.X_WB.translation().z() = 0.5 * kThickness;
  pb::Scene scene;
  std::vector<std::string> warnings;
  place_sheet(place, scene, warnings);
  pb::RigidBody& board = *scene.add_rigid_body();
  board.set_role(pb::ROLE_BOARD);
  board.set_half_space(true);
  scene.mutable_tool()->set_contact(false);
  scene.mutable_depth_sensor()->set_noise_m(kNoise);
  return make_scene(override_scene(scene, {}), "");
}

TEST(CloudMask, KnowsToolBoardAndBackgroundFromTissue) {
  const CloudMask mask(sheet(), 0.04, 0);
  const Vector3d tip(0.01, 0, 0.03);
  const auto part = [&](double x, double y, double z) { return mask.part_of({x, y, z}, tip); };
  EXPECT_EQ(part(0, 0, kThickness), CloudPart::kTissue);
  EXPECT_EQ(part(0.01, 0, 0.03), CloudPart::kTissue) << "what the jaws hold";
  EXPECT_EQ(part(0.012, 0, 0.0315), CloudPart::kTissue) << "its upper face";
  EXPECT_EQ(part(0.0105, 0.001, 0.036), CloudPart::kTool) << "the jaws";
  EXPECT_EQ(part(0.0145, 0, 0.05), CloudPart::kTool) << "the shaft";
  EXPECT_EQ(part(0.018, 0, 0.05), CloudPart::kTissue) << "beside the shaft";
  EXPECT_EQ(part(0.05, 0, 0.001), CloudPart::kBoard) << "beside the sheet";
  EXPECT_EQ(part(0.05, 0, 0.005), CloudPart::kTissue) << "moved sideways";
  EXPECT_EQ(part(0, 0, 0.001), CloudPart::kBoard) << "where the sheet was";
  EXPECT_EQ(part(0, 0, kThickness - 2.9 * kNoise), CloudPart::kTissue) << "noise";
  EXPECT_EQ(CloudMask(sheet(), 0.04, 0.002).part_of({0, 0, 0.001}, tip), CloudPart::kTissue)
      << "a camera that may stand 2 mm off";
  EXPECT_EQ(part(0.2, 0, 0.01), CloudPart::kBackground);
  EXPECT_EQ(part(0, 0, -0.2), CloudPart::kBackground);
}

TEST(CloudMask, TheShaftLeansAsTheSceneSays) {
  Scene scene = sheet();
  scene.config.mutable_tool()->mutable_shaft_direction()->set_x(1);
  scene.config.mutable_tool()->mutable_shaft_direction()->set_z(-1);
  const CloudMask mask(scene, 0.04, 0);
  const Vector3d tip(0, 0, 0.02), behind = tip + 0.03 * Vector3d(-1, 0, 1).normalized();
  EXPECT_EQ(mask.part_of(behind, tip), CloudPart::kTool);
  EXPECT_EQ(mask.part_of(tip + Vector3d(0, 0, 0.03), tip), CloudPart::kTissue);
}

TEST(CloudMask, TheShareSeenIsThatOfTheArea) {
  const CloudMask mask(sheet(), 0.04, 0);
  std::vector<Vector3d> whole, left;
  for (double x = -0.0399; x < 0.04; x += 0.001) {
    for (double y = -0.0299; y < 0.03; y += 0.001) {
      whole.emplace_back(x, y, kThickness);
      if (x < 0) left.emplace_back(x, y, kThickness);
    }
  }
  EXPECT_EQ(mask.share_seen(whole), 1);
  EXPECT_EQ(mask.share_seen(left), 0.5);
  EXPECT_EQ(mask.share_seen({}), 0);
}

TEST(CloudMask, CountsWhatItTakesOut) {
  Recording recording;
  Series& tool = recording.series["tool_commanded"];
  tool.columns = {"tip_commanded_x_m", "tip_commanded_y_m", "tip_commanded_z_m"};
  tool.time_ns = {0, 1'000'000'000};
  tool.values = {0, 0, 0.003, 0, 0, 0.03};
  recording.clouds.time_ns = {0, 1'000'000'000};
  recording.clouds.number = {0, 1};
  recording.clouds.fetch = [](std::size_t k) {
    const float up = 0.027F * static_cast<float>(k);
    return Cloud{{0, 0, 0.006F}, {0.001F, 0, 0.023F + up}, {0.06F, 0, 0}, {0.5F, 0, 0}};
  };
  const SeenFigures figures = look_at_clouds(recording, "test", sheet(), 10);
  EXPECT_EQ(figures.frames, 2);
  for (const std::size_t count : figures.parts.count) EXPECT_EQ(count, 2);
  EXPECT_THAT(print_seen(figures),
              HasSubstr("2 frames, 8 points: tissue 25.0 %, tool 25.0 %, board 25.0 %"));
}

}  // namespace
}  // namespace omentum
