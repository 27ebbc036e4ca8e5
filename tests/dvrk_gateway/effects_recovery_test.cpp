// Every effect of the arm is found again, within 5 %, in what the double sends and in where a
// tracker sees its tip: by estimators of docs/mismatch.md 2.2, 2.3 that share no code with the arm.
#include <gtest/gtest.h>

#include <functional>

#include "tests/dvrk_gateway/double_session.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::DoubleSession;

constexpr std::array<double, 6> kGain = {120, 120, 6000, 6, 6, 6};  // N m/rad, N/m
constexpr double kGravity = 9.80665;
const PsmJoints kNear = {-1.35, -0.4, 0.10, -0.8, -0.5, -0.4};
const PsmJoints kFar = {1.35, 0.4, 0.16, 0.8, 0.5, 0.4};
const PsmJoints kRest = {0.3, -0.2, 0.14, 0.4, 0.2, -0.3};

struct Sample {
  PsmJoints setpoint{}, measured{};
  Vector3d tip;  ///< p_WT, of the tracker [m]
};

/// A double with one effect, and the client that moves it.
class Recorded {
 public:
  explicit Recorded(const std::function<void(pb::ArmEffects&)>& set) {
    pb::ArmEffects effects;
    set(effects);
    session_ = std::make_unique<DoubleSession>(DoubleOptions{}, effects);
    session_->home();
  }

  /// To joints in one move, in which all joints keep one profile; then at rest for a second.
  std::vector<Sample> move_to(const PsmJoints& q) {
    session_->say(
        fmt::format(R"({{"move_jp":{{"Goal":{}}}}})", test::text_of({q.begin(), q.end()})));
    std::vector<Sample> samples;
    session_->run_for(0.05);
    for (int rest = 0; rest < 100;) {
      session_->run_for(0.01);
      samples.push_back(sample());
      rest = session_->operating().is_busy ? 0 : rest + 1;
    }
    EXPECT_EQ(session_->operating().state, OperatingState::State::kEnabled);
    return samples;
  }
  /// At rest under a force on the tip.
  Sample under(const Vector3d& load_W) {
    session_->robot.arm().set_load(load_W);
    session_->run_for(1);
    return sample();
  }

 private:
  Sample sample() const {
    Sample now;
    std::copy_n(session_->setpoint().position.begin(), 6, now.setpoint.begin());
    std::copy_n(session_->state.measured_js.payload.position.begin(), 6, now.measured.begin());
    now.tip = session_->robot.arm().true_tip();
    return now;
  }
  std::unique_ptr<DoubleSession> session_;
};

// ---- what every estimator is made of -----------------------------------------------------------

Vector3d tip_place(const PsmJoints& q) {
  const PsmPose pose = psm_forward(q);
  return pose.p + 0.0102 * pose.R.col(2);
}
Vector3d tip_by_joint(const PsmJoints& q, std::size_t j) {
  PsmJoints up = q, down = q;
  up[j] += 1e-5;
  down[j] -= 1e-5;
  return (tip_place(up) - tip_place(down)) / 2e-5;
}
/// What a joint is beyond its encoder, if it alone moves the tip from where the encoders have it.
double hidden(const Sample& sample, std::size_t j) {
  const Vector3d by_joint = tip_by_joint(sample.measured, j);
  return (sample.tip - tip_place(sample.measured)).dot(by_joint) / by_joint.squaredNorm();
}

struct Cruise {
  double speed = 0;  ///< [rad/s, m/s]
  double lag = 0;    ///< set-point less encoder
};
/// The end of the stretch of constant speed of a move.
Cruise cruise_of(const std::vector<Sample>& move, std::size_t j) {
  double fastest = 0;
  const auto step = [&](std::size_t k) { return move[k].setpoint[j] - move[k - 1].setpoint[j]; };
  for (std::size_t k = 1; k < move.size(); ++k) fastest = std::max(fastest, std::abs(step(k)));
  std::size_t last = 0;
  for (std::size_t k = 1; k < move.size(); ++k) {
    if (std::abs(step(k)) > 0.999 * fastest) last = k;
  }
  Cruise cruise;
  constexpr int kSamples = 10;
  for (std::size_t k = last - kSamples; k < last; ++k) {
    cruise.speed += step(k) / 0.01 / kSamples;
    cruise.lag += (move[k].setpoint[j] - move[k].measured[j]) / kSamples;
  }
  return cruise;
}
/// Lag per speed, half the difference of both directions.
double lag_time(Recorded& arm, std::size_t j) {
  arm.move_to(kNear);
  const Cruise there = cruise_of(arm.move_to(kFar), j);
  const Cruise back = cruise_of(arm.move_to(kNear), j);
  return (there.lag - back.lag) / (there.speed - back.speed);
}
/// Half the width of the loop between encoder and joint.
double half_loop(Recorded& arm, std::size_t j) {
  arm.move_to(kNear);
  const double there = hidden(arm.move_to(kRest).back(), j);
  arm.move_to(kFar);
  const double back = hidden(arm.move_to(kRest).back(), j);
  return 0.5 * std::abs(back - there);
}

using Set = void (pb::JointValues::*)(double);
constexpr std::array<Set, 6> kSet = {
    &pb::JointValues::set_yaw,  &pb::JointValues::set_pitch,       &pb::JointValues::set_insertion,
    &pb::JointValues::set_roll, &pb::JointValues::set_wrist_pitch, &pb::JointValues::set_wrist_yaw};

void expect_found(double found, double truth, const std::string& what) {
  EXPECT_NEAR(found, truth, 0.05 * std::abs(truth)) << what;
}

// ---- what the encoder sees ---------------------------------------------------------------------

TEST(EffectsAreRecovered, TransportDelay) {
  for (const double truth : {0.012, 0.0333, 0.15}) {
    Recorded arm([&](pb::ArmEffects& e) { e.set_transport_delay_s(truth); });
    expect_found(lag_time(arm, 0), truth, "delay");
  }
}

TEST(EffectsAreRecovered, DroopOfEachJoint) {
  for (std::size_t j = 0; j < 6; ++j) {
    const double truth = 0.02 + 0.005 * static_cast<double>(j);
    Recorded arm([&](pb::ArmEffects& e) { (e.mutable_droop_s()->*kSet[j])(truth); });
    expect_found(lag_time(arm, j), truth, "droop " + std::to_string(j));
  }
}

TEST(EffectsAreRecovered, Bandwidth) {
  for (const double truth : {0.015, 0.04}) {
    Recorded arm([&](pb::ArmEffects& e) { e.set_bandwidth_s(truth); });
    expect_found(0.5 * lag_time(arm, 2), truth, "bandwidth");
  }
}

TEST(EffectsAreRecovered, ViscousFrictionOfEachJoint) {
  for (std::size_t j = 0; j < 6; ++j) {
    const double truth = 0.02 * kGain[j];
    Recorded arm([&](pb::ArmEffects& e) { (e.mutable_viscous_friction()->*kSet[j])(truth); });
    expect_found(lag_time(arm, j) * kGain[j], truth, "viscous " + std::to_string(j));
  }
}

TEST(EffectsAreRecovered, CoulombFrictionOfEachJoint) {
  for (std::size_t j = 0; j < 6; ++j) {
    const double truth = 0.002 * kGain[j];
    Recorded arm([&](pb::ArmEffects& e) { (e.mutable_coulomb_friction()->*kSet[j])(truth); });
    arm.move_to(kNear);
    const double there = cruise_of(arm.move_to(kFar), j).lag;
    const double back = cruise_of(arm.move_to(kNear), j).lag;
    expect_found(0.5 * (there - back) * kGain[j], truth, "Coulomb " + std::to_string(j));
  }
}

TEST(EffectsAreRecovered, BothFrictionsTogetherByTwoSpeeds) {
  const double coulomb = 0.8, viscous = 20;
  Recorded arm([&](pb::ArmEffects& e) {
    e.mutable_coulomb_friction()->set_insertion(coulomb);
    e.mutable_viscous_friction()->set_insertion(viscous);
  });
  arm.move_to(kNear);
  const Cruise fast = cruise_of(arm.move_to(kFar), 2);
  PsmJoints near_slow = kNear;
  near_slow[2] = kFar[2] - 0.01;
  arm.move_to(near_slow);
  const Cruise slow = cruise_of(arm.move_to(kFar), 2);
  const double slope = (fast.lag - slow.lag) / (fast.speed - slow.speed);
  expect_found(slope * kGain[2], viscous, "viscous");
  expect_found((slow.lag - slope * slow.speed) * kGain[2], coulomb, "Coulomb");
}

TEST(EffectsAreRecovered, FrictionThatGrowsWithTheLoad) {
  const double truth = 0.3;
  Recorded arm([&](pb::ArmEffects& e) { e.set_load_friction(truth); });
  // Along the shaft of the middle of the way, so that the load of the insertion is known there.
  const PsmJoints low = {0, 0, 0.10, 0, 0, 0}, high = {0, 0, 0.20, 0, 0, 0};
  arm.move_to(low);
  arm.under({0, 0, -8});
  const auto lag_on_the_way = [](const std::vector<Sample>& move) {
    const Sample& middle = move[move.size() / 4];
    return middle.setpoint[2] - middle.measured[2];
  };
  const double down = lag_on_the_way(arm.move_to(high));
  const double up = lag_on_the_way(arm.move_to(low));
  expect_found(0.5 * (down - up) * kGain[2] / 8, truth, "load friction");
}

TEST(EffectsAreRecovered, GiveOfTheServo) {
  const double truth = 0.7;
  Recorded arm([&](pb::ArmEffects& e) { e.set_servo_compliance(truth); });
  for (const std::size_t j : {0U, 1U, 2U}) {
    arm.move_to(kRest);
    const Vector3d force = 5 * tip_by_joint(kRest, j).normalized();
    const Sample free = arm.under(Vector3d::Zero()), pulled = arm.under(force);
    const double torque = force.dot(tip_by_joint(kRest, j));
    expect_found((pulled.measured[j] - free.measured[j]) * kGain[j] / torque, truth,
                 "give " + std::to_string(j));
  }
}

TEST(EffectsAreRecovered, Payload) {
  const double truth = 0.15;
  Recorded arm([&](pb::ArmEffects& e) {
    e.set_servo_compliance(1);
    e.set_payload_kg(truth);
  });
  const Sample rest = arm.move_to(kRest).back();
  for (const std::size_t j : {0U, 1U, 2U}) {
    const double lever = tip_by_joint(rest.setpoint, j).z();
    const double torque = (rest.measured[j] - rest.setpoint[j]) * kGain[j];
    expect_found(-torque / (kGravity * lever), truth, "payload by joint " + std::to_string(j));
  }
}

// ---- what the encoder does not see -------------------------------------------------------------

TEST(EffectsAreRecovered, PlayOfEachJoint) {
  for (std::size_t j = 0; j < 6; ++j) {
    const double truth = j == 2 ? 0.001 : 0.02;
    Recorded arm([&](pb::ArmEffects& e) { (e.mutable_backlash()->*kSet[j])(truth); });
    expect_found(half_loop(arm, j), truth, "play " + std::to_string(j));
  }
}

TEST(EffectsAreRecovered, PlayOfEachDisc) {
  const Eigen::Matrix4d discs = large_needle_driver().disc_coupling();
  using SetDisc = void (pb::DiscValues::*)(double);
  const std::array<SetDisc, 4> set = {&pb::DiscValues::set_roll, &pb::DiscValues::set_pitch,
                                      &pb::DiscValues::set_yaw, &pb::DiscValues::set_jaw};
  for (int disc = 0; disc < 4; ++disc) {
    const double truth = 0.01;
    const auto number = static_cast<std::size_t>(disc);
    Recorded arm([&](pb::ArmEffects& e) { (e.mutable_disc_backlash()->*set[number])(truth); });
    arm.move_to(kNear);
    const Sample there = arm.move_to(kRest).back();
    arm.move_to(kFar);
    const Sample back = arm.move_to(kRest).back();
    // Tip errors of all three wrist joints that this disc moves, by its column of the coupling.
    Vector3d by_disc = Vector3d::Zero();
    for (int joint = 0; joint < 3; ++joint) {
      by_disc +=
          discs(joint, disc) * tip_by_joint(there.measured, 3 + static_cast<std::size_t>(joint));
    }
    const double found = 0.5 * (back.tip - there.tip).dot(by_disc) / by_disc.squaredNorm();
    expect_found(std::abs(found), truth, "disc " + std::to_string(disc));
  }
}

TEST(EffectsAreRecovered, ComplianceOfEachJoint) {
  for (std::size_t j = 0; j < 6; ++j) {
    const double truth = j == 2 ? 2e-4 : 0.01;
    Recorded arm([&](pb::ArmEffects& e) { (e.mutable_joint_compliance()->*kSet[j])(truth); });
    arm.move_to(kRest);
    const Vector3d by_joint = tip_by_joint(kRest, j);
    const Vector3d force = 2 * by_joint.normalized();
    const double free = hidden(arm.under(Vector3d::Zero()), j);
    const double pulled = hidden(arm.under(force), j);
    expect_found((pulled - free) / force.dot(by_joint), truth, "compliance " + std::to_string(j));
  }
}

TEST(EffectsAreRecovered, ComplianceOfTheTipAndItsGrowthWithDepth) {
  const Vector3d truth(0.0005, 0.001, 0.0002);
  const double growth = 8;
  Recorded arm([&](pb::ArmEffects& e) {
    e.mutable_tip_compliance()->set_x(truth.x());
    e.mutable_tip_compliance()->set_y(truth.y());
    e.mutable_tip_compliance()->set_z(truth.z());
    e.set_compliance_depth_slope(growth);
  });
  std::array<Vector3d, 2> found;
  const std::array<double, 2> depths = {0.12, 0.2};
  for (std::size_t k = 0; k < depths.size(); ++k) {
    arm.move_to({0, 0, depths[k], 0, 0, 0});
    const Sample free = arm.under(Vector3d::Zero());
    found[k] = (arm.under({1, 1, 1}).tip - free.tip);
    arm.under(Vector3d::Zero());
  }
  for (int axis = 0; axis < 3; ++axis) {
    expect_found(found[0][axis], truth[axis], "tip " + std::to_string(axis));
    expect_found((found[1][axis] / found[0][axis] - 1) / 0.08, growth, "growth");
  }
}

TEST(EffectsAreRecovered, OffsetOfEachJoint) {
  for (std::size_t j = 0; j < 6; ++j) {
    const double truth = j == 2 ? 0.002 : 0.03;
    Recorded arm([&](pb::ArmEffects& e) { (e.mutable_joint_offset()->*kSet[j])(truth); });
    expect_found(hidden(arm.move_to(kRest).back(), j), truth, "offset " + std::to_string(j));
  }
}

TEST(EffectsAreRecovered, LengthOfTheTool) {
  const double truth = 0.003;
  Recorded arm([&](pb::ArmEffects& e) { e.set_tool_length_offset_m(truth); });
  const Sample rest = arm.move_to(kRest).back();
  const Vector3d along = psm_forward(rest.measured).R.col(2);
  expect_found((rest.tip - tip_place(rest.measured)).dot(along), truth, "length");
}

TEST(EffectsAreRecovered, CouplingOfTwoJoints) {
  const double truth = 0.05;
  Recorded arm([&](pb::ArmEffects& e) {
    pb::JointCoupling& coupling = *e.add_coupling();
    coupling.set_driven(pb::JOINT_WRIST_PITCH);
    coupling.set_driving(pb::JOINT_ROLL);
    coupling.set_slope(truth);
  });
  const Sample near = arm.move_to(kNear).back(), far = arm.move_to(kFar).back();
  const double slope = (hidden(far, 4) - hidden(near, 4)) / (far.measured[3] - near.measured[3]);
  expect_found(slope, truth, "coupling");
}

}  // namespace
}  // namespace omentum
