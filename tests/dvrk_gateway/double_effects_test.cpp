// Effects of the arm in the double against their laws: docs/mismatch.md 2.2, 2.3.
#include <gtest/gtest.h>

#include <functional>

#include "tests/dvrk_gateway/double_session.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::DoubleSession;
using test::plain_mount;

constexpr int kTicksPerAction = 30;  // 50 Hz
constexpr double kServoGainInsertion = 6000;

struct Means {
  double lag = 0;       ///< set-point minus measured insertion, mean over the last second [m]
  double tip_lag = 0;   ///< measured minus true depth [m]
  double last_tip = 0;  ///< p_WT.z
};

RobotArm homed(const pb::ArmEffects& effects) {
  RobotArm arm(effects, plain_mount(), false);
  arm.home();
  for (int k = 0; k < 2300; ++k) arm.tick();
  EXPECT_TRUE(arm.engaged());
  return arm;
}

JointGoal insertion_goal(double q3, std::optional<double> velocity) {
  JointGoal goal;
  goal.goal_count = 6;
  goal.goal[2] = q3;
  if (velocity) {
    goal.velocity_count = 6;
    goal.velocity[2] = *velocity;
  }
  return goal;
}

/// Insertion driven at a constant speed by a client of 50 Hz for 2 s; means over the last second,
/// in which every staircase is whole.
Means drive(RobotArm& arm, double speed, bool send_velocity = false) {
  Means means;
  const double from = arm.setpoint_js().position[2];
  for (int step = 1; step <= 100; ++step) {
    CommandDatagram commands;
    commands.known_keys = 1;
    commands.servo_jp = insertion_goal(from + speed * 0.02 * step,
                                       send_velocity ? std::optional(speed) : std::nullopt);
    arm.command(commands);
    for (int k = 0; k < kTicksPerAction; ++k) {
      arm.tick();
      if (step <= 50) continue;
      const double measured = arm.measured_js().position[2];
      // Straight down: the depth of T below the remote centre is the insertion and 3.7 mm more.
      means.lag += (arm.setpoint_js().position[2] - measured) / (50 * kTicksPerAction);
      means.tip_lag += (measured + 0.0037 + arm.true_tip().z()) / (50 * kTicksPerAction);
    }
  }
  means.last_tip = arm.true_tip().z();
  return means;
}

pb::ArmEffects effects_with(const std::function<void(pb::ArmEffects&)>& set) {
  pb::ArmEffects effects;
  set(effects);
  return effects;
}

TEST(DoubleEffects, ZeroIsOffToTheByte) {
  const pb::ArmEffects zeros = effects_with([](pb::ArmEffects& e) {
    e.set_transport_delay_s(0);
    e.set_bandwidth_s(0);
    e.set_load_friction(0);
    e.set_servo_compliance(0);
    e.set_compliance_depth_slope(0);
    e.set_tool_length_offset_m(0);
    e.set_payload_kg(0);
    for (pb::JointValues* values :
         {e.mutable_droop_s(), e.mutable_coulomb_friction(), e.mutable_viscous_friction(),
          e.mutable_backlash(), e.mutable_joint_compliance(), e.mutable_joint_offset()})
      values->set_insertion(0);
    e.mutable_disc_backlash()->set_roll(0);
    e.mutable_tip_compliance()->set_x(0);
    e.add_coupling()->set_slope(0);
  });
  DoubleSession plain;
  DoubleSession zero({}, zeros);
  for (DoubleSession* session : {&plain, &zero}) {
    session->home();
    for (int k = 0; k < 50; ++k) {
      session->say(test::servo_jp({0.01 * k, 0, 0.12 + 0.0005 * k, 0.02 * k, 0, 0}));
      session->run_for(0.02);
    }
    session->say(test::cartesian("move_cp", {0.01, 0.01, -0.13}));
    session->run_for(1);
  }
  ASSERT_EQ(plain.link.sent.size(), zero.link.sent.size());
  for (std::size_t k = 0; k < plain.link.sent.size(); ++k)
    ASSERT_EQ(plain.link.sent[k].text, zero.link.sent[k].text);
}

TEST(DoubleEffects, IdealArmMeasuresItsSetpoint) {
  RobotArm arm = homed({});
  const Means means = drive(arm, 0.025);
  EXPECT_EQ(means.lag, 0);
  EXPECT_NEAR(means.tip_lag, 0, 1e-9);  // the theta offset of the robot's files turns the tool
}

TEST(DoubleEffects, LagsAreThoseOfTheirLaws) {
  const double v = 0.025;
  const struct {
    const char* name;
    std::function<void(pb::ArmEffects&)> set;
    double lag;
  } cases[] = {
      {"A1", [](pb::ArmEffects& e) { e.set_transport_delay_s(0.03); }, 0.03 * v},
      {"A1 between ticks", [](pb::ArmEffects& e) { e.set_transport_delay_s(0.0305); }, 0.0305 * v},
      {"A2", [](pb::ArmEffects& e) { e.mutable_droop_s()->set_insertion(0.0333); }, 0.0333 * v},
      {"A3", [](pb::ArmEffects& e) { e.set_bandwidth_s(0.03); }, 2 * 0.03 * v},
      {"A4 Fc", [](pb::ArmEffects& e) { e.mutable_coulomb_friction()->set_insertion(0.55); },
       0.55 / kServoGainInsertion},
      {"A4 Fv", [](pb::ArmEffects& e) { e.mutable_viscous_friction()->set_insertion(5); },
       5 / kServoGainInsertion * v},
  };
  for (const auto& one : cases) {
    for (const double sign : {1.0, -1.0}) {
      RobotArm arm = homed(effects_with(one.set));
      const Means means = drive(arm, sign * v);
      EXPECT_NEAR(means.lag, sign * one.lag, 0.05 * one.lag) << one.name;
      EXPECT_NEAR(means.tip_lag, 0, 1e-6) << one.name;  // what the encoder sees, the tip does
    }
  }
}

TEST(DoubleEffects, VelocityOfAGoalRemovesTheDroopOfThatGoal) {
  const auto droop = effects_with([](auto& e) { e.mutable_droop_s()->set_insertion(0.0333); });
  RobotArm arm = homed(droop);
  EXPECT_NEAR(drive(arm, 0.02, true).lag, 0, 0.02 * 0.0333 * 0.05);
  // The arm keeps none: it is the streamer that fills in what a datagram leaves out.
  EXPECT_NEAR(drive(arm, -0.02).lag, -0.02 * 0.0333, 0.02 * 0.0333 * 0.05);
}

TEST(DoubleEffects, CartesianVelocityRemovesTheDroopToo) {
  const auto droop = effects_with([](pb::ArmEffects& e) {
    for (const auto set :
         {&pb::JointValues::set_yaw, &pb::JointValues::set_pitch, &pb::JointValues::set_insertion,
          &pb::JointValues::set_wrist_pitch, &pb::JointValues::set_wrist_yaw})
      (e.mutable_droop_s()->*set)(0.05);
  });
  const auto lag = [&](bool send_velocity) {
    DoubleSession session({}, droop);
    session.home();
    const Vector3d v(0.02, 0.01, -0.01);
    const Vector3d from = session.state.setpoint_cp.payload.translation;
    RobotCommand command;
    command.kind = RobotCommand::Kind::kServoCp;
    command.rotation = session.state.setpoint_cp.payload.rotation;
    if (send_velocity) command.velocity = v;
    double mean = 0;
    for (int k = 1; k <= 50; ++k) {
      command.translation = from + 0.02 * k * v;
      session.say(command);
      for (int half = 0; half < 2; ++half) {
        session.run_for(0.01);
        const Vector3d behind = session.state.setpoint_cp.payload.translation -
                                session.state.measured_cp.payload.translation;
        if (k > 25) mean += behind.dot(v.normalized()) / 50;
      }
    }
    return mean / v.norm();
  };
  // Two samples per action stand for its mean: half a period of 10 ms either way.
  EXPECT_NEAR(lag(false), 0.05, 0.005);
  EXPECT_NEAR(lag(true), 0, 0.005);
}

TEST(DoubleEffects, PlayIsHiddenFromTheEncoder) {
  RobotArm arm = homed(effects_with([](auto& e) { e.mutable_backlash()->set_insertion(0.001); }));
  const Means down = drive(arm, 0.02);
  EXPECT_EQ(down.lag, 0);
  EXPECT_NEAR(down.tip_lag, 0.001, 1e-6);
  EXPECT_NEAR(drive(arm, -0.02).tip_lag, -0.001, 1e-6);
}

TEST(DoubleEffects, OffsetMovesTheTipAlone) {
  RobotArm arm =
      homed(effects_with([](auto& e) { e.mutable_joint_offset()->set_insertion(0.002); }));
  const Means means = drive(arm, 0.02);
  EXPECT_EQ(means.lag, 0);
  EXPECT_NEAR(means.tip_lag, -0.002, 1e-6);
}

TEST(DoubleEffects, LoadBendsTheTipByItsCompliance) {
  RobotArm arm = homed(effects_with([](auto& e) { e.mutable_tip_compliance()->set_z(0.001); }));
  for (int k = 0; k < 30; ++k) arm.tick();
  const double before = arm.true_tip().z();
  const double measured = arm.measured_js().position[2];
  arm.set_load({0, 0, -2});
  for (int k = 0; k < 30; ++k) arm.tick();
  EXPECT_NEAR(arm.true_tip().z() - before, -0.002, 1e-9);
  EXPECT_EQ(arm.measured_js().position[2], measured);
}

TEST(DoubleEffects, PayloadBendsTheServoByItsGain) {
  RobotArm arm = homed(effects_with([](auto& e) {
    e.set_payload_kg(0.2);
    e.set_servo_compliance(1);
  }));
  for (int k = 0; k < 30; ++k) arm.tick();
  const double sag = arm.measured_js().position[2] - arm.setpoint_js().position[2];
  EXPECT_NEAR(sag, 0.2 * 9.80665 / kServoGainInsertion, 1e-8);
}

TEST(DoubleEffects, CouplingMovesTheDrivenJoint) {
  RobotArm arm = homed(effects_with([](auto& e) {
    pb::JointCoupling& coupling = *e.add_coupling();
    coupling.set_driven(pb::JOINT_INSERTION);
    coupling.set_driving(pb::JOINT_YAW);
    coupling.set_slope(0.01);
  }));
  CommandDatagram commands;
  commands.known_keys = 1;
  commands.servo_jp = insertion_goal(0.12, std::nullopt);
  commands.servo_jp->goal[0] = 0.3;
  arm.command(commands);
  for (int k = 0; k < 30; ++k) arm.tick();
  EXPECT_NEAR(arm.true_tip().norm() - 0.1237, 0.003, 1e-6);
}

TEST(DoubleEffects, FaultComesFromTheLagToo) {
  const auto slow = effects_with([](auto& e) { e.mutable_droop_s()->set_insertion(0.5); });
  RobotArm arm = homed(slow);
  drive(arm, 0.06);  // 0.5 s behind at 60 mm/s would be 30 mm: within the tolerance of 50 mm
  EXPECT_EQ(arm.operating_state().state, OperatingState::State::kEnabled);
  drive(arm, -0.11);
  EXPECT_EQ(arm.operating_state().state, OperatingState::State::kFault);
}

TEST(DoubleEffects, ReportedEffortsAreTheDampingOfTheServo) {
  // Recorded: every joint at 0.0271951 (insertion 0.0081585) after a step of 0.1 rad and 30 mm.
  const std::array<double, 6> recorded = {-0.16317071843238418,   -0.1359755986936535,
                                          -1.6317071843238427,    -0.0010016232385969951,
                                          -0.0072452888894414692, -0.0059922752476784186};
  RobotArm arm = homed({});
  while (arm.measured_js().velocity[2] != 0) arm.tick();
  CommandDatagram commands;
  commands.known_keys = 1;
  commands.servo_jp = JointGoal{6, 0, {0.1, 0.1, 0.15, 0.1, 0.1, 0.1}, {}};
  arm.command(commands);
  arm.tick();
  const JointState measured = arm.measured_js();
  const JointState setpoint = arm.setpoint_js();
  const double scale = 0.027195119738730698 / measured.velocity[0];
  for (std::size_t j = 0; j < 6; ++j)
    EXPECT_NEAR(setpoint.effort[j] * scale / recorded[j], 1, 1e-9) << j;
}

}  // namespace
}  // namespace omentum
