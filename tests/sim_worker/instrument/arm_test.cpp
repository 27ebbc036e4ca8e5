// Effects of the arm against their known answers: docs/mismatch.md 2.3, 2.4.

#include "sim_worker/instrument/arm.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "core/check.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kPeriod = 0.02;
constexpr double kTwoPi = 2 * std::numbers::pi;
const Vector3d kRest(0, 0, -0.15);  // straight below the remote centre: z is the insertion alone

ToolMount straight_mount() {
  return make_tool_mount(Eigen::Isometry3d::Identity(), 0, 0.0102, Vector3d::Constant(-1),
                         Vector3d::Constant(1));
}

Arm make_arm(const pb::ArmEffects& effects) { return {effects, straight_mount(), kPeriod}; }

Vector3d true_tip(const ArmState& s) { return {s.p_WT_true[0], s.p_WT_true[1], s.p_WT_true[2]}; }
Vector3d measured_tip(const ArmState& s) {
  return {s.p_WT_measured[0], s.p_WT_measured[1], s.p_WT_measured[2]};
}

/// Full width of the loop of true over commanded height at mid-stroke, for a sine of amplitude A
/// and frequency f under a constant load, after two cycles.
double loop_width(const pb::ArmEffects& effects, double amplitude, double frequency,
                  const Vector3d& load = Vector3d::Zero()) {
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  double up = 0;
  double down = 0;
  Vector3d before = kRest;
  double before_true = kRest.z();
  const int steps = static_cast<int>(std::lround(4 / frequency / kPeriod));
  for (int n = 1; n <= steps; ++n) {
    const double phase = kTwoPi * frequency * n * kPeriod;
    const Vector3d command = kRest + Vector3d(0, 0, amplitude * std::sin(phase));
    arm.step(state, command, load);
    const double a = before.z() - kRest.z();
    const double b = command.z() - kRest.z();
    if (a * b <= 0 && a != b && n > steps / 2) {  // the command passes mid-stroke in this step
      const double at = before_true + (true_tip(state).z() - before_true) * (a / (a - b));
      (b > a ? up : down) = at;
    }
    before = command;
    before_true = true_tip(state).z();
  }
  return down - up;
}

TEST(Arm, WithoutEffectsItIsInactive) {
  pb::ArmEffects effects;
  effects.mutable_backlash();
  effects.add_coupling();
  EXPECT_FALSE(make_arm(effects).active());
  effects.set_payload_kg(0.1);
  EXPECT_TRUE(make_arm(effects).active());
}

TEST(Arm, EffectsAtZeroChangeNoBitBesideOneThatIsOn) {
  pb::ArmEffects effects;
  effects.set_transport_delay_s(2 * kPeriod);
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  std::vector<Vector3d> commands = {kRest, kRest};
  for (int n = 0; n < 50; ++n) {
    commands.push_back(kRest + Vector3d(0.01 * std::sin(0.3 * n), 0.0003 * n, 0.01 * std::cos(n)));
    arm.step(state, commands.back(), Vector3d(0.1, 0.2, 0.3));
    const Vector3d expected = commands[commands.size() - 3];
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ(true_tip(state)[k], expected[k]) << n;
      EXPECT_EQ(measured_tip(state)[k], expected[k]) << n;
    }
  }
}

TEST(Arm, DelayShiftsTheCommandAlsoBetweenSteps) {
  pb::ArmEffects effects;
  effects.set_transport_delay_s(0.033);
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  const double speed = 0.02;
  for (int n = 1; n <= 40; ++n)
    arm.step(state, kRest + Vector3d(0, 0, speed * kPeriod * n), Vector3d::Zero());
  EXPECT_NEAR(true_tip(state).z(), kRest.z() + speed * (40 * kPeriod - 0.033), 1e-12);
}

/// Lag behind a ramp over its speed [s], and gain at a frequency.
std::pair<double, double> lag_and_gain(const pb::ArmEffects& effects, double frequency) {
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  const double speed = 0.02;
  for (int n = 1; n <= 100; ++n)
    arm.step(state, kRest + Vector3d(0, 0, speed * kPeriod * n), Vector3d::Zero());
  const double lag = (kRest.z() + speed * 2.0 - true_tip(state).z()) / speed;
  arm.reset(state, kRest);
  double largest = 0;
  for (int n = 1; n <= 500; ++n) {
    const double s = std::sin(kTwoPi * frequency * n * kPeriod);
    arm.step(state, kRest + Vector3d(0, 0, 0.01 * s), Vector3d::Zero());
    if (n > 250) largest = std::max(largest, true_tip(state).z() - kRest.z());
  }
  return {lag, largest / 0.01};
}

TEST(Arm, DroopLagsByItsTimeAndAttenuatesAsFirstOrder) {
  pb::ArmEffects effects;
  effects.mutable_droop_s()->set_insertion(0.0333);
  const auto [lag, gain] = lag_and_gain(effects, 1.01);
  EXPECT_NEAR(lag, 0.0333, 1e-9);
  const double omega_t = kTwoPi * 1.01 * 0.0333;
  EXPECT_NEAR(gain, 1 / std::sqrt(1 + omega_t * omega_t), 0.002);
}

TEST(Arm, ViscousFrictionLagsByItsCoefficientOverTheGain) {
  pb::ArmEffects effects;
  effects.mutable_viscous_friction()->set_insertion(120);
  EXPECT_NEAR(lag_and_gain(effects, 1).first, 120.0 / 6000, 1e-9);
}

TEST(Arm, BandwidthLagsByBothPolesAndAttenuatesAsSecondOrder) {
  pb::ArmEffects effects;
  effects.set_bandwidth_s(0.03);
  const auto [lag, gain] = lag_and_gain(effects, 1.01);
  EXPECT_NEAR(lag, 0.06, 1e-9);
  const double omega_t = kTwoPi * 1.01 * 0.03;
  EXPECT_NEAR(gain, 1 / (1 + omega_t * omega_t), 0.003);
}

TEST(Arm, LoopsScaleAsTheirLawsSay) {  // docs/mismatch.md 2.4
  pb::ArmEffects play;
  play.mutable_backlash()->set_insertion(0.0007);
  for (const double amplitude : {0.005, 0.02}) {
    for (const double frequency : {0.25, 1.0})
      EXPECT_NEAR(loop_width(play, amplitude, frequency), 2 * 0.0007, 1e-7);
  }
  // Play at the tip: the same loop, along its axis only.
  pb::ArmEffects tip;
  tip.mutable_tip_backlash()->set_z(0.0007);
  for (const double frequency : {0.25, 1.0})
    EXPECT_NEAR(loop_width(tip, 0.01, frequency), 2 * 0.0007, 1e-7);
  tip.mutable_tip_backlash()->set_z(0);
  tip.mutable_tip_backlash()->set_x(0.0007);
  EXPECT_NEAR(loop_width(tip, 0.01, 0.5), 0, 1e-12);
  pb::ArmEffects coulomb;
  coulomb.mutable_coulomb_friction()->set_insertion(3);
  EXPECT_NEAR(loop_width(coulomb, 0.01, 0.5), 2 * 3.0 / 6000, 1e-7);
  pb::ArmEffects load;
  load.set_load_friction(0.4);
  for (const double newtons : {1.0, 3.0}) {
    EXPECT_NEAR(loop_width(load, 0.01, 0.5, Vector3d(0, 0, -newtons)), 2 * 0.4 * newtons / 6000,
                1e-7);
  }
  EXPECT_NEAR(loop_width(load, 0.01, 0.5), 0, 1e-9);
  pb::ArmEffects delay;
  delay.set_transport_delay_s(0.04);
  const double omega = kTwoPi * 0.5;
  EXPECT_NEAR(loop_width(delay, 0.01, 0.5), 2 * 0.01 * std::sin(omega * 0.04), 1e-5);
  EXPECT_NEAR(loop_width(delay, 0.02, 0.5) / loop_width(delay, 0.01, 0.5), 2, 1e-3);
}

TEST(Arm, EncodersDoNotSeeWhatLiesBehindThem) {
  pb::ArmEffects hidden;
  hidden.mutable_backlash()->set_insertion(0.001);
  hidden.mutable_joint_compliance()->set_insertion(1e-3);
  hidden.mutable_joint_offset()->set_insertion(0.002);
  hidden.set_tool_length_offset_m(0.003);
  const Arm arm = make_arm(hidden);
  ArmState state;
  arm.reset(state, kRest);
  const Vector3d goal = kRest - Vector3d(0, 0, 0.01);
  arm.step(state, goal, Vector3d(0, 0, -2));
  EXPECT_EQ(measured_tip(state).z(), goal.z());
  // Down: play holds 1 mm back, 2 N give 2 mm, zero offset 2 mm and a longer tool 3 mm lower.
  EXPECT_NEAR(true_tip(state).z(), goal.z() + 0.001 - 0.002 - 0.002 - 0.003, 1e-9);

  pb::ArmEffects visible;
  visible.set_servo_compliance(1);
  const Arm soft = make_arm(visible);
  soft.reset(state, kRest);
  soft.step(state, kRest, Vector3d(0, 0, -6));
  EXPECT_NEAR(measured_tip(state).z(), kRest.z() - 6.0 / 6000, 1e-9);
  EXPECT_NEAR(true_tip(state).z(), kRest.z() - 6.0 / 6000, 1e-9);
}

TEST(Arm, TipComplianceFollowsTheForcePerAxisAndGrowsWithDepth) {
  pb::ArmEffects effects;
  effects.mutable_tip_compliance()->set_x(0.002);
  effects.mutable_tip_compliance()->set_z(0.001);
  effects.set_compliance_depth_slope(5);
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  const ArmReport report = arm.step(state, kRest, Vector3d(0.5, 0.5, 0.5));
  const double depth = 1 + 5 * (report.commanded[2] - 0.12);
  EXPECT_NEAR(true_tip(state).x(), depth * 0.001, 1e-12);
  EXPECT_NEAR(true_tip(state).y(), 0, 1e-12);
  EXPECT_NEAR(true_tip(state).z() - kRest.z(), depth * 0.0005, 1e-12);
  arm.step(state, kRest, Vector3d::Zero());
  EXPECT_NEAR((true_tip(state) - kRest).norm(), 0, 1e-15) << "reversible";
}

TEST(Arm, PayloadLoadsTheInsertionByItsWeight) {
  pb::ArmEffects effects;
  effects.set_payload_kg(0.2);
  effects.set_servo_compliance(1);
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  const ArmReport report = arm.step(state, kRest, Vector3d::Zero());
  EXPECT_NEAR(report.effort[2], -0.2 * 9.80665, 1e-6) << "the motor holds against the weight";
  EXPECT_NEAR(kRest.z() - true_tip(state).z(), 0.2 * 9.80665 / 6000, 1e-9);
}

TEST(Arm, CouplingMovesTheDrivenJointBySlopeTimesTheDrivingOne) {
  pb::ArmEffects effects;
  pb::JointCoupling& c = *effects.add_coupling();
  c.set_driven(pb::JOINT_WRIST_PITCH);
  c.set_driving(pb::JOINT_INSERTION);
  c.set_slope(0.5);
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  const ArmReport report = arm.step(state, kRest, Vector3d::Zero());
  // The tip turns about the wrist-pitch axis, 9.1 + 10.2 mm away.
  const double angle = 0.5 * report.commanded[2];
  const double arc = 2 * (0.0091 + 0.0102) * std::sin(angle / 2);
  EXPECT_NEAR((true_tip(state) - kRest).norm(), arc, 1e-5);
}

TEST(Arm, PlayOnThePitchDiscShowsOnPitchAndYawTogether) {
  // One cause, two joints: rows (1.0186) and (-0.8306) of the disc matrix.
  pb::ArmEffects effects;
  effects.mutable_disc_backlash()->set_pitch(0.05);
  const ToolMount mount = straight_mount();
  const Arm arm = make_arm(effects);
  ArmState state;
  arm.reset(state, kRest);
  const Vector3d aside = kRest + Vector3d(0.02, 0.02, 0);
  arm.step(state, aside, Vector3d::Zero());
  const auto nominal = joints_for_tip(mount, aside);
  ASSERT_TRUE(nominal.has_value());
  const double pitch = state.joint[4] - nominal.value()[4];
  const double yaw = state.joint[5] - nominal.value()[5];
  EXPECT_NEAR(std::fabs(pitch), 1.0186 * 0.05, 1e-9);
  EXPECT_NEAR(yaw / pitch, -0.8306 / 1.0186, 1e-9);
}

TEST(Arm, EveryParameterActsSmoothly) {
  // Where the tip ends after a curve under load, as a function of each parameter: the slope over h
  // and over h / 2 agree, so finite differences in lanes mean something.
  const auto end = [](const std::function<void(pb::ArmEffects&, double)>& set, double value) {
    pb::ArmEffects effects;
    set(effects, value);
    const Arm arm = make_arm(effects);
    ArmState state;
    arm.reset(state, kRest);
    for (int n = 1; n <= 60; ++n) {
      const Vector3d p = kRest + Vector3d(0.01 * std::sin(0.1 * n), 0.0002 * n, -0.0004 * n);
      arm.step(state, p, Vector3d(0.1, -0.2, -0.4));
    }
    return true_tip(state);
  };
  using Set = std::function<void(pb::ArmEffects&, double)>;
  const std::vector<std::pair<Set, double>> parameters = {
      {[](pb::ArmEffects& e, double v) { e.set_transport_delay_s(v); }, 0.03},
      {[](pb::ArmEffects& e, double v) { e.mutable_droop_s()->set_yaw(v); }, 0.03},
      {[](pb::ArmEffects& e, double v) { e.set_bandwidth_s(v); }, 0.03},
      {[](pb::ArmEffects& e, double v) { e.mutable_coulomb_friction()->set_insertion(v); }, 1},
      {[](pb::ArmEffects& e, double v) { e.mutable_viscous_friction()->set_pitch(v); }, 2},
      {[](pb::ArmEffects& e, double v) { e.set_load_friction(v); }, 0.3},
      {[](pb::ArmEffects& e, double v) { e.mutable_backlash()->set_yaw(v); }, 0.01},
      {[](pb::ArmEffects& e, double v) { e.mutable_disc_backlash()->set_yaw(v); }, 0.02},
      {[](pb::ArmEffects& e, double v) { e.set_servo_compliance(v); }, 1},
      {[](pb::ArmEffects& e, double v) { e.mutable_joint_compliance()->set_pitch(v); }, 0.1},
      {[](pb::ArmEffects& e, double v) { e.mutable_tip_compliance()->set_y(v); }, 0.001},
      {[](pb::ArmEffects& e, double v) { e.mutable_joint_offset()->set_roll(v); }, 0.05},
      {[](pb::ArmEffects& e, double v) { e.set_tool_length_offset_m(v); }, 0.002}};
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const auto& [set, at] = parameters[i];
    const double h = 0.02 * at;
    const Vector3d wide = (end(set, at + h) - end(set, at - h)) / (2 * h);
    const Vector3d narrow = (end(set, at + h / 2) - end(set, at - h / 2)) / h;
    EXPECT_GT(narrow.norm() * at, 1e-6) << "parameter " << i << " does nothing";
    EXPECT_LT((wide - narrow).norm(), 0.05 * narrow.norm()) << "parameter " << i;
  }
}

TEST(Arm, WrongParametersAreRefusedByName) {
  pb::ArmEffects effects;
  effects.set_transport_delay_s(0.31);
  EXPECT_THROW(make_arm(effects), Error);
  pb::ArmEffects negative;
  negative.mutable_backlash()->set_pitch(-0.1);
  try {
    make_arm(negative);
    FAIL();
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "scene.arm.backlash.pitch: -0.1, allowed 0 or more");
  }
}

}  // namespace
}  // namespace omentum
