// Forward sensitivities of the reference against central differences of itself.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <string>
#include <vector>

#include "core/check.h"
#include "support/effect_scene.h"
#include "support/reference_scene.h"

namespace omentum {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

/// A lift of a clamped sheet by a corner, in the air or off a board, in steps of 20 ms.
struct Lift {
  const char* name = "";
  bool board = false;
  double young = 6e4;
  Vector3d way = Vector3d(-0.003, -0.006, 0.02);
  int rest = 0;  ///< steps before the grasp
  int steps = 28;
  void (*effects)(pb::TissueEffects&) = nullptr;  ///< of the base
};

const Vector3d kPinch(0.021, 0.018, 0);
constexpr double kPatch = 0.005;

/// What a difference changes.
struct Change {
  std::function<void(test::ReferenceCase&)> of_case;
  std::function<void(pb::TissueEffects&)> of_effects;
  std::function<void(pb::Tissue&)> of_scene;
  Vector3d tip = Vector3d::Zero();  ///< after the grasp [m]
  double delay = 0;                 ///< [s]
};

std::shared_ptr<const ReferenceTissueModel> make_sheet(
    const Lift& lift, const Change& change, const ReferenceTissueModel* mesh_of = nullptr) {
  test::ReferenceCase c;
  c.nx = c.ny = 16;
  c.anchor = -0.0195;
  c.ex = 8;
  c.ey = 9;
  c.young = lift.young;
  c.poisson = 0.45;
  c.damping = 5;
  c.law = pb::LAW_NEO_HOOKE;
  if (lift.board) {
    c.static_friction = c.dynamic_friction = 0.3;
    c.bodies = {test::make_board(0, {0, 0, -0.0015})};
  }
  if (change.of_case) change.of_case(c);
  Scene scene = test::make_reference_scene(c);
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.mutable_reference()->set_friction_slip_speed_m_per_s(1e-3);
  tissue.mutable_reference()->set_newton_tolerance(lift.board ? 1e-9 : 1e-8);
  if (lift.effects != nullptr) lift.effects(*tissue.mutable_effects());
  if (change.of_effects) change.of_effects(*tissue.mutable_effects());
  if (change.of_scene) change.of_scene(tissue);
  std::vector<std::string> warnings;
  return make_reference_model(scene, c.period, warnings, {}, mesh_of);
}

/// Tip of the tool at a time in steps. A smooth start and end: a kink of the path has no derivative
/// by a delay.
Vector3d tip_at(const Lift& lift, double step) {
  const double u = std::clamp((step - lift.rest) / (lift.steps - lift.rest - 5), 0.0, 1.0);
  return kPinch + u * u * u * (10 - 15 * u + 6 * u * u) * lift.way;
}

/// Moves the tissue; calls `before` and `after` every step.
void run(
    const Lift& lift, const Change& change, ReferenceTissue& tissue,
    const std::function<void()>& after, const std::function<void(int)>& before = [](int) {}) {
  for (int step = 0; step < lift.steps; ++step) {
    before(step);
    if (step == lift.rest) tissue.hold(0, kPinch, kPatch, false);
    const Vector3d more = step >= lift.rest ? change.tip : Vector3d::Zero();
    const double late = change.delay / 0.02;
    const ToolMotion motion{tip_at(lift, step - late) + more, tip_at(lift, step + 1 - late) + more};
    tissue.step({&motion, 1});
    ASSERT_EQ(tissue.failure(0), "");
    after();
  }
}

/// Every particle after every second step.
VectorXd surface(const Lift& lift, const Change& change) {
  ReferenceTissue tissue(make_sheet(lift, change));
  std::vector<double> values;
  int step = 0;
  run(lift, change, tissue, [&] {
    if (++step % 2 != 0) return;
    for (int i = 0; i < tissue.particles(); ++i) {
      const Vector3d p = tissue.position(0, i);
      values.insert(values.end(), p.data(), p.data() + 3);
    }
  });
  return VectorXd::Map(values.data(), static_cast<Eigen::Index>(values.size()));
}

/// A parameter of the tests: what a difference of it is, and how its column is told.
struct Named {
  std::string name;
  std::function<Change(double)> change;
  double step;  ///< of a difference
  bool one_sided = false;
  bool needs_board = false;
  ColumnParameter parameter = {};  ///< a site; or of kScene, to be filled in
  /// Of the tip at the end of a step [m per unit]; kToolPath.
  std::function<Vector3d(const Lift&, int step)> tip = {};
};

MatrixXd columns(const Lift& lift, const std::vector<Named>& named, std::uint64_t* hash = nullptr) {
  const auto model = make_sheet(lift, {});
  std::vector<ColumnParameter> parameters;
  for (const Named& n : named) {
    parameters.push_back(n.parameter);
    if (n.parameter.kind != ColumnKind::kScene) continue;
    parameters.back().step = 1e-3 * n.step;
    parameters.back().changed = make_sheet(lift, n.change(1e-3 * n.step), model.get());
  }
  ReferenceTissue tissue(model);
  tissue.carry_columns(parameters);
  std::vector<MatrixXd> blocks;
  int steps = 0;
  run(
      lift, {}, tissue,
      [&] {
        if (++steps % 2 != 0) return;
        for (const BodyPoint& point : model->particle_points)
          blocks.emplace_back(tissue.point_columns(point));
      },
      [&](int step) {
        const auto tip = [&](int at) {
          Eigen::Matrix3Xd all = Eigen::Matrix3Xd::Zero(3, static_cast<Eigen::Index>(named.size()));
          for (std::size_t k = 0; k < named.size(); ++k) {
            if (named[k].tip && at > lift.rest)
              all.col(static_cast<Eigen::Index>(k)) = named[k].tip(lift, at);
          }
          return all;
        };
        tissue.set_tip_columns(tip(step), tip(step + 1));
      });
  EXPECT_TRUE(tissue.columns()->valid);
  if (hash != nullptr) *hash = tissue.hash(0);
  MatrixXd all(3 * static_cast<Eigen::Index>(blocks.size()),
               static_cast<Eigen::Index>(named.size()));
  for (std::size_t k = 0; k < blocks.size(); ++k)
    all.middleRows<3>(3 * static_cast<Eigen::Index>(k)) = blocks[k];
  return all;
}

Named of_case(const char* name, double step, void (*set)(test::ReferenceCase&, double)) {
  return {name,
          [set](double d) {
            Change c;
            c.of_case = [set, d](test::ReferenceCase& r) { set(r, d); };
            return c;
          },
          step};
}

Named of_numerics(const char* name, double step, void (*set)(pb::Tissue&, double)) {
  return {name,
          [set](double d) {
            Change c;
            c.of_scene = [set, d](pb::Tissue& t) { set(t, d); };
            return c;
          },
          step};
}

Named of_effect(const char* name, double step, void (*set)(pb::TissueEffects&, double)) {
  return {name,
          [set](double d) {
            Change c;
            c.of_effects = [set, d](pb::TissueEffects& e) { set(e, d); };
            return c;
          },
          step};
}

std::vector<Named> all_parameters() {
  std::vector<Named> named = {
      of_case("young_modulus", 600, [](test::ReferenceCase& c, double d) { c.young += d; }),
      of_case("poisson_ratio", 1e-3, [](test::ReferenceCase& c, double d) { c.poisson += d; }),
      of_case("damping", 0.5, [](test::ReferenceCase& c, double d) { c.damping += d; }),
  };
  named.push_back(of_numerics("slip_speed", 2e-5, [](pb::Tissue& t, double d) {
    t.mutable_reference()->set_friction_slip_speed_m_per_s(1e-3 + d);
  }));
  named.back().needs_board = true;
  for (const test::NamedEffect& effect : test::all_effects()) {
    if (std::string(effect.name).starts_with("anchor")) continue;
    const bool slips = std::string(effect.name) == "grasp_slip";
    named.push_back(of_effect(effect.name, slips ? 1e-5 : 1e-3, effect.set));
    named.back().needs_board = effect.needs_board;
    const std::vector<std::string> both_ways = {
        "inclusion",         "soft_spot",  "density",   "gravity_tilt", "poisson",
        "bending_stiffness", "rest_shape", "thickness", "pre_stretch",  "grasp_offset",
        "jaw_roll",          "jaw_tilt",   "jaw_lean"};
    named.back().one_sided = std::ranges::find(both_ways, effect.name) == both_ways.end();
  }
  Named site = of_effect("stiffness_site", 1e-2, [](pb::TissueEffects& e, double d) {
    test::inclusion_of(e)->set_x_m(0.003);
    test::inclusion_of(e)->set_y_m(0.004);
    test::inclusion_of(e)->set_radius_m(0.008);
    test::inclusion_of(e)->set_stiffness_change(d);
  });
  site.parameter.kind = ColumnKind::kStiffnessSite;
  site.parameter.place = {0.003, 0.004};
  site.parameter.radius = 0.008;
  named.push_back(site);
  Named clamp = of_effect("clamp_give", 1e-8, [](pb::TissueEffects& e, double d) {
    e.mutable_anchor()->set_compliance_m2_per_n(d);
  });
  clamp.parameter.kind = ColumnKind::kClampGive;
  clamp.one_sided = true;
  named.push_back(clamp);
  Named piece = of_effect("clamp_piece", 1e-5, [](pb::TissueEffects& e, double d) {
    e.mutable_anchor()->set_free_from_m(0.006 - 0.5 * d);
    e.mutable_anchor()->set_free_to_m(0.006 + 0.5 * d);
  });
  piece.parameter.kind = ColumnKind::kClampFree;
  piece.parameter.place.x() = 0.006;
  piece.one_sided = true;
  named.push_back(piece);
  Named offset{"tip_offset_x",
               [](double d) {
                 Change c;
                 c.tip.x() = d;
                 return c;
               },
               1e-5};
  offset.parameter.kind = ColumnKind::kToolPath;
  offset.tip = [](const Lift&, int) { return Vector3d(Vector3d::UnitX()); };
  named.push_back(offset);
  Named delay{"delay",
              [](double d) {
                Change c;
                c.delay = d;
                return c;
              },
              5e-4};
  delay.parameter.kind = ColumnKind::kToolPath;
  delay.tip = [](const Lift& lift, int step) {
    return Vector3d((tip_at(lift, step - 1e-3) - tip_at(lift, step + 1e-3)) / (2e-3 * 0.02));
  };
  named.push_back(delay);
  return named;
}

/// A difference of the simulation, and how much another step changes it. Friction is settled to a
/// millionth of the weight only and kinks of contact are many: on a board it is taken at the step
/// where it depends least on the step.
struct Difference {
  VectorXd value;
  double change = 0;  ///< relative
};

Difference difference(const Lift& lift, const Named& n, const VectorXd& base,
                      const std::vector<double>& scales) {
  Difference best;
  VectorXd last;
  for (const double scale : scales) {
    const double step = scale * n.step;
    const VectorXd above = surface(lift, n.change(step));
    const VectorXd below = n.one_sided ? base : surface(lift, n.change(-step));
    const VectorXd value = (above - below) / (n.one_sided ? step : 2 * step);
    const double change = last.size() == 0 ? 0 : (value - last).norm() / value.norm();
    if (best.value.size() == 0 || best.change == 0 || change < best.change) best = {value, change};
    last = value;
  }
  return best;
}

/// OMENTUM_ALL_COLUMNS=1: every parameter on every lift, the table of docs/results.md (10 min).
TEST(Columns, AreTheDifferencesOfTheSimulation) {
  const bool all = std::getenv("OMENTUM_ALL_COLUMNS") != nullptr;  // NOLINT(concurrency-mt-unsafe)
  std::vector<Lift> lifts = {{"air", false, 6e4},
                             {"board", true, 6e4, Vector3d(-0.003, -0.006, 0.02), 3}};
  if (all) {
    lifts.push_back({"air soft", false, 2e4});
    lifts.push_back({"air stiff", false, 1.5e5});
    lifts.push_back({"tug", true, 6e4, Vector3d(-0.006, -0.004, 0.002), 3, 18});
  }
  const std::vector<std::string> on_board = {"young_modulus", "gravity_tilt", "adhesion", "suction",
                                             "grasp_offset",  "delay",        "density"};
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
  const MatrixXd s = columns(lift, named);
  const VectorXd base = surface(lift, {});
  for (std::size_t k = 0; k < named.size(); ++k) {
    const Difference expected = difference(lift, named[k], base, {1});
    const VectorXd column = s.col(static_cast<Eigen::Index>(k));
    const double error = (column - expected.value).norm() / expected.value.norm();
    std::printf("# %-10s %-18s %9.4f %%\n", lift.name, named[k].name.c_str(), 100 * error);
    EXPECT_LT(error, 0.01) << named[k].name;
  }
}

Named young() { return all_parameters().front(); }

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

TEST(Columns, OfAMaterialWithMemoryAreRefused) {
  Change change;
  change.of_effects = [](pb::TissueEffects& e) { e.set_structural_damping(0.1); };
  ReferenceTissue tissue(make_sheet({}, change));
  EXPECT_THROW(tissue.carry_columns({stiffness_of(0, 0, 0.01).parameter}), Error);
}

}  // namespace
}  // namespace omentum
