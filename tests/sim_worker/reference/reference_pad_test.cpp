// Laws of the grip that is a pad (scene.tool.grip, docs/tissue.md 13).
#include <gmock/gmock.h>

#include "core/check.h"
#include "support/reference_scene.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

struct PadCase {
  double stiffness = 0, compliance = 0, turn = 0;
  bool rectangle = true;
  Vector3d tip = Vector3d(0, 0.012, 0);
  double half_x = 0.006, half_y = 0.003;
  Eigen::Vector2d displaced = Eigen::Vector2d::Zero();
};

std::shared_ptr<const ReferenceTissueModel> make_pad_model(const PadCase& c) {
  ReferenceCase sheet;
  sheet.nx = 11;
  sheet.ny = 11;
  sheet.anchor = -0.015;
  sheet.ex = sheet.ey = 10;
  sheet.young = 2e4;
  sheet.poisson = 0.3;
  sheet.damping = 20;
  Scene scene = make_reference_scene(sheet);
  pb::Grip& grip = *scene.config.mutable_tool()->mutable_grip();
  grip.set_hold(pb::HOLD_PAD);
  grip.set_shape(c.rectangle ? pb::GRIP_RECTANGLE : pb::GRIP_DISC);
  grip.set_half_x_m(c.half_x);
  grip.set_half_y_m(c.half_y);
  grip.set_stiffness_n_per_m3(c.stiffness);
  grip.set_turn_compliance_rad_per_n_m(c.turn);
  scene.config.mutable_tool()->set_roll_deg(90);  // x_C along x_W
  scene.config.mutable_tissue()->mutable_effects()->set_grasp_compliance_m_per_n(c.compliance);
  std::vector<std::string> warnings;
  const std::vector<PinchCircle> pinches = {{c.tip.head<2>() + c.displaced, 0.006, c.displaced}};
  return make_reference_model(scene, 0.02, warnings, pinches);
}

struct Lifted {
  std::shared_ptr<const ReferenceTissueModel> model;
  std::unique_ptr<ReferenceTissue> tissue;
  std::vector<Vector3d> before;  ///< nodes when the pad closed
  Vector3d way = Vector3d(0, -0.001, 0.004);
};

/// Taken at rest in the plane, lifted in 10 steps and held until nothing moves.
Lifted lift_pad(const PadCase& c, double radius = 0.006) {
  Lifted l;
  l.model = make_pad_model(c);
  l.tissue = std::make_unique<ReferenceTissue>(l.model);
  l.tissue->reset(0, Vector3d::Zero());
  l.before = l.tissue->node_positions();
  l.tissue->hold(0, c.tip, radius, false);
  EXPECT_FALSE(l.tissue->held(0).empty());
  for (int step = 0; step < 60; ++step) {
    const auto at = [&](int k) { return Vector3d(c.tip + std::min(1.0, k / 10.0) * l.way); };
    const ToolMotion motion{at(step), at(step + 1)};
    l.tissue->step({&motion, 1});
  }
  EXPECT_TRUE(l.tissue->healthy(0)) << l.tissue->failure(0);
  return l;
}

TEST(ReferencePad, TakesItsGridLinesAlongWhereItIsDisplacedAsManyAsBeforeAndNoneJumps) {
  PadCase inside;  // no side of it on the edge of the sheet
  inside.tip.y() = 0.008;
  const auto before = make_pad_model(inside);
  for (const double by : {1e-5, 1e-4, 5e-4, 2e-3}) {
    for (const Eigen::Vector2d& displaced : {Eigen::Vector2d(by, 0), Eigen::Vector2d(-by, -by)}) {
      PadCase c = inside;
      c.displaced = displaced;
      const auto model = make_pad_model(c);
      for (const int axis : {0, 1}) {
        const std::vector<double>&lines = model->lines[axis], &was = before->lines[axis];
        ASSERT_EQ(lines.size(), was.size());
        for (std::size_t k = 0; k < lines.size(); ++k)
          EXPECT_NEAR(lines[k], was[k], 2 * by) << axis << " " << k << " by " << by;
        // What lay on a side of the pad still does.
        const double half = axis == 0 ? c.half_x : c.half_y;
        int on_sides = 0;
        for (std::size_t k = 0; k < lines.size(); ++k) {
          if (std::fabs(std::fabs(was[k] - c.tip[axis]) - half) > 1e-9) continue;
          EXPECT_NEAR(lines[k], was[k] + displaced[axis], 1e-12) << axis << " " << k;
          ++on_sides;
        }
        EXPECT_GE(on_sides, 1) << axis;
      }
    }
  }
}

double largest_difference(const Lifted& a, const Lifted& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.before.size(); ++i) {
    largest =
        std::max(largest, (a.tissue->node_positions()[i] - b.tissue->node_positions()[i]).norm());
  }
  return largest;
}

TEST(GripPad, HoldsEveryNodeOfBothFacesUnderTheRectangleAndNoOther) {
  const auto model = make_pad_model({});
  const GraspPad pad = model->make_pad({0, 0.012}, 0.006);
  double area = 0;
  for (const double a : pad.area) area += a;
  EXPECT_NEAR(area, 4 * 0.006 * 0.003, 1e-12);
  std::size_t under = 0;
  for (std::size_t i = 0; i < model->nodes.size(); ++i) {
    const Vector3d& p = model->nodes[i];
    if (p.z() < 0 && std::fabs(p.x()) < 0.006 + 1e-9 && std::fabs(p.y() - 0.012) < 0.003 + 1e-9)
      ++under;
  }
  EXPECT_EQ(pad.lower.size(), under);
  EXPECT_GE(under, 9U);
}

TEST(GripPad, RigidOneMovesEveryNodeWithTheTip) {
  for (const bool rectangle : {false, true}) {
    PadCase c;
    c.rectangle = rectangle;
    const Lifted l = lift_pad(c);
    const GraspPad pad = l.model->make_pad(c.tip.head<2>(), 0.006);
    for (const auto* nodes : {&pad.lower, &pad.upper}) {
      for (const int i : *nodes) {
        const Vector3d moved = l.tissue->node_positions()[i] - l.before[i];
        EXPECT_LT((moved - l.way).norm(), 1e-6) << rectangle;  // the task of a rigid pad: 1 um
      }
    }
  }
}

TEST(GripPad, CompliantOneTendsToTheRigidOneAsItsStiffnessGrows) {
  const Lifted rigid = lift_pad({});
  PadCase c;
  c.stiffness = 1e8;
  const double soft = largest_difference(lift_pad(c), rigid);
  c.stiffness = 1e9;
  const double stiff = largest_difference(lift_pad(c), rigid);
  EXPECT_GT(stiff, 1e-7);
  EXPECT_NEAR(soft / stiff, 10, 1);  // first order in 1 / k
}

TEST(GripPad, WithoutComplianceIsTheLimitOfASmallOne) {
  const Lifted rigid = lift_pad({});
  PadCase c;
  c.compliance = 1e-6;
  c.turn = 1e-2;
  const double small = largest_difference(lift_pad(c), rigid);
  c.compliance = 1e-7;
  c.turn = 1e-3;
  const double smaller = largest_difference(lift_pad(c), rigid);
  EXPECT_GT(smaller, 1e-9);
  EXPECT_NEAR(small / smaller, 10, 1);
}

TEST(GripPad, TurnsByMomentTimesComplianceAndGivesWayByForceTimesCompliance) {
  for (const double turn : {0.0, 20.0}) {
    PadCase c;
    c.compliance = 2e-3;
    c.turn = turn;
    const Lifted l = lift_pad(c);
    const GraspPad pad = l.model->make_pad(c.tip.head<2>(), 0.006);
    // The rigid motion of the pad from its nodes: mean, and the turn about x from the rows of y.
    Vector3d mean = Vector3d::Zero();
    double sum = 0;
    double gyration = 0;
    for (std::size_t k = 0; k < pad.area.size(); ++k) {
      for (const int i : {pad.lower[k], pad.upper[k]})
        mean += 0.5 * pad.area[k] * (l.tissue->node_positions()[i] - l.before[i] - l.way);
      sum += pad.area[k];
      gyration += pad.area[k] * std::pow(l.before[pad.lower[k]].y() - c.tip.y(), 2);
    }
    mean /= sum;
    gyration /= sum;
    const Vector3d force = l.tissue->held_force(0);
    EXPECT_LT((mean - c.compliance * force).norm(), 1e-7);
    const Vector3d moment = l.tissue->held_moment() - mean.cross(force);  // about the centre
    double low = 0;
    double high = 0;
    for (const int i : pad.lower) {
      if (std::fabs(l.before[i].x()) > 1e-9) continue;
      if (std::fabs(l.before[i].y() - 0.009) < 1e-9) low = l.tissue->node_positions()[i].z();
      if (std::fabs(l.before[i].y() - 0.015) < 1e-9) high = l.tissue->node_positions()[i].z();
    }
    const double angle = std::asin((high - low) / 0.006);
    EXPECT_GT(std::fabs(angle), 0.002);
    const double about_x = turn > 0 ? turn : c.compliance / gyration;
    EXPECT_NEAR(angle, about_x * moment.x(), 1e-3 * std::fabs(angle)) << turn;
    // Lifted on its axis of symmetry.
    EXPECT_LT(std::fabs(moment.y()) + std::fabs(moment.z()), 1e-6 * std::fabs(moment.x()));
  }
}

TEST(GripPad, BearsTheForceAndMomentOfAFreeSheetAtRest) {
  PadCase c;
  c.tip = Vector3d(0.003, 0.0, 0);
  const auto model = [&] {
    ReferenceCase sheet;
    sheet.nx = sheet.ny = 7;
    sheet.anchor = -1;  // nothing clamped
    sheet.ex = sheet.ey = 6;
    sheet.young = 1e5;
    sheet.damping = 40;
    Scene scene = make_reference_scene(sheet);
    scene.config.mutable_tool()->mutable_grip()->set_hold(pb::HOLD_PAD);
    std::vector<std::string> warnings;
    return make_reference_model(scene, 0.02, warnings, {});
  }();
  ReferenceTissue tissue(model);
  tissue.reset(0, Vector3d::Zero());
  tissue.hold(0, c.tip, 0.004, false);
  for (int step = 0; step < 100; ++step) {
    const ToolMotion still{c.tip, c.tip};
    tissue.step({&still, 1});
  }
  ASSERT_TRUE(tissue.healthy(0)) << tissue.failure(0);
  Vector3d moment = Vector3d::Zero();
  for (std::size_t i = 0; i < model->nodes.size(); ++i) {
    moment +=
        (tissue.node_positions()[i] - c.tip).cross(Vector3d(0, 0, -model->mass[i] * kGravity));
  }
  const double weight = model->total_mass * kGravity;
  EXPECT_LT((tissue.held_force(0) - Vector3d(0, 0, -weight)).norm(), 1e-6 * weight);
  EXPECT_LT((tissue.held_moment() - moment).norm(), 1e-5 * moment.norm());
}

TEST(GripPad, SavedStateGoesOnAsIfNothingHadHappened) {
  PadCase c;
  c.compliance = 2e-3;
  Lifted l = lift_pad(c);
  Bytes state;
  l.tissue->save(0, state);
  ReferenceTissue resumed(l.model);
  const Result<std::size_t> used = resumed.load(0, state);
  ASSERT_TRUE(used.has_value()) << used.error();
  EXPECT_EQ(used.value(), state.size());
  const Vector3d top = c.tip + l.way;
  const ToolMotion on{top, top + Vector3d(0, 0, 0.0005)};
  l.tissue->step({&on, 1});
  resumed.step({&on, 1});
  EXPECT_EQ(resumed.hash(0), l.tissue->hash(0));
  EXPECT_FALSE(resumed.load(0, std::span(state).first(state.size() - 1)).has_value());
}

TEST(GripPad, IsRefusedInOneLineWhereItCannotBe) {
  Scene scene = make_reference_scene({});
  scene.config.mutable_tool()->mutable_grip()->set_shape(pb::GRIP_RECTANGLE);
  EXPECT_THAT([&] { make_surroundings(scene); },
              testing::ThrowsMessage<Error>(testing::HasSubstr("allowed there: GRIP_DISC")));
  scene.config.mutable_tool()->mutable_grip()->set_hold(pb::HOLD_PAD);
  scene.config.mutable_tissue()->set_model(pb::TISSUE_CLUSTER);
  EXPECT_THAT([&] { make_surroundings(scene); },
              testing::ThrowsMessage<Error>(testing::HasSubstr("allowed there: HOLD_MEAN")));
}

}  // namespace
}  // namespace omentum
