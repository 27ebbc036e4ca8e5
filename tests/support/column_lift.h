#pragma once

// A lift whose derivatives are held against differences of itself.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "support/effect_scene.h"
#include "support/reference_scene.h"

namespace omentum::test {

using Eigen::MatrixXd;
using Eigen::VectorXd;

/// A lift of a clamped sheet by a corner, in the air or off a board, in steps of 20 ms.
struct Lift {
  const char* name = "";
  bool board = false;
  double young = 6e4;
  Vector3d way = Vector3d(-0.003, -0.006, 0.02);
  int rest = 0;  ///< steps before the grasp
  int steps = 28;
  double damping = 5;                             ///< [1/s]
  void (*effects)(pb::TissueEffects&) = nullptr;  ///< of the base
  std::optional<pb::Grip> pad = std::nullopt;
  std::optional<RigidShape> obstacle = std::nullopt;
};

inline const Vector3d kPinch(0.021, 0.018, 0);
constexpr double kPatch = 0.005;

/// What a difference changes.
struct Change {
  Vector3d start = Vector3d::Zero();  ///< velocity [m/s]
  std::function<void(ReferenceCase&)> of_case;
  std::function<void(pb::TissueEffects&)> of_effects;
  std::function<void(pb::Tissue&)> of_scene;
  Vector3d tip = Vector3d::Zero();  ///< after the grasp [m]
  double delay = 0;                 ///< [s]
};

inline std::shared_ptr<const ReferenceTissueModel> make_sheet(
    const Lift& lift, const Change& change, const ReferenceTissueModel* mesh_of = nullptr) {
  ReferenceCase c;
  c.nx = c.ny = 16;
  c.anchor = -0.0195;
  c.ex = 8;
  c.ey = 9;
  c.young = lift.young;
  c.poisson = 0.45;
  c.damping = lift.damping;
  c.law = pb::LAW_NEO_HOOKE;
  if (lift.board) {
    c.static_friction = c.dynamic_friction = 0.3;
    c.bodies = {make_slope(0, {0, 0, -0.0015})};
  }
  if (lift.obstacle) c.bodies.push_back(*lift.obstacle);
  if (change.of_case) change.of_case(c);
  Scene scene = make_reference_scene(c);
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.mutable_reference()->set_friction_slip_speed_m_per_s(1e-3);
  tissue.mutable_reference()->set_newton_tolerance(lift.board ? 1e-9 : 1e-8);
  if (lift.effects != nullptr) lift.effects(*tissue.mutable_effects());
  std::vector<PinchCircle> pinches;
  if (lift.pad) {
    *scene.config.mutable_tool()->mutable_grip() = *lift.pad;
    scene.config.mutable_tool()->set_roll_deg(90);  // x_C along x_W
    pinches = {{kPinch.head<2>(), kPatch}};
  }
  if (change.of_effects) change.of_effects(*tissue.mutable_effects());
  if (change.of_scene) change.of_scene(tissue);
  std::vector<std::string> warnings;
  return make_reference_model(scene, c.period, warnings, pinches, mesh_of);
}

/// Tip of the tool at a time in steps. A smooth start and end: a kink of the path has no derivative
/// by a delay.
inline Vector3d tip_at(const Lift& lift, double step) {
  const double u = std::clamp((step - lift.rest) / (lift.steps - lift.rest - 5), 0.0, 1.0);
  return kPinch + u * u * u * (10 - 15 * u + 6 * u * u) * lift.way;
}

/// Moves the tissue; calls `before` and `after` every step.
inline void run(
    const Lift& lift, const Change& change, ReferenceTissue& tissue,
    const std::function<void()>& after, const std::function<void(int)>& before = [](int) {}) {
  tissue.start_moving(change.start);
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
inline VectorXd surface(const Lift& lift, const Change& change) {
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

inline MatrixXd columns(const Lift& lift, const std::vector<Named>& named,
                        std::uint64_t* hash = nullptr) {
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

inline Named of_case(const char* name, double step, void (*set)(ReferenceCase&, double)) {
  return {name,
          [set](double d) {
            Change c;
            c.of_case = [set, d](ReferenceCase& r) { set(r, d); };
            return c;
          },
          step};
}

inline Named of_numerics(const char* name, double step, void (*set)(pb::Tissue&, double)) {
  return {name,
          [set](double d) {
            Change c;
            c.of_scene = [set, d](pb::Tissue& t) { set(t, d); };
            return c;
          },
          step};
}

inline Named of_effect(const char* name, double step, void (*set)(pb::TissueEffects&, double)) {
  return {name,
          [set](double d) {
            Change c;
            c.of_effects = [set, d](pb::TissueEffects& e) { set(e, d); };
            return c;
          },
          step};
}

inline std::vector<Named> all_parameters() {
  std::vector<Named> named = {
      of_case("young_modulus", 600, [](ReferenceCase& c, double d) { c.young += d; }),
      of_case("poisson_ratio", 1e-3, [](ReferenceCase& c, double d) { c.poisson += d; }),
      of_case("damping", 0.5, [](ReferenceCase& c, double d) { c.damping += d; }),
  };
  named.push_back(of_numerics("slip_speed", 2e-5, [](pb::Tissue& t, double d) {
    t.mutable_reference()->set_friction_slip_speed_m_per_s(1e-3 + d);
  }));
  named.back().needs_board = true;
  for (const NamedEffect& effect : all_effects()) {
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
    inclusion_of(e)->set_x_m(0.003);
    inclusion_of(e)->set_y_m(0.004);
    inclusion_of(e)->set_radius_m(0.008);
    inclusion_of(e)->set_stiffness_change(d);
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

inline Difference difference(const Lift& lift, const Named& n, const VectorXd& base,
                             const std::vector<double>& scales) {
  Difference best;
  VectorXd last;
  for (const double scale : scales) {
    const double step = scale * n.step;
    const VectorXd above = surface(lift, n.change(step));
    VectorXd value;  // of second order in the step
    if (n.one_sided) {
      value = (4 * surface(lift, n.change(0.5 * step)) - above - 3 * base) / step;
    } else {
      value = (above - surface(lift, n.change(-step))) / (2 * step);
    }
    const double change = last.size() == 0 ? 0 : (value - last).norm() / value.norm();
    if (best.value.size() == 0 || best.change == 0 || change < best.change) best = {value, change};
    last = value;
  }
  return best;
}

inline Named young() { return all_parameters().front(); }

inline void expect_columns(const Lift& lift, const std::vector<Named>& named, double bound) {
  const MatrixXd s = columns(lift, named);
  const VectorXd base = surface(lift, {});
  for (std::size_t k = 0; k < named.size(); ++k) {
    const Difference expected = difference(lift, named[k], base, {1});
    const VectorXd column = s.col(static_cast<Eigen::Index>(k));
    const double error = (column - expected.value).norm() / expected.value.norm();
    std::printf("# %-10s %-18s %9.4f %%\n", lift.name, named[k].name.c_str(), 100 * error);
    EXPECT_LT(error, bound) << lift.name << " " << named[k].name;
  }
}

}  // namespace omentum::test
