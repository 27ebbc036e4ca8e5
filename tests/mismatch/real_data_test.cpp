// The recordings of others (OMENTUM_REAL_DATA): in through mapping files alone, out and in again
// the same.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "mismatch/import/import_map.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/recording_mcap.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using Made = std::map<std::string, Recording>;

class RealData : public testing::Test {
 protected:
  /// Empty, and the test skipped, where the set is not there.
  Made import(const std::string& set, const std::string& map) {
    const char* root = std::getenv("OMENTUM_REAL_DATA");
    const std::string folder = root == nullptr ? "" : std::string(root) + "/" + set;
    if (folder.empty() || !std::filesystem::is_directory(folder)) return {};
    Made made;
    import_mapped(read_import_map(OMENTUM_TESTS_DIR "/mismatch/maps/" + map + ".txtpb"), folder,
                  [&](const std::string& name, const Recording& recording) {
                    made[name] = recording;
                    expect_identity(name, recording);
                  });
    EXPECT_FALSE(made.empty());
    return made;
  }

  void expect_identity(const std::string& name, const Recording& made) {
    const std::string file = folder_ / (name + ".mcap"), out = folder_ / name;
    write_recording_mcap(made, file);
    const Recording in = read_recording_mcap(file);
    EXPECT_EQ(difference(made, in), "") << name;
    write_recording_folder(in, out);
    EXPECT_EQ(difference(in, read_recording_folder(out)), "") << name;
    std::filesystem::remove(file);
    std::filesystem::remove_all(out);
  }
  test::TempDir folder_;
};

#define SKIP_WITHOUT(made, set) \
  if ((made).empty()) GTEST_SKIP() << set " is not in OMENTUM_REAL_DATA"

TEST_F(RealData, SiliconeBeam) {
  const Made made = import("silicone_beam", "silicone_beam");
  SKIP_WITHOUT(made, "silicone_beam");
  ASSERT_EQ(made.size(), 4);
  const Recording& r = made.at("beam_load52_V2_b");
  EXPECT_TRUE(r.info.held_out());
  EXPECT_EQ(r.info.repeat_of(), "beam_load52_V2_a");
  EXPECT_EQ(made.at("beam_gravity_V2_a").find("markers")->rows(), 500);
  EXPECT_EQ(r.find("markers")->columns.size(), 18);
}

TEST_F(RealData, ClothLift) {
  const Made made = import("cloth_lift", "cloth_lift");
  SKIP_WITHOUT(made, "cloth_lift");
  ASSERT_EQ(made.size(), 10);
  const Recording& r = made.at("tan2");
  EXPECT_TRUE(r.info.held_out());
  EXPECT_EQ(r.info.repeat_of(), "tan");
  ASSERT_EQ(r.clouds.size(), 25);
  EXPECT_EQ(r.find("tool_commanded")->rows(), 25);
  // The cloth is under the gripper and within half a metre of it, in metres of the robot's frame.
  const Cloud cloud = r.clouds.fetch(24);
  Eigen::Vector3f mean = Eigen::Vector3f::Zero();
  for (const Eigen::Vector3f& p : cloud) mean += p / static_cast<float>(cloud.size());
  const Series& tip = *r.find("tool_commanded");
  const Eigen::Vector3d away =
      mean.cast<double>() - Eigen::Vector3d(tip.at(24, 0), tip.at(24, 1), tip.at(24, 2));
  EXPECT_LT(away.norm(), 0.5);
  EXPECT_LT(away.z(), 0);
}

TEST_F(RealData, DavinciJaw) {
  const Made made = import("davinci_jaw", "davinci_jaw");
  SKIP_WITHOUT(made, "davinci_jaw");
  ASSERT_EQ(made.size(), 8);
  const Recording& r = made.at("Tool_4_Maryland_R_5_02");
  EXPECT_EQ(r.info.notes(), "frequency 0, resisting torque 30 percent");
  EXPECT_EQ(r.info.specimen(), "tool_4_R_5");
  const Series& joints = *r.find("joints");
  double largest = 0;
  for (std::size_t row = 0; row < joints.rows(); ++row)
    largest = std::max(largest, std::fabs(joints.at(row, joints.find("q_in_measured_rad"))));
  // A sine of 30 deg about the place where the record began.
  EXPECT_GT(largest, 0.4);
  EXPECT_LT(largest, 1.2);
  const Series& goals = *r.find("joints_commanded");
  double goal = 0;
  for (std::size_t row = 0; row < goals.rows(); ++row)
    goal = std::max(goal, std::fabs(goals.at(row, goals.find("q_in_commanded_rad"))));
  EXPECT_NEAR(goal, largest, 0.2) << "target_cnt is in radians";
}

TEST_F(RealData, PsmTipPush) {
  const Made steps = import("psm_tip_push", "psm_tip_push");
  SKIP_WITHOUT(steps, "psm_tip_push");
  EXPECT_EQ(steps.size(), 1780 / 20);
  const Recording& r = steps.begin()->second;
  EXPECT_EQ(r.find("tool")->rows(), 20);
  EXPECT_TRUE(r.info.samples_at_rest());
  const Made raw = import("psm_tip_push", "psm_tip_push_raw");
  ASSERT_EQ(raw.size(), 9);
  EXPECT_EQ(raw.at("z_z-0.155_1").find("force")->rows(), 400);
}

TEST_F(RealData, PsmInsertion) {
  const Made speed = import("psm_insertion", "psm_insertion_speed");
  SKIP_WITHOUT(speed, "psm_insertion");
  EXPECT_EQ(speed.begin()->second.find("joints")->rows(), 13459);
  const Made ramp = import("psm_insertion", "psm_insertion_ramp");
  ASSERT_EQ(ramp.size(), 30);
  EXPECT_EQ(ramp.at("ramp_2").info.repeat_of(), "ramp_from_0.033929_m");
  const Series& joints = *ramp.at("ramp_2").find("joints");
  EXPECT_EQ(joints.rows(), 500);
  EXPECT_NEAR(joints.at(0, joints.find("q3_measured_m")), 0.0339, 1e-3);
}

TEST_F(RealData, SiliconeTension) {
  const Made made = import("silicone_tension", "silicone_tension");
  SKIP_WITHOUT(made, "silicone_tension");
  ASSERT_EQ(made.size(), 19);
  const Recording& r = made.at("Ecoflex_00-30");
  EXPECT_EQ(r.info.specimen(), "EcoFlex30");
  EXPECT_NEAR(r.info.coupon().gauge_length_m(), 0.033, 1e-12);
  EXPECT_NEAR(r.info.coupon().cross_section_m2(), 18e-6, 1e-15);
  EXPECT_NEAR(r.find("coupon")->at(0, 1), 1490, 1e-9);
}

TEST_F(RealData, SiliconeCompression) {
  const Made made = import("silicone_compression", "silicone_compression");
  SKIP_WITHOUT(made, "silicone_compression");
  ASSERT_EQ(made.size(), 30);
  const Recording& r = made.at("EF30_0T_B4");
  EXPECT_EQ(r.info.repeat_of(), "EF30_0T");
  EXPECT_NEAR(r.info.coupon().gauge_length_m(), 0.03, 1e-12);
  // Strain is elongation over height: both are negative in compression.
  const Series& coupon = *r.find("coupon");
  const std::size_t last = coupon.rows() - 1;
  EXPECT_LT(coupon.at(last, 0), -0.005);
  EXPECT_NEAR(coupon.at(last, 2), coupon.at(last, 0) / 0.03, 1e-3);
}

}  // namespace
}  // namespace omentum
