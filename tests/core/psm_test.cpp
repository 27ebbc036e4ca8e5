#include "core/psm.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "core/constants.h"
#include "core/rng.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

double uniform(std::uint32_t word, double min, double max) {
  return min + (max - min) * static_cast<double>(word) * 0x1p-32;
}

TEST(Trig, AgreesWithLibm) {
  for (std::uint32_t i = 0; i < 200000; ++i) {
    const PhiloxWords w = philox({i, 0, 0, 0}, {3, 4});
    const double x = uniform(w[0], -20, 20);
    const trig::SinCos sc = trig::sin_cos(x);
    ASSERT_NEAR(sc.sin, std::sin(x), 2.3e-16) << x;  // one unit in the last place below 1
    ASSERT_NEAR(sc.cos, std::cos(x), 2.3e-16) << x;
    const double y = uniform(w[1], -1, 1);
    const double z = uniform(w[2], -1, 1);
    ASSERT_NEAR(trig::atan2(y, z), std::atan2(y, z), 9e-16)
        << y << " " << z;  // two units in the last place of pi
  }
  EXPECT_EQ(trig::atan2(0, 0), 0);
  EXPECT_NEAR(trig::atan2(0, -1), kPi, 1e-15);
  EXPECT_NEAR(trig::atan2(-1, 0), -kPi / 2, 1e-15);
}

struct Vector {
  PsmJoints q;
  Vector3d p;
  Matrix3d R;
};

Matrix3d rows(double a, double b, double c, double d, double e, double f, double g, double h,
              double i) {
  Matrix3d R;
  R << a, b, c, d, e, f, g, h, i;
  return R;
}

std::vector<Vector> table() {  // docs/dvrk.md 2, h = 1.5708
  return {{{0, 0, .12, 0, 0, 0},
           {0.000000416909, 0.000000450335, -0.113499999998},
           rows(-0.000000000027, 1, 0, 0.999999999973, 0.000000000027, 0.000007346410,
                0.000007346410, 0, -0.999999999973)},
          {{.1, .1, .2, .1, .1, .1},
           {0.019118203062, -0.020211917666, -0.191445703806},
           rows(0.118622707878, 0.975318621830, 0.186231681212, 0.975121990995, -0.079055625162,
                -0.207092517510, -0.187258526786, 0.206164482978, -0.960432428703)},
          {{.5, -.3, .15, 1.2, -.7, .4},
           {0.069239177812, 0.043804652963, -0.115343478463},
           rows(0.291263251886, 0.085794387732, 0.952788035785, 0.074384606925, -0.994986094647,
                0.066855079931, 0.953746637401, 0.051400335539, -0.296184667316)},
          {{-.8, .6, .22, -2, 1.1, -1},
           {-0.119689923109, -0.114957530441, -0.126525430403},
           rows(-0.738550646235, -0.232947514081, 0.632675587192, -0.659003890471, 0.447534885083,
                -0.604505085982, -0.142326439180, -0.863393295270, -0.484040496646)},
          {{1.2, -.9, .08, 3, .3, 1.3},
           {0.040266469602, 0.058911226894, -0.016061781848},
           rows(0.910569611074, -0.381343565828, -0.159499430062, -0.356414852517, -0.919767265548,
                0.164306512748, -0.209359586105, -0.092764551568, -0.973428632042)}};
}

TEST(Psm, ForwardReproducesTheTable) {
  for (const Vector& v : table()) {
    const PsmPose pose = psm_forward(v.q);
    EXPECT_LT((pose.p - v.p).cwiseAbs().maxCoeff(), 1e-10);
    EXPECT_LT((pose.R - v.R).cwiseAbs().maxCoeff(), 1e-10);
  }
}

TEST(Psm, TextbookVariantIsWithinTwoMicrometres) {
  for (const Vector& v : table()) {
    const PsmPose pose = psm_forward(v.q, large_needle_driver(), kPi / 2);
    EXPECT_LT((pose.p - v.p).cwiseAbs().maxCoeff(), 2e-6);
    EXPECT_LT((pose.R - v.R).cwiseAbs().maxCoeff(), 2e-5);
  }
}

TEST(Psm, InverseUndoesForwardOnRandomPosesOfEveryInstrument) {
  for (const PsmInstrument& instrument : psm_instruments()) {
    // From a wrist-pitch axis 50 mm inside: 5e-3 m of insertion and more for an Si instrument.
    const double nearest = 0.05 - psm_wrist_distance(0, instrument);
    for (std::uint32_t i = 0; i < 5000; ++i) {
      const PhiloxWords a = philox({i, 0, 0, 0}, {5, 6});
      const PhiloxWords b = philox({i, 1, 0, 0}, {5, 6});
      PsmJoints q{};
      for (std::size_t k = 0; k < 6; ++k) {
        const JointRange& limit = instrument.limits[k];
        q[k] = uniform(k < 4 ? a[k] : b[k - 4], 0.98 * limit.min, 0.98 * limit.max);
      }
      q[2] = uniform(a[2], std::max(nearest, 0.0), 0.235);
      ASSERT_EQ(psm_limit_violation(q, instrument), "");
      const Result<PsmJoints> back = psm_inverse(psm_forward(q, instrument), q[3], instrument);
      ASSERT_TRUE(back.has_value()) << back.error();
      for (std::size_t k = 0; k < 6; ++k) {
        ASSERT_NEAR(back.value()[k], q[k], 1e-12)
            << instrument.name << " joint " << k << " pose " << i;
      }
    }
  }
}

TEST(Psm, FortyFiveMillimetreRuleGivesTheRecordedInsertion) {
  // docs/dvrk.md 3: goal (0, 0, -0.02) with the rotation of q = 0 ends at q3 = 0.0606, tip z =
  // -0.0541.
  PsmPose pose = psm_forward({0, 0, 0.12, 0, 0, 0}, large_needle_driver(), kPi / 2);
  pose.p = Vector3d(0, 0, -0.02);
  const Result<PsmJoints> goal = psm_inverse(pose);
  ASSERT_TRUE(goal.has_value());
  EXPECT_FALSE(psm_limit_violation(goal.value()).empty());
  PsmJoints q = goal.value();
  q[2] = 0.0606 + 1e-9;  // the wrist-pitch axis 45 mm from the remote centre, and a rounding
  EXPECT_EQ(psm_limit_violation(q), "");
  EXPECT_NEAR(psm_forward(q).p.z(), -0.0541, 1e-5);
}

TEST(Psm, InverseRefusesWhatHasNoAnswer) {
  PsmPose pose = psm_forward({0, 0, 0.12, 0, 0, 0});
  PsmPose near = pose;
  near.p = Vector3d(0, 0, -0.0005);
  EXPECT_FALSE(psm_inverse(near).has_value());
  PsmPose skewed = pose;
  skewed.R *= 1.01;
  EXPECT_FALSE(psm_inverse(skewed).has_value());
  PsmPose broken = pose;
  broken.p.x() = std::nan("");
  EXPECT_FALSE(psm_inverse(broken).has_value());
}

TEST(Psm, LimitViolationNamesJointValueAndRange) {
  EXPECT_EQ(psm_limit_violation({0, 0, 0.12, 0, 0, 0}), "");
  const std::string text = psm_limit_violation({2.0, 0, 0.12, 0, 0, 0});
  EXPECT_NE(text.find("yaw"), std::string::npos);
  EXPECT_NE(text.find("1.588"), std::string::npos);
  EXPECT_FALSE(psm_limit_violation({0, 0, std::nan(""), 0, 0, 0}).empty());
}

TEST(Psm, AllPublishedVectors) {
  const char* folder = std::getenv("OMENTUM_REAL_DATA");  // NOLINT(concurrency-mt-unsafe)
  if (folder == nullptr) GTEST_SKIP() << "OMENTUM_REAL_DATA is not set";
  std::ifstream file(std::string(folder) + "/dvrk_wire/psm_lnd400006_fk_100.csv");
  if (!file) GTEST_SKIP() << "no dvrk_wire in OMENTUM_REAL_DATA";
  std::string line;
  std::getline(file, line);
  int count = 0;
  while (std::getline(file, line)) {
    std::vector<double> v;
    std::stringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) v.push_back(std::stod(cell));
    ASSERT_EQ(v.size(), 18U);
    const PsmJoints q = {v[0], v[1], v[2], v[3], v[4], v[5]};
    const PsmPose pose = psm_forward(q);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(pose.p[k], v[static_cast<std::size_t>(6 + k)], 1e-12);
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR(pose.R(r, c), v[static_cast<std::size_t>(9 + 3 * r + c)], 1e-12);
    }
    const Result<PsmJoints> back = psm_inverse(pose, q[3]);
    ASSERT_TRUE(back.has_value());
    for (std::size_t k = 0; k < 6; ++k) EXPECT_NEAR(back.value()[k], q[k], 1e-12);
    ++count;
  }
  EXPECT_EQ(count, 100);
}

ToolMount test_mount() {
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  X_WR.translation() = Vector3d(0.1427, 0, 0.1584);
  return make_tool_mount(X_WR, 30 * kPi / 180, 0.0102, Vector3d(-0.0916, -0.0825, 0.001),
                         Vector3d(0.0691, 0.1155, 0.119));
}

TEST(ToolMount, TipLiesTheOffsetBelowTheControlPoint) {
  const ToolMount mount = test_mount();
  const Vector3d tip(0.01, 0.05, 0.05);
  EXPECT_NEAR((mount.control_point(tip) - tip).z(), 0.0102, 1e-15);
  EXPECT_LT((mount.tip(mount.control_point(tip)) - tip).norm(), 1e-15);
}

TEST(LimitCommand, DropsTheIncrementOfAnAxisThatWouldLeaveTheBox) {
  const ToolMount mount = test_mount();
  const Vector3d from(-0.02, 0.06, 0.1188);
  const LimitedCommand limited = limit_command(mount, from, Vector3d(0.0005, -0.0005, 0.0005));
  EXPECT_EQ(limited.axes_dropped, 1);
  EXPECT_FALSE(limited.unreachable);
  EXPECT_EQ(limited.p_WT.z(), from.z());
  EXPECT_NE(limited.p_WT.x(), from.x());
  EXPECT_NE(limited.p_WT.y(), from.y());
}

TEST(LimitCommand, KeepsThePreviousGoalWhereTheArmCannotGo) {
  const ToolMount mount = test_mount();
  // The far low corner of the box is beyond the arm's 0.24 m stroke.
  const Vector3d corner(-0.0914, 0.11, 0.002);
  ASSERT_FALSE(joints_for_tip(mount, corner).has_value());
  const LimitedCommand limited = limit_command(mount, corner, Vector3d(0, 0.0005, 0));
  EXPECT_TRUE(limited.unreachable);
  EXPECT_EQ(limited.p_WT, corner);
}

TEST(LimitCommand, NeverLeavesTheBoxWhateverIsAsked) {
  const ToolMount mount = test_mount();
  Vector3d p(-0.0216, 0.058, 0.1076);
  for (std::uint32_t i = 0; i < 5000; ++i) {
    const PhiloxWords w = philox({i, 7, 0, 0}, {8, 9});
    Vector3d increment;
    for (int k = 0; k < 3; ++k) increment[k] = uniform(w[static_cast<std::size_t>(k)], -0.01, 0.01);
    p = limit_command(mount, p, increment).p_WT;
    for (int k = 0; k < 3; ++k) {
      ASSERT_GE(p[k], mount.workspace_min[k]);
      ASSERT_LE(p[k], mount.workspace_max[k]);
    }
    ASSERT_TRUE(joints_for_tip(mount, p).has_value());
  }
}

TEST(TurnedTool, IsRzRyRxAboutItsTip) {
  const RollPitchYaw angles(0.4, -0.7, 1.1);
  const Matrix3d expected = (Eigen::AngleAxisd(angles[2], Vector3d::UnitZ()) *
                             Eigen::AngleAxisd(angles[1], Vector3d::UnitY()) *
                             Eigen::AngleAxisd(angles[0], Vector3d::UnitX()))
                                .toRotationMatrix();
  EXPECT_LT((rotation_of(angles) - expected).norm(), 1e-15);
  const ToolMount mount = test_mount();
  const ToolMount held = turned(mount, angles);
  EXPECT_LT((held.R_WC - expected * mount.R_WC).norm(), 1e-15);
  const Vector3d tip(0.01, 0.05, 0.04);
  EXPECT_LT((held.tip(held.control_point(tip)) - tip).norm(), 1e-15);
  EXPECT_EQ(turned(mount, RollPitchYaw::Zero()).R_WC, mount.R_WC);
}

TEST(LimitTurn, KeepsEveryAngleWithinItsLimitAndWithinReach) {
  const ToolMount mount = test_mount();
  const Vector3d tip(0.0, 0.05, 0.03);
  const LimitedTurn limited = limit_turn(mount, tip, {0.1, -0.29, 0.295}, {0.02, -0.02, 0.02}, 0.3);
  EXPECT_EQ(limited.axes_dropped, 2);
  EXPECT_FALSE(limited.unreachable);
  EXPECT_LT((limited.angles - RollPitchYaw(0.12, -0.29, 0.295)).norm(), 1e-15);
  RollPitchYaw angles = RollPitchYaw::Zero();
  int unreachable = 0;
  for (std::uint32_t i = 0; i < 5000; ++i) {
    const PhiloxWords w = philox({i, 7, 0, 0}, {8, 10});
    RollPitchYaw turn;
    for (int k = 0; k < 3; ++k) turn[k] = uniform(w[static_cast<std::size_t>(k)], -0.3, 0.3);
    const LimitedTurn next = limit_turn(mount, tip, angles, turn, 1.4);
    unreachable += next.unreachable ? 1 : 0;
    for (int k = 0; k < 3; ++k)
      EXPECT_TRUE(next.angles[k] == angles[k] || next.angles[k] == angles[k] + turn[k]);
    angles = next.angles;
    ASSERT_LE(angles.cwiseAbs().maxCoeff(), 1.4);
    ASSERT_TRUE(joints_for_tip(turned(mount, angles), tip).has_value());
  }
  EXPECT_GT(unreachable, 0);
}

}  // namespace
}  // namespace omentum
