// scene_believed.txt as a scene.
#include "mismatch/scene/believed_scene.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "mismatch/scene/belief.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/effect_laws.h"
#include "sim_worker/tissue/surroundings.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using testing::Contains;
using testing::HasSubstr;

const std::string kSheet =
    "kind: sheet  # a comment\n"
    "sheet_size_x_m: 0.09\n"
    "sheet_size_y_m: 0.12\n"
    "sheet_thickness_m: 0.004\n"
    "young_modulus_nominal_Pa: 30000\n"
    "young_modulus_uncertainty_factor: 3\n"
    "density_nominal_kg_per_m3: 1050\n"
    "sheet_origin_x_m: 0.1\n"
    "sheet_origin_y_m: 0.05\n"
    "sheet_origin_z_m: 0.01\n"
    "sheet_axis_x_in_W: 1 0 0\n"
    "sheet_axis_y_in_W: 0 1 0\n"
    "clamp_strip_width_m: 0.005\n"
    "board_plane_z_m: 0.01\n"
    "board_friction_nominal: 0.4\n"
    "pinch_point_1_sheet_m: 0.08 0.01\n"
    "camera_position_W_m: 0.3 0.1 0.4\n"
    "camera_registration_uncertainty: about 2 mm, 0.5 deg\n";

BelievedScene read(const std::string& text) {
  Result<BelievedScene> made = parse_believed_scene("b.txt", text);
  EXPECT_TRUE(made.has_value()) << (made ? "" : made.error());
  return made ? made.value() : BelievedScene{};
}
std::string refusal(const std::string& text) {
  const Result<BelievedScene> made = parse_believed_scene("b.txt", text);
  return made ? "" : made.error();
}

TEST(BelievedScene, ASheetIsASceneThatCanBeSimulated) {
  const BelievedScene made = read(kSheet);
  const Scene scene = make_scene(override_scene(made.scene, {}), "");
  EXPECT_EQ(scene.config.tissue().material().young_modulus_pa(), 30000);
  EXPECT_EQ(scene.config.tissue().density_kg_per_m3(), 1050);
  EXPECT_EQ(scene.config.tissue().dynamic_friction(), 0.4);
  Eigen::AlignedBox3d box, clamped;
  for (std::size_t k = 0; k < scene.tissue.particles.size(); ++k) {
    const Vector3d p = scene.tissue.X_WB * scene.tissue.particles[k];
    box.extend(p);
    if (scene.tissue.fixed[k] != 0) clamped.extend(p);
  }
  // x_S away from the clamp is x_W, y_S along it y_W; the middle lies half the thickness above.
  EXPECT_LT((box.min() - Vector3d(0.1, 0.05, 0.012)).norm(), 1e-9);
  EXPECT_LT((box.max() - Vector3d(0.19, 0.17, 0.012)).norm(), 1e-9);
  EXPECT_NEAR(clamped.min().x(), 0.1, 1e-9) << "the clamp is at x_S = 0";
  EXPECT_LE(clamped.max().x(), 0.105 + 1e-5);
  ASSERT_EQ(made.pinch_W.size(), 1U);
  EXPECT_LT((made.pinch_W[0] - Vector3d(0.18, 0.06, 0.012)).norm(), 1e-9);
}

TEST(BelievedScene, HowSureItIsBecomesPriors) {
  const BelievedScene made = read(kSheet);
  ASSERT_EQ(made.priors.prior_size(), 3);
  EXPECT_EQ(made.priors.prior(0).path(), "scene.tissue.material.young_modulus_pa");
  EXPECT_EQ(made.priors.prior(0).factor(), 3);
  EXPECT_EQ(made.priors.prior(1).sd(), 0.002);
  EXPECT_NEAR(made.priors.prior(2).sd(), 0.5, 1e-12);
}

TEST(BelievedScene, SaysWhatItCouldNotUse) {
  const BelievedScene made = read(
      kSheet + "mass_1_kg: 0.05\nshaft_direction_W: 0 0 0\nforce_sensor: none\nsheet_colour: 3\n");
  EXPECT_THAT(made.warnings, Contains(HasSubstr("b.txt:19: mass_1_kg: without mass_1_B_m")));
  EXPECT_THAT(made.warnings, Contains(HasSubstr("b.txt:20: shaft_direction_W: no direction")));
  EXPECT_THAT(made.warnings, Contains(HasSubstr("b.txt:21: force_sensor: words")));
  EXPECT_THAT(made.warnings, Contains(HasSubstr("b.txt:22: sheet_colour: no such key")));
}

TEST(BelievedScene, EveryKeyIsToldAtMostOnce) {
  const BelievedScene made =
      read(kSheet +
           "material: silicone\nclamped_edge: x = 0\ntip_reference: centre\ncloud_content: top\n"
           "force_sensor: at the tip\nsensor_noise_class: low\nsheet_colour: 3\nmass_2_B_m: 0 0\n");
  for (const std::string key :
       {"material", "clamped_edge", "tip_reference", "cloud_content", "force_sensor",
        "sensor_noise_class", "sheet_colour", "mass_2_B_m"}) {
    EXPECT_EQ(std::count_if(made.warnings.begin(), made.warnings.end(),
                            [&](const std::string& w) {
                              return w.find(": " + key + ": ") != std::string::npos;
                            }),
              1)
        << key;
  }
}

Vector3d gravity_of(const BelievedScene& made) {
  const Scene scene = make_scene(override_scene(made.scene, {}), "");
  const pb::TissueEffects& effects = scene.config.tissue().effects();
  EffectValues values;
  values.tilt_x = effects.gravity_tilt_x_deg() * kDegree;
  values.tilt_y = effects.gravity_tilt_y_deg() * kDegree;
  return tilted_gravity(values, scene.gravity);
}

TEST(BelievedScene, GravityIsAVectorOrItsSizeDownwards) {
  EXPECT_EQ(gravity_of(read(kSheet + "gravity_m_per_s2: 9.81\n")), Vector3d(0, 0, -9.81));
  const BelievedScene plain = read(kSheet + "gravity_m_per_s2: 0 0 -9.81\n");
  EXPECT_EQ(gravity_of(plain), Vector3d(0, 0, -9.81));
  EXPECT_FALSE(plain.scene.tissue().effects().has_gravity_tilt_x_deg());
  for (const Vector3d& g : {Vector3d(0.3, -0.2, -9.8), Vector3d(-9.81, 0, 0), Vector3d(0, 9.81, 0),
                            Vector3d(1, 2, 9.4), Vector3d(0, 0, 9.81)}) {
    const BelievedScene made =
        read(kSheet + fmt::format("gravity_m_per_s2: {} {} {}\n", g.x(), g.y(), g.z()));
    EXPECT_LT((gravity_of(made) - g).norm(), 1e-12) << g.transpose();
  }
}

TEST(BelievedScene, APatchIsAPadOfItsFullSizeAlongTheSheet) {
  const std::string turned = kSheet + "gripper_patch_x_m: 0.006\ngripper_patch_y_m: 0.008\n";
  for (const std::string shaft : {"", "shaft_direction_W: -0.2 0.5 0.8\n"}) {
    for (const double angle : {0.0, 0.3, 2.0, -2.5}) {
      std::string text = turned + shaft;
      text.replace(text.find("sheet_axis_x_in_W: 1 0 0"), 24,
                   fmt::format("sheet_axis_x_in_W: {} {} 0", std::cos(angle), std::sin(angle)));
      text.replace(text.find("sheet_axis_y_in_W: 0 1 0"), 24,
                   fmt::format("sheet_axis_y_in_W: {} {} 0", -std::sin(angle), std::cos(angle)));
      const Scene scene = make_scene(override_scene(read(text).scene, {}), "");
      const Grip grip = make_surroundings(scene).grip;
      EXPECT_TRUE(grip.pad);
      EXPECT_TRUE(grip.rectangle);
      EXPECT_EQ(grip.half, Eigen::Vector2d(0.003, 0.004));
      EXPECT_NEAR(std::fabs(grip.axis.y()), 1, 1e-9) << "x of the sheet is y_B; " << text;
    }
  }
  const Scene square =
      make_scene(override_scene(read(kSheet + "gripper_patch_y_m: 0.006\n").scene, {}), "");
  EXPECT_EQ(make_surroundings(square).grip.half, Eigen::Vector2d(0.003, 0.003))
      << "one number: both";
}

TEST(BelievedScene, AMeshThatNoPadCanHoldGetsADiscOfTheSameAreaAndSaysSo) {
  const BelievedScene made =
      read("kind: solid\nsheet_thickness_m: 0.03\ngripper_patch_x_m: 0.006\n");
  EXPECT_EQ(made.scene.tool().grip().hold(), pb::HOLD_MEAN);
  EXPECT_NEAR(made.scene.tool().grip().half_x_m(), 0.006 / std::sqrt(kPi), 1e-12);
  EXPECT_THAT(made.warnings,
              Contains(HasSubstr("b.txt:3: gripper_patch_x_m: only a sheet's grid")));
  EXPECT_NO_THROW(make_surroundings(make_scene(override_scene(made.scene, {}), "")));
}

TEST(BelievedScene, TheShaftAndAWeightGoIntoTheScene) {
  for (const std::string way : {"-0.3 0 0.9", "0.3 0 -0.9"}) {
    const BelievedScene made = read(kSheet + "shaft_direction_W: " + way + "\n");
    const Scene scene = make_scene(override_scene(made.scene, {}), "");
    EXPECT_LT(
        (scene_tool_mount(scene).jaw_direction() - Vector3d(0.3, 0, -0.9).normalized()).norm(),
        1e-9)
        << "towards the tip, from above";
  }
  const BelievedScene made =
      read(kSheet + "mass_2_kg: 0.05\nmass_2_B_m: 0.01 0.02 0\nmass_3_kg: 0.01\nmass_3_B_m: 0 0\n");
  const pb::AddedMass& mass = made.scene.tissue().effects().added_mass();
  EXPECT_EQ(mass.mass_kg(), 0.05);
  EXPECT_EQ(mass.x_m(), 0.01);
  EXPECT_EQ(mass.y_m(), 0.02);
  EXPECT_THAT(made.warnings, Contains(HasSubstr("b.txt:21: mass_3_kg: a scene can hang one mass")));
  EXPECT_NO_THROW(make_scene(override_scene(made.scene, {}), ""));
}

TEST(BelievedScene, OfWordsTheFirstNumberOfAUnitCountsAndOfARangeItsEnd) {
  EXPECT_EQ(uncertainty_in("up to 2 mm, 1 deg").metres, 0.002);
  EXPECT_DOUBLE_EQ(uncertainty_in("up to 2 mm, 1 deg").radians, kDegree);
  EXPECT_EQ(uncertainty_in("depth 0.5-1.5 mm sigma at 0.35 m, growing").metres, 0.0015);
  EXPECT_EQ(uncertainty_in("1e-3m").metres, 1e-3);
  EXPECT_EQ(uncertainty_in("2mm").metres, 0.002);
  EXPECT_EQ(uncertainty_in("5 percent of 3 metres, inf mm, .. mm").metres, 0);
}

TEST(BelievedScene, UnitsOfKeysAreConverted) {
  const BelievedScene made = read("sheet_thickness_mm: 4\nsheet_size_x_mm: 90\n");
  EXPECT_NEAR(made.scene.tissue().thickness_m(), 0.004, 1e-15);
}

TEST(BelievedScene, BadLinesAreRefusedWithTheirPlace) {
  EXPECT_EQ(refusal("kind sheet\n"), "b.txt:1: \"kind sheet\": no colon, needed key: value");
  EXPECT_EQ(refusal("\n: 3\n"), "b.txt:2: no key before the colon");
  EXPECT_EQ(refusal("kind:\n"), "b.txt:1: kind: no value behind the colon");
  EXPECT_EQ(refusal("kind: blanket\n"),
            "b.txt:1: kind: \"blanket\", allowed sheet, solid, arm, coupon");
  EXPECT_EQ(refusal("sheet_size_x_m: 0.09 0.1\n"), "b.txt:1: sheet_size_x_m: 2 numbers, needed 1");
  EXPECT_EQ(refusal("sheet_size_x_m: nan\n"),
            "b.txt:1: sheet_size_x_m: \"nan\" is no finite number");
  EXPECT_EQ(refusal("sheet_size_x_m: 90\n"), "b.txt:1: sheet_size_x_m: 90, allowed 0.002 ... 1");
  EXPECT_EQ(refusal("kind: arm\nkind: arm\n"),
            "b.txt:2: kind: given a second time, first on line 1");
  EXPECT_THAT(refusal("sheet_size_x_m: 0.09\nsheet_size_x_mm: 90\n"),
              HasSubstr("b.txt:2: sheet_size_x_mm: given a second time"));
  EXPECT_THAT(refusal("sheet_axis_x_in_W: 1 0 0\nsheet_axis_y_in_W: 2 0 0\n"),
              HasSubstr("parallel"));
  EXPECT_THAT(refusal("clamp_strip_width_m: 0.4\n"), HasSubstr("b.txt:1: clamp_strip_width_m"));
  EXPECT_THAT(refusal(std::string("a\0b", 3)), HasSubstr("bytes of zero"));
  EXPECT_EQ(refusal("gravity_m_per_s2: 0 -9.81\n"),
            "b.txt:1: gravity_m_per_s2: 2 numbers, needed 1 or 3");
  EXPECT_EQ(refusal("gravity_m_per_s2: -9.81\n"),
            "b.txt:1: gravity_m_per_s2: -9.81 m/s^2, allowed a size of 0 ... 20");
  EXPECT_EQ(refusal("gravity_m_per_s2: 15 15 0\n"),
            "b.txt:1: gravity_m_per_s2: 21.2132 m/s^2, allowed a size of 0 ... 20");
  EXPECT_EQ(refusal("mass_1_kg: 3\n"), "b.txt:1: mass_1_kg: 3, allowed 0 ... 1");
  EXPECT_EQ(refusal("mass_1_B_m: 0 3\n"), "b.txt:1: mass_1_B_m: 3, allowed -1 ... 1");
  EXPECT_EQ(refusal("mass_1_B_m: 0\n"), "b.txt:1: mass_1_B_m: 1 numbers, needed 2 or 3");
}

TEST(BelievedScene, ArmsAndCouponsStandAlone) {
  const BelievedScene arm = read("kind: arm\n");
  EXPECT_EQ(arm.kind, SetUp::kArm);
  EXPECT_FALSE(arm.scene.has_tissue());
  const BelievedScene coupon = read("kind: coupon\nyoung_modulus_nominal_Pa: 1e5\n");
  EXPECT_EQ(coupon.kind, SetUp::kCoupon);
  EXPECT_EQ(coupon.scene.tissue().material().young_modulus_pa(), 1e5);
}

TEST(BelievedScene, ASolidWithoutMeshIsABox) {
  const BelievedScene made = read(
      "kind: solid\nsheet_size_x_m: 0.1\nsheet_size_y_m: 0.03\nsheet_thickness_m: 0.03\n"
      "poisson_ratio_nominal: 0.5\n");
  const Scene scene = make_scene(override_scene(made.scene, {}), "");
  EXPECT_GT(scene.tissue.particles.size(), 50U);
  EXPECT_EQ(scene.config.tissue().material().poisson_ratio(), 0.49);
  EXPECT_THAT(made.warnings, Contains(HasSubstr("0.5 is taken as 0.49")));
}

}  // namespace
}  // namespace omentum
