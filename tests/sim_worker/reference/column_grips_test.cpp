// Forward sensitivities of the reference where a pad holds it, an obstacle is in its way, or it
// begins to move.
#include <gmock/gmock.h>

#include <cstdlib>

#include "core/check.h"
#include "support/column_lift.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

pb::Grip make_pad(double bed, double turn) {
  pb::Grip grip;
  grip.set_hold(pb::HOLD_PAD);
  grip.set_shape(pb::GRIP_RECTANGLE);
  grip.set_half_x_m(0.004);
  grip.set_half_y_m(0.005);
  grip.set_stiffness_n_per_m3(bed);
  grip.set_turn_compliance_rad_per_n_m(turn);
  return grip;
}

/// Rigid, and on a bed while it gives way and turns, by its size or by a stated compliance.
std::vector<Lift> pad_lifts() {
  Lift rigid{"pad"};
  rigid.pad = make_pad(0, 0);
  Lift soft{"soft pad"};
  soft.pad = make_pad(2e8, 0);
  soft.effects = [](pb::TissueEffects& e) { e.set_grasp_compliance_m_per_n(5e-3); };
  Lift turning{"turning"};
  turning.pad = make_pad(0, 300);
  turning.effects = [](pb::TissueEffects& e) { e.set_jaw_lean_deg(5); };
  return {rigid, soft, turning};
}

TEST(Columns, OfAPadAreItsDifferences) {
  const bool all = std::getenv("OMENTUM_ALL_COLUMNS") != nullptr;  // NOLINT(concurrency-mt-unsafe)
  for (const Lift& lift : pad_lifts()) {
    std::vector<Named> named;
    for (Named n : all_parameters()) {
      const bool of_place = n.name == "grasp_offset" || n.name == "grasp_slip";
      if (n.needs_board || of_place) continue;
      // On top of what the base gives way: the difference is of that.
      if (lift.effects != nullptr && (n.name == "jaw_lean" || n.name == "grasp_turn")) continue;
      if (n.name == "grasp_compliance") {
        const double base = std::string(lift.name) == "soft pad" ? 5e-3 : 0;
        n = of_effect("grasp_compliance", base > 0 ? 1e-4 : 1e-5, nullptr);
        n.change = [base](double d) {
          Change c;
          c.of_effects = [=](pb::TissueEffects& e) { e.set_grasp_compliance_m_per_n(base + d); };
          return c;
        };
        n.one_sided = base == 0;
      }
      const std::vector<std::string> few = {"young_modulus", "gravity_tilt", "jaw_tilt",
                                            "grasp_compliance"};
      if (all || std::ranges::find(few, n.name) != few.end()) named.push_back(n);
    }
    expect_columns(lift, named, 0.01);
  }
}

TEST(Columns, OfForceAndMomentOnAPadAreTheirDifferences) {
  for (const Lift& lift : pad_lifts()) {
    const auto wrench = [&](const Change& change) {
      ReferenceTissue tissue(make_sheet(lift, change));
      run(lift, change, tissue, [] {});
      VectorXd values = VectorXd::Zero(6);
      for (int axis = 0; axis < 3; ++axis) {
        values[axis] = tissue.held_force(0)[axis];
        values[3 + axis] = tissue.held_moment()[axis];
      }
      return values;
    };
    const auto model = make_sheet(lift, {});
    std::vector<Named> named;
    for (const Named& n : all_parameters()) {
      if (n.name == "young_modulus" || n.name == "jaw_roll" || n.name == "delay")
        named.push_back(n);
    }
    std::vector<ColumnParameter> parameters;
    for (const Named& n : named) {
      parameters.push_back(n.parameter);
      if (n.parameter.kind != ColumnKind::kScene) continue;
      parameters.back().step = 1e-3 * n.step;
      parameters.back().changed = make_sheet(lift, n.change(1e-3 * n.step), model.get());
    }
    ReferenceTissue tissue(model);
    tissue.carry_columns(parameters);
    run(
        lift, {}, tissue, [] {},
        [&](int step) {
          Eigen::Matrix3Xd from = Eigen::Matrix3Xd::Zero(3, 3);
          Eigen::Matrix3Xd to = from;
          if (step > 0) from.col(2) = named[2].tip(lift, step);
          to.col(2) = named[2].tip(lift, step + 1);
          tissue.set_tip_columns(from, to);
        });
    ASSERT_TRUE(tissue.columns()->valid) << tissue.columns()->reason;
    for (std::size_t k = 0; k < named.size(); ++k) {
      const VectorXd expected =
          (wrench(named[k].change(named[k].step)) - wrench(named[k].change(-named[k].step))) /
          (2 * named[k].step);
      const VectorXd column =
          tissue.columns()->multiplier.col(static_cast<Eigen::Index>(k)).head<6>();
      EXPECT_LT((column - expected).head<3>().norm(), 0.01 * expected.head<3>().norm())
          << lift.name << " " << named[k].name;
      EXPECT_LT((column - expected).tail<3>().norm(), 0.01 * expected.tail<3>().norm())
          << lift.name << " " << named[k].name;
    }
  }
}

/// Of a wide sphere above, which the sheet meets as it rises; damped so that it does not bounce.
Lift under_sphere() {
  Lift lift{"obstacle"};
  lift.way = Vector3d(-0.003, -0.006, 0.014);
  lift.damping = 40;
  lift.obstacle.emplace();
  lift.obstacle->size.setConstant(0.03);
  lift.obstacle->X_WS.translation() = Vector3d(0.012, 0.012, 0.0365);
  return lift;
}

TEST(Columns, OfAnObstacleThatBeginsToPressIsThatOfASoftOne) {
  const RigidShape sphere = *under_sphere().obstacle;
  Named press{"press",
              [&](double d) {
                Change c;
                c.of_case = [=](ReferenceCase& r) { r.bodies.push_back(sphere); };
                c.of_scene = [=](pb::Tissue& t) {
                  t.mutable_reference()->set_contact_stiffness_pa_per_m(d);
                };
                return c;
              },
              1};
  press.one_sided = true;
  press.parameter.kind = ColumnKind::kObstacle;
  press.parameter.centre = sphere.X_WS.translation();
  press.parameter.radius = sphere.size.x();
  Lift lift = under_sphere();
  lift.name = "no obstacle";
  lift.obstacle.reset();
  expect_columns(lift, {press}, 0.01);
}

/// Spheres that the held patch is lifted against with 2 - 5 N: crushed tissue that is stable only
/// because it is held.
TEST(Columns, OfAnObstacleAreItsDifferences) {
  const std::vector<Named> named = {
      young(),
      of_case("radius", 1e-6, [](ReferenceCase& c, double d) { c.bodies[0].size.array() += d; }),
      of_case("height", 1e-6,
              [](ReferenceCase& c, double d) { c.bodies[0].X_WS.translation().z() += d; }),
  };
  for (const auto& [name, radius] :
       {std::pair("8 mm", 0.008), std::pair("12 mm", 0.012), std::pair("30 mm", 0.03)}) {
    Lift lift = under_sphere();
    lift.name = name;
    lift.obstacle->size.setConstant(radius);
    lift.obstacle->X_WS.translation().z() = 0.0065 + radius;
    if (radius > 0.02) lift.way.z() = 0.009;  // further up it snaps to another shape
    expect_columns(lift, named, 0.01);
  }
}

TEST(Columns, OfTheVelocityAtTheStartAreItsDifferences) {
  std::vector<Named> named;
  for (int axis = 0; axis < 3; ++axis) {
    named.push_back({std::string("start ") + "xyz"[axis],
                     [axis](double d) {
                       Change c;
                       c.start[axis] = d;
                       return c;
                     },
                     1e-3});
    named.back().parameter.kind = ColumnKind::kStartVelocity;
    named.back().parameter.axis = axis;
  }
  Lift lift{"start", false, 6e4, Vector3d(-0.003, -0.006, 0.02), 5};
  expect_columns(lift, named, 0.01);
}

TEST(Columns, OfAPadThatAreNoneAreRefused) {
  const Lift rigid = pad_lifts().front();
  Lift soft = pad_lifts()[1];
  const auto refuse = [](const Lift& lift, void (*set)(pb::TissueEffects&, double)) {
    const auto model = make_sheet(lift, {});
    ColumnParameter p;
    p.step = 1e-7;
    p.changed = make_sheet(lift, of_effect("", 1, set).change(1e-7), model.get());
    ReferenceTissue(model).carry_columns({p});
  };
  EXPECT_THAT(
      [&] {
        refuse(rigid, [](pb::TissueEffects& e, double d) { e.mutable_grasp_offset()->set_x_m(d); });
      },
      testing::ThrowsMessage<Error>(testing::HasSubstr("place and size of a pad")));
  EXPECT_THAT(
      [&] {
        refuse(soft, [](pb::TissueEffects& e, double d) { e.set_grasp_turn_rad_per_n_m(d); });
      },
      testing::ThrowsMessage<Error>(testing::HasSubstr("the pad turns already")));
}

}  // namespace
}  // namespace omentum
