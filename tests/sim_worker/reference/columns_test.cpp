// Forward sensitivities of the reference against central differences of itself.
#include <gtest/gtest.h>

#include <cstdlib>

#include "core/check.h"
#include "support/column_lift.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

/// OMENTUM_ALL_COLUMNS=1: every parameter on every lift, the table of decision 0029 (10 min).
TEST(Columns, AreTheDifferencesOfTheSimulation) {
  const bool all = std::getenv("OMENTUM_ALL_COLUMNS") != nullptr;  // NOLINT(concurrency-mt-unsafe)
  std::vector<Lift> lifts = {{"air", false, 6e4},
                             {"board", true, 6e4, Vector3d(-0.003, -0.006, 0.02), 3}};
  if (all) {
    lifts.push_back({"air soft", false, 2e4});
    lifts.push_back({"air stiff", false, 1.5e5});
    lifts.push_back({"tug", true, 6e4, Vector3d(-0.006, -0.004, 0.002), 3, 18});
  }
  const std::vector<std::string> on_board = {"young_modulus", "gravity_tilt", "adhesion",
                                             "suction",       "slip_speed",   "grasp_offset",
                                             "delay",         "density"};
  for (const Lift& lift : lifts) {
    std::vector<Named> named;
    for (Named& n : all_parameters()) {
      if (n.needs_board && !lift.board) continue;
      if (all || !lift.board || std::ranges::find(on_board, n.name) != on_board.end())
        named.push_back(n);
    }
    const MatrixXd s = columns(lift, named);
    const VectorXd base = surface(lift, {});
    std::vector<double> scales = {1};
    if (lift.board)
      scales = all ? std::vector<double>{0.3, 1, 3, 10, 30} : std::vector{1.0, 3.0, 10.0};
    for (std::size_t k = 0; k < named.size(); ++k) {
      const Difference expected = difference(lift, named[k], base, scales);
      const VectorXd column = s.col(static_cast<Eigen::Index>(k));
      ASSERT_EQ(column.size(), expected.value.size());
      const double error = (column - expected.value).norm() / expected.value.norm();
      std::printf("# %-10s %-18s %9.4f %% (another step %9.4f %%)\n", lift.name,
                  named[k].name.c_str(), 100 * error, 100 * expected.change);
      const double own = all ? 2 * expected.change : 0;  // of the difference
      EXPECT_LT(error, std::max(lift.board ? 0.05 : 0.01, own))
          << lift.name << " " << named[k].name;
    }
  }
}

TEST(Columns, OfABaseWithEffectsOnAreItsDifferences) {
  Lift lift{"effects on"};
  lift.effects = [](pb::TissueEffects& e) {
    e.set_grasp_turn_rad_per_n_m(300);
    e.set_jaw_lean_deg(8);
    e.set_exponential_stiffening(10);
    e.mutable_added_mass()->set_mass_kg(5e-4);
    auto& inclusion = *e.add_inclusion();
    inclusion.set_x_m(-0.004);
    inclusion.set_radius_m(0.008);
    inclusion.set_stiffness_change(2);
    auto& force = *e.mutable_local_force();
    force.set_strength(1);
    force.set_x_m(-0.01);
    force.set_radius_m(0.006);
    force.set_stiffness_n_per_m(2);
    force.set_anchor_x_m(-0.01);
    force.set_anchor_z_m(-0.004);
    force.set_damper_n_s_per_m(0.05);
    force.set_push_z_n(2e-3);
    force.set_decay_s(0.3);
  };
  std::vector<Named> named = {
      of_case("young_modulus", 600, [](test::ReferenceCase& c, double d) { c.young += d; }),
      of_effect("turn", 3,
                [](pb::TissueEffects& e, double d) { e.set_grasp_turn_rad_per_n_m(300 + d); }),
      of_effect("lean", 0.1, [](pb::TissueEffects& e, double d) { e.set_jaw_lean_deg(8 + d); }),
      of_effect("b", 0.1,
                [](pb::TissueEffects& e, double d) { e.set_exponential_stiffening(10 + d); }),
      of_effect(
          "added_mass", 5e-6,
          [](pb::TissueEffects& e, double d) { e.mutable_added_mass()->set_mass_kg(5e-4 + d); }),
      of_effect(
          "inclusion_x", 1e-5,
          [](pb::TissueEffects& e, double d) { e.mutable_inclusion(0)->set_x_m(-0.004 + d); }),
      of_effect(
          "force_strength", 1e-2,
          [](pb::TissueEffects& e, double d) { e.mutable_local_force()->set_strength(1 + d); }),
      of_effect("force_damper", 5e-4, [](pb::TissueEffects& e, double d) {
        e.mutable_local_force()->set_damper_n_s_per_m(0.05 + d);
      })};
  for (const Named& n : all_parameters()) {
    if (n.name == "gravity_tilt" || n.name == "tip_offset_x" || n.name == "delay")
      named.push_back(n);
  }
  expect_columns(lift, named, 0.01);
}

Named density() {
  return of_effect("density", 1e-2,
                   [](pb::TissueEffects& e, double d) { e.set_density_change(d); });
}

Named stiffness_of(double x, double y, double radius) {
  Named n;
  n.parameter.kind = ColumnKind::kStiffnessSite;
  n.parameter.place = {x, y};
  n.parameter.radius = radius;
  return n;
}

TEST(Columns, LeaveTheBaseAloneToTheBit) {
  const Lift lift;
  const auto model = make_sheet(lift, {});
  ReferenceTissue plain(model);
  run(lift, {}, plain, [] {});
  std::uint64_t hash = 0;
  columns(lift, {young(), stiffness_of(0, 0, 0.01)}, &hash);
  EXPECT_EQ(hash, plain.hash(0));
}

TEST(Columns, OfAPlaceThatCoversTheSheetIsThatOfItsModulus) {
  const Lift lift;
  const MatrixXd s = columns(lift, {young(), stiffness_of(0, 0, 1)});
  EXPECT_LT((s.col(1) - lift.young * s.col(0)).norm(), 1e-6 * s.col(1).norm());
}

TEST(Columns, PermutedParametersGivePermutedColumns) {
  const Lift lift;
  const Named place = stiffness_of(0.003, 0.004, 0.008);
  const MatrixXd one = columns(lift, {young(), place, density()});
  const MatrixXd other = columns(lift, {density(), young(), place});
  EXPECT_LT((one.col(0) - other.col(1)).norm(), 1e-12 * one.col(0).norm());
  EXPECT_LT((one.col(1) - other.col(2)).norm(), 1e-12 * one.col(1).norm());
  EXPECT_LT((one.col(2) - other.col(0)).norm(), 1e-12 * one.col(2).norm());
}

TEST(Columns, OfSitesAreThoseOfTheirEffects) {
  const Lift lift;
  Named site;
  site.parameter.kind = ColumnKind::kDensitySite;
  site.parameter.radius = 1;
  const MatrixXd s = columns(lift, {density(), site});
  EXPECT_LT((s.col(1) - s.col(0)).norm(), 1e-6 * s.col(0).norm());
}

TEST(Columns, ForceOfASiteIsThatOfAWeightSpreadThere) {
  // A load along -z over the whole sheet, of the sheet's weight, is a doubled density but for its
  // inertia: the same in a state at rest.
  Lift lift;
  lift.young = 2e5;
  const auto model = make_sheet(lift, {});
  ColumnParameter heavier;
  heavier.step = 1e-5;
  heavier.changed = make_sheet(lift, density().change(1e-5), model.get());
  ColumnParameter force;
  force.kind = ColumnKind::kForceSite;
  force.radius = 1;
  ReferenceTissue tissue(model);
  tissue.carry_columns({heavier, force});
  tissue.settle(Vector3d::UnitZ());
  double free = 0;
  for (std::size_t i = 0; i < model->nodes.size(); ++i) free += model->mass[i];
  const double weight = free * test::kGravity;
  const Eigen::Matrix3Xd tip = tissue.point_columns(model->particle_points.back());
  EXPECT_NEAR(-weight * tip(2, 1) / tip(2, 0), 1, 1e-3);
}

TEST(Columns, ComeToRestWithTheTissue) {
  const auto settled = [](double change) {
    auto tissue = std::make_unique<ReferenceTissue>(make_sheet({}, young().change(change)));
    EXPECT_LE(tissue->settle(Vector3d::UnitZ()), 1e-5);
    return tissue;
  };
  ColumnParameter modulus;
  modulus.step = 1;
  const auto model = make_sheet({}, {});
  modulus.changed = make_sheet({}, young().change(1), model.get());
  ReferenceTissue tissue(model);
  tissue.carry_columns({modulus});
  ASSERT_LE(tissue.settle(Vector3d::UnitZ()), 1e-5);
  const std::vector<Vector3d> rest = tissue.node_positions();
  const auto stiffer = settled(100);
  const auto softer = settled(-100);
  double difference = 0;
  double error = 0;
  for (const BodyPoint& point : model->particle_points) {
    const Vector3d d = (stiffer->point(point) - softer->point(point)) / 200;
    difference += d.squaredNorm();
    error += (tissue.point_columns(point).col(0) - d).squaredNorm();
  }
  EXPECT_LT(std::sqrt(error), 1e-3 * std::sqrt(difference));
  EXPECT_LT(tissue.position(0, 16 * 16 - 1).z(), -0.01) << "it hangs";
  // At rest it stays: a second moves no node by 0.01 mm.
  test::run(tissue, 50);
  for (std::size_t i = 0; i < rest.size(); ++i)
    EXPECT_LT((tissue.node_positions()[i] - rest[i]).norm(), 1e-5) << i;
}

TEST(Columns, OfASheetDrapedOverABodyAreNearItsDifferences) {
  // A step that converged in its last iteration was taken with limits of friction that were not
  // those of its contacts. So differences of shapes at rest were 4.2 mm per unit of bending, for
  // 0.7, and columns meters: softer contact, or a face elsewhere, changes normal forces by
  // thousands of times what they are until the sheet gives way. Rest under friction still depends a
  // little on the steps that lead there.
  Lift lift;
  lift.young = 700;
  lift.obstacle = RigidShape{};
  lift.obstacle->X_WS.translation() = Vector3d(0.002, 0.012, -0.014);
  lift.obstacle->size.setConstant(0.01);
  const auto changed = [](double stiffness, double bending) {
    Change change;
    change.of_case = [](ReferenceCase& c) { c.static_friction = c.dynamic_friction = 0.3; };
    change.of_scene = [=](pb::Tissue& t) {
      pb::ReferenceModel& numerics = *t.mutable_reference();
      numerics.clear_friction_slip_speed_m_per_s();
      numerics.set_contact_stiffness_pa_per_m(2e8 * (1 + stiffness));
      t.mutable_effects()->set_bending_change(bending);
    };
    return change;
  };
  const auto model = make_sheet(lift, changed(0, 0));
  ColumnParameter contact;
  ColumnParameter bending;
  contact.step = bending.step = 1e-6;
  contact.changed = make_sheet(lift, changed(1e-6, 0), model.get());
  bending.changed = make_sheet(lift, changed(0, 1e-6), model.get());
  ReferenceTissue tissue(model);
  tissue.carry_columns({contact, bending});
  constexpr double kStep = 0.03;
  ReferenceTissue more(make_sheet(lift, changed(0, kStep)));
  ReferenceTissue less(make_sheet(lift, changed(0, -kStep)));
  for (ReferenceTissue* each : {&tissue, &more, &less})
    ASSERT_LE(each->settle(Vector3d::UnitZ()), 1e-4);
  double by_contact = 0;
  double size = 0;
  double error = 0;
  for (const BodyPoint& point : model->particle_points) {
    const Eigen::Matrix3Xd columns = tissue.point_columns(point);
    const Vector3d difference = (more.point(point) - less.point(point)) / (2 * kStep);
    by_contact = std::max(by_contact, columns.col(0).norm());
    size += difference.squaredNorm();
    error += (columns.col(1) - difference).squaredNorm();
  }
  EXPECT_GT(by_contact, 0);
  EXPECT_LT(by_contact, 10 * tissue.penetration());
  EXPECT_LT(std::sqrt(error), 0.4 * std::sqrt(size));
}

TEST(Columns, OfAMaterialWithMemoryAreRefused) {
  Change change;
  change.of_effects = [](pb::TissueEffects& e) { e.set_structural_damping(0.1); };
  ReferenceTissue tissue(make_sheet({}, change));
  EXPECT_THROW(tissue.carry_columns({stiffness_of(0, 0, 0.01).parameter}), Error);
}

}  // namespace
}  // namespace omentum
