// Laws of the pad (scene.tool.grip, HOLD_PAD) on the elastic shell, and against that of the
// reference.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/check.h"
#include "sim_worker/shell/shell_jaws.h"
#include "support/effect_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::EffectCase;
using test::Model;

struct Pad {
  double stiffness = 0, give = 0, turn = 0;
  double half_x = 0.006, half_y = 0.0045;
  double lean = 0;
};

constexpr double kPeriod = 0.02;
const Vector3d kTip(0, 0.009, 0);
const Vector3d kWay(0.0005, -0.001, 0.006);

std::shared_ptr<const TissueModel> make_model(const Pad& pad, Model model = Model::kElastic) {
  EffectCase c;
  c.nx = c.ny = 13;
  c.anchor_max_y = -0.018;
  c.young = 3e4;
  c.poisson = 0.3;
  c.damping = 20;
  c.ex = c.ey = 12;
  c.effects.set_grasp_compliance_m_per_n(pad.give);
  c.effects.set_jaw_lean_deg(pad.lean);
  Scene scene = make_effect_scene(c, model);
  pb::Grip& grip = *scene.config.mutable_tool()->mutable_grip();
  grip.set_hold(pb::HOLD_PAD);
  grip.set_shape(pb::GRIP_RECTANGLE);
  grip.set_half_x_m(pad.half_x);
  grip.set_half_y_m(pad.half_y);
  grip.set_stiffness_n_per_m3(pad.stiffness);
  grip.set_turn_compliance_rad_per_n_m(pad.turn);
  scene.config.mutable_tool()->set_roll_deg(90);  // x_C along x_W
  std::vector<std::string> warnings;
  const std::vector<PinchCircle> pinches = {{kTip.head<2>(), pad.half_x}};
  return make_tissue_model(scene, kPeriod, warnings, pinches);
}

/// Taken at rest, moved in 20 steps and held until nothing moves.
template <typename Real>
std::unique_ptr<Tissue<Real>> lift_pad(const TissueModel& model, const LaneKernel<Real>& kernel,
                                       int steps = 120) {
  auto tissue = model.make_tissue(kernel);
  for (int lane = 0; lane < kernel.lanes; ++lane) {
    tissue->reset(lane, Vector3d::Zero());
    tissue->hold(lane, kTip, 0.006, false);
    EXPECT_FALSE(tissue->held(lane).empty());
  }
  for (int step = 0; step < steps; ++step) {
    const auto at = [&](int k) { return Vector3d(kTip + std::min(1.0, k / 20.0) * kWay); };
    const std::vector<ToolMotion> motion(static_cast<std::size_t>(kernel.lanes),
                                         ToolMotion{at(step), at(step + 1)});
    tissue->step(motion);
  }
  return tissue;
}

std::unique_ptr<Tissue<double>> lift_pad(const Pad& pad, Model model = Model::kElastic) {
  return lift_pad<double>(*make_model(pad, model), f64x1());
}

TEST(ShellPad, ARigidOneCarriesEveryPointUnderIt) {
  const auto model = make_model({});
  const auto tissue = lift_pad<double>(*model, f64x1());
  int covered = 0;
  for (int i = 0; i < tissue->particles(); ++i) {
    const Vector3d p = model->body.particles[static_cast<std::size_t>(i)];
    if (std::fabs(p.x()) > 0.0045 || std::fabs(p.y() - kTip.y()) > 0.0045) continue;
    EXPECT_LT((tissue->position(0, i) - p - kWay).norm(), 1e-7) << i;
    ++covered;
  }
  EXPECT_GE(covered, 9);
}

TEST(ShellPad, ALeanTurnsAllOfIt) {
  const auto model = make_model({.lean = 10});
  const auto tissue = lift_pad<double>(*model, f64x1());
  std::vector<std::pair<Vector3d, Vector3d>> points;  // at rest, now
  for (int i = 0; i < tissue->particles(); ++i) {
    const Vector3d p = model->body.particles[static_cast<std::size_t>(i)];
    if (std::fabs(p.x()) > 0.0045 || std::fabs(p.y() - kTip.y()) > 0.0045) continue;
    points.emplace_back(p, tissue->position(0, i));
  }
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(10 * 3.14159265358979 / 180, Vector3d::UnitY()).toRotationMatrix();
  for (const auto& [rest, now] : points) {
    EXPECT_LT((now - points[0].second - turn * (rest - points[0].first)).norm(), 1e-6);
  }
}

TEST(ShellPad, ItsBedAndItsGiveAreSpringsInSeries) {
  // Pulled in the plane: the sheet is a spring as well, linear at this stretch.
  const auto force = [](const Pad& pad) {
    const auto model = make_model(pad);
    auto tissue = model->make_tissue(f64x1());
    tissue->reset(0, Vector3d::Zero());
    LaneParameters weightless;
    weightless.gravity_scale = 0;
    tissue->set_parameters(0, weightless);
    tissue->hold(0, kTip, 0.006, false);
    const ToolMotion pull{kTip, kTip + Vector3d(0, 2e-4, 0)};
    tissue->step({&pull, 1});
    test::rest(*tissue, 4, pull.to);
    return tissue->held_force(0).norm();
  };
  const double rigid = force({});
  const double give = 2e-4 / rigid;  // as soft as the sheet
  EXPECT_NEAR(force({.give = give, .turn = 1e-6}) / (0.5 * rigid), 1, 1e-3);
  const double area = 4 * 0.006 * 0.0045;
  const double bed = 1 / (2 * area * give);                         // two faces
  EXPECT_NEAR(force({.stiffness = bed}) / (0.5 * rigid), 1, 0.12);  // the bed shears
}

TEST(ShellPad, ATurnFollowsTheMoment) {
  // Stiff jaws turn as rigid ones; the softer they are, the more the sheet turns them.
  const auto slope = [](double turn) {
    const auto tissue = lift_pad({.turn = turn, .lean = 5});
    const Vector3d across = tissue->position(0, 13 * 7 + 9) - tissue->position(0, 13 * 5 + 9);
    return std::atan2(-across.z(), across.x());
  };
  const double rigid = slope(0);
  EXPECT_NEAR(slope(1e-4) / rigid, 1, 1e-4);
  const double once = std::fabs(slope(200) - rigid);
  EXPECT_GT(once, 1e-3);
  EXPECT_GT(std::fabs(slope(400) - rigid), 1.2 * once);
}

TEST(ShellPad, MovesSmoothlyWithItsSize) {
  // A rim that passes a row of nodes: no jump of the force.
  std::vector<double> force;
  for (const double half : {0.0044, 0.0045, 0.0046, 0.0074, 0.0075, 0.0076})
    force.push_back(lift_pad({.half_x = half})->held_force(0).norm());
  for (const std::size_t k : {0U, 3U}) {
    const double bend = std::fabs(force[k] - 2 * force[k + 1] + force[k + 2]);
    EXPECT_LT(bend, 0.5 * std::fabs(force[k + 2] - force[k]) + 1e-3 * force[k]) << k;
  }
}

TEST(ShellPad, LanesAndWidthsAgreeToTheBitAndTheStateTravels) {
  const auto model = make_model({.give = 1e-3, .lean = 3});
  const auto alone = lift_pad<float>(*model, f32x1(), 30);
  const auto eight = lift_pad<float>(*model, f32x8(), 30);
  for (int lane = 0; lane < 8; ++lane) EXPECT_EQ(eight->hash(lane), alone->hash(0)) << lane;
  Bytes state;
  alone->save(0, state);
  const auto resumed = model->make_tissue(f32x1());
  const Result<std::size_t> used = resumed->load(0, state);
  ASSERT_TRUE(used.has_value()) << used.error();
  EXPECT_EQ(used.value(), state.size());
  EXPECT_EQ(resumed->hash(0), alone->hash(0));
  const ToolMotion on{kTip + kWay, kTip + 1.1 * kWay};
  resumed->step({&on, 1});
  alone->step({&on, 1});
  EXPECT_EQ(resumed->hash(0), alone->hash(0));
  EXPECT_FALSE(resumed->load(0, std::span(state).first(state.size() - 1)).has_value());
}

TEST(ShellPad, AgreesWithThatOfTheReference) {
  const auto shell = lift_pad({});
  const auto reference = lift_pad({}, Model::kReference);
  double squares = 0;
  for (int i = 0; i < shell->particles(); ++i)
    squares += (shell->position(0, i) - reference->position(0, i)).squaredNorm();
  const double rms = std::sqrt(squares / shell->particles());
  const double force = shell->held_force(0).norm() / reference->held_force(0).norm();
  std::printf("# shell pad against the reference's: %.4f mm rms, force %.4f\n", 1e3 * rms, force);
  EXPECT_LT(rms, 8e-4);  // docs/results/tissue.md; the shell has cells of half the pad's size
  EXPECT_NEAR(force, 1, 0.12);
}

TEST(ShellJaws, ThatTurnFreelyHoldNothingThatIsOnlyTurned) {
  ShellJaws::Rows rows;
  rows.node = {0, 1, 2, 3};
  rows.weight = Eigen::MatrixXd::Identity(4, 4);
  rows.place = Eigen::VectorXd::Ones(4);
  rows.compliance = Eigen::VectorXd::Zero(4);
  rows.turn_stiffness = 1e-12 * Eigen::Matrix3d::Identity();
  rows.arm.resize(3, 4);
  rows.arm << -0.006, -0.006, 0.006, 0.006, -0.006, 0.006, -0.006, 0.006, 0, 0, 0, 0;
  const Eigen::MatrixXd response = 0.1 * Eigen::MatrixXd::Identity(4, 4);  // [m/N]
  const Vector3d axis = Vector3d(1, -2, 0.5).normalized();
  for (const double angle : {0.3, 1.2, 2.0, 2.8}) {
    ShellJaws jaws(rows, response);
    jaws.hold(Eigen::AngleAxisd(angle, axis).toRotationMatrix() * rows.arm);
    EXPECT_LT(jaws.force().cwiseAbs().maxCoeff(), 1e-8) << "turned by " << angle;
  }
}

TEST(ShellPad, OfASolidIsRefused) {
  EffectCase c;
  Scene scene = make_effect_scene(c, Model::kElastic);
  scene.config.mutable_tool()->mutable_grip()->set_hold(pb::HOLD_PAD);
  scene.config.mutable_tissue()->set_model(pb::TISSUE_CLUSTER);
  std::vector<std::string> warnings;
  EXPECT_THROW(make_tissue_model(scene, kPeriod, warnings), Error);
}

}  // namespace
}  // namespace omentum
