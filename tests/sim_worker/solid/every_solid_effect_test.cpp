// What holds for every effect in the elastic solid: zero is off, the state travels, finite
// differences are smooth, a lane keeps its bits whatever its neighbours do.
#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "sim_worker/models.h"
#include "support/effect_scene.h"
#include "support/solid_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::largest_distance;
using test::make_solid;
using test::NamedEffect;
using test::rest;
using test::SolidCase;

// Far above what rounding and the solvers' tolerances leave (1e-11 m), so that an effect has moved
// the tissue and not a bit of it; of two effects one may leave little for the other to do.
constexpr double kFelt = 1e-7;               // [m]
constexpr double kFeltBesideAnother = 1e-9;  // [m]

using Solid = SolidTissue<double>;

// ---- every effect -------------------------------------------------------------------------------

/// Those of the common list that a solid can do.
std::vector<NamedEffect> solid_effects() {
  std::vector<NamedEffect> list;
  for (const NamedEffect& effect : test::all_effects()) {
    pb::TissueEffects effects;
    effect.set(effects, 1);
    if (has_effects(effects, kSolidModel)) list.push_back(effect);
  }
  return list;
}

/// Pad of 24 x 24 x 8 mm, clamped along one side, that is taken at the opposite side and lifted.
SolidCase pad(bool board) {
  SolidCase c;
  c.size = {0.024, 0.024, 0.008};
  c.edge_length = 0.014;
  static const SolidMesh mesh = fill_mesh(make_box_mesh(0.5 * c.size), "box", c.edge_length);
  c.mesh = mesh;
  c.anchor_max_y = -0.012 + 1e-9;
  c.young = 5e3;
  c.poisson = 0.4;
  c.static_friction = c.dynamic_friction = 0.3;
  if (board) c.bodies = {test::make_board(0.00552)};
  return c;
}

TEST(EverySolidEffect, ZeroIsOffToTheBit) {
  SolidCase c = pad(true);
  Solid off(make_solid(c), f64x1());
  for (const NamedEffect& effect : solid_effects()) effect.set(c.effects, 0);
  test::inclusion_of(c.effects)->set_x_m(0.003);
  c.effects.mutable_plastic_set()->set_yield_strain(0.3);
  c.effects.mutable_suction()->set_reach_m(0.002);
  c.effects.mutable_mullins()->set_strain(0.3);
  c.effects.mutable_anchor()->set_free_to_m(c.effects.anchor().free_from_m());
  Solid zero(make_solid(c), f64x1());
  test::lift(off, 0, 10);
  test::lift(zero, 0, 10);
  EXPECT_EQ(off.hash(0), zero.hash(0));
}

TEST(EverySolidEffect, AloneAndInPairsItStaysFiniteAndIsFelt) {
  SolidCase base = pad(true);
  base.substeps = 2;  // 250 runs
  const auto run = [&](std::initializer_list<const NamedEffect*> effects) {
    SolidCase c = base;
    std::string names;
    for (const NamedEffect* effect : effects) {
      effect->set(c.effects, 1);
      names += std::string(" ") + effect->name;
    }
    SolidTissue<double> tissue(make_solid(c), f64x1());
    test::lift(tissue, 0, 4);
    const Vector3d high(0.0014, 0.0091, 0.002);
    const ToolMotion down{high, high - Vector3d(0, 0, 0.001)};  // unloads
    tissue.step({&down, 1});
    EXPECT_TRUE(tissue.healthy(0)) << names;
    std::vector<Vector3d> shape;
    for (int i = 0; i < tissue.particles(); ++i) {
      shape.push_back(tissue.position(0, i));
      EXPECT_LT(shape.back().norm(), 0.1) << names;
    }
    return shape;
  };
  const auto effects = solid_effects();
  const std::vector<Vector3d> plain = run({});
  std::vector<std::vector<Vector3d>> alone;
  for (const NamedEffect& effect : effects) {
    alone.push_back(run({&effect}));
    EXPECT_GT(largest_distance(alone.back(), plain), kFelt) << effect.name;
  }
  for (std::size_t a = 0; a < effects.size(); ++a) {
    for (std::size_t b = a + 1; b < effects.size(); ++b) {
      if (std::string(effects[a].name) == "inclusion" &&
          std::string(effects[b].name) == "soft_spot")
        continue;  // one message
      const std::vector<Vector3d> both = run({&effects[a], &effects[b]});
      EXPECT_GT(largest_distance(both, alone[a]), kFeltBesideAnother)
          << effects[a].name << " with " << effects[b].name;
      EXPECT_GT(largest_distance(both, alone[b]), kFeltBesideAnother)
          << effects[b].name << " with " << effects[a].name;
    }
  }
}

TEST(EverySolidEffect, SavedStateGoesOnAsIfNothingHadHappened) {
  for (const NamedEffect& effect : solid_effects()) {
    SolidCase c = pad(true);
    effect.set(c.effects, 1);
    const auto model = make_solid(c);
    Solid whole(model, f64x1());
    test::lift(whole, 0, 6);
    Bytes state;
    whole.save(0, state);
    Solid resumed(model, f64x1());
    const Result<std::size_t> used = resumed.load(0, state);
    ASSERT_TRUE(used.has_value()) << effect.name << ": " << used.error();
    EXPECT_EQ(used.value(), state.size()) << effect.name;
    EXPECT_EQ(resumed.hash(0), whole.hash(0)) << effect.name;
    test::lift(whole, 6, 9);
    test::lift(resumed, 6, 9);
    EXPECT_EQ(resumed.hash(0), whole.hash(0)) << effect.name;
    for (const std::size_t size : {state.size() - 1, state.size() / 2, std::size_t{3}}) {
      EXPECT_FALSE(resumed.load(0, std::span(state).first(size)).has_value()) << effect.name;
    }
    // What the memory held is gone after a reset.
    resumed.reset(0, Vector3d::Zero());
    Solid fresh(model, f64x1());
    EXPECT_EQ(resumed.hash(0), fresh.hash(0)) << effect.name;
  }
}

TEST(EverySolidEffect, FiniteDifferencesAreSmooth) {
  for (const NamedEffect& effect : solid_effects()) {
    const auto shape = [&](double amplitude) {
      SolidCase c = pad(effect.needs_board);
      effect.set(c.effects, amplitude);
      Solid tissue(make_solid(c), f64x1());
      test::lift(tissue, 0, 8);
      Eigen::VectorXd x(3 * tissue.particles());
      for (int i = 0; i < tissue.particles(); ++i) x.segment<3>(3 * i) = tissue.position(0, i);
      return x;
    };
    const Eigen::VectorXd first = shape(0.50);
    const Eigen::VectorXd second = shape(0.51);
    const Eigen::VectorXd third = shape(0.52);
    const double slope = (third - first).norm() / 2;
    const double bend = (third - 2 * second + first).norm();
    // Newton's method leaves a hundred thousandth of a residual; a node that begins to touch or to
    // slip is a kink.
    const double noise = effect.needs_board ? 1e-5 : 2e-7;
    EXPECT_LT(bend, 0.15 * slope + noise) << effect.name << ": " << slope << " m per step";
    EXPECT_GT(slope, 1e-9) << effect.name;
  }
}

// ---- lanes --------------------------------------------------------------------------------------

/// Effects of one lane, each lane others; every fourth has none.
EffectValues lane_effects(int lane) {
  pb::TissueEffects effects;
  const auto list = solid_effects();
  for (std::uint32_t k = 0; k < 5; ++k) {
    const PhiloxWords words = philox({static_cast<std::uint32_t>(lane), k, 0, 0}, {3, 1});
    const NamedEffect& effect = list[words[0] % list.size()];
    const std::string name = effect.name;
    if (lane % 4 == 0 || name.find("anchor") != std::string::npos || name == "added_mass") continue;
    effect.set(effects, 0.3 + 0.7 * static_cast<double>(words[1]) * 0x1p-32);
  }
  return make_effects(effects, 0.4, {});
}

template <typename Real>
std::vector<std::uint64_t> run_lanes(const std::shared_ptr<const SolidTissueModel>& model,
                                     const LaneKernel<Real>& kernel,
                                     const std::vector<EffectValues>& effects) {
  std::vector<std::uint64_t> hashes;
  const auto W = static_cast<std::size_t>(kernel.lanes);
  for (std::size_t first = 0; first < effects.size(); first += W) {
    SolidTissue<Real> tissue(model, kernel);
    const std::size_t count = std::min(W, effects.size() - first);
    for (std::size_t k = 0; k < count; ++k) {
      LaneParameters parameters;
      parameters.effects = effects[first + k];
      tissue.set_parameters(static_cast<int>(k), parameters);
      tissue.reset(static_cast<int>(k), Vector3d::Zero());
    }
    const auto tip = [](int step) {
      return Vector3d(0.001, 0.0095, 0.0006 * std::max(0, step - 2));
    };
    for (int step = 0; step < 9; ++step) {
      for (std::size_t k = 0; k < count; ++k) {
        if (step == 1 + static_cast<int>(first + k) % 3)
          tissue.hold(static_cast<int>(k), tip(step), 0.0045, false);
      }
      const std::vector<ToolMotion> motion(W, ToolMotion{tip(step), tip(step + 1)});
      tissue.step(motion);
    }
    for (std::size_t k = 0; k < count; ++k) {
      EXPECT_TRUE(tissue.healthy(static_cast<int>(k))) << first + k;
      hashes.push_back(tissue.hash(static_cast<int>(k)));
    }
  }
  return hashes;
}

TEST(EverySolidEffect, LanesWithOtherEffectsKeepTheirBitsAtEveryWidth) {
  const auto model = make_solid(pad(true));
  std::vector<EffectValues> effects;
  for (int k = 0; k < 16; ++k) effects.push_back(lane_effects(k));
  const auto alone = run_lanes(model, f32x1(), effects);
  EXPECT_EQ(run_lanes(model, f32x8(), effects), alone);
  try {
    EXPECT_EQ(run_lanes(model, choose_kernel(16), effects), alone);
  } catch (const Error&) {
    std::puts("16 lanes skipped: no AVX-512 on this CPU");
  }
  std::map<std::uint64_t, int> seen;
  for (const std::uint64_t hash : alone) ++seen[hash];
  EXPECT_GT(seen.size(), 10U);
}

TEST(EverySolidEffect, InOneLaneOnlyItLeavesTheOthersAlone) {
  const auto model = make_solid(pad(true));
  const std::vector<EffectValues> none(8);
  const auto plain = run_lanes(model, f32x8(), none);
  for (const NamedEffect& effect : solid_effects()) {
    const std::string name = effect.name;
    if (name.find("anchor") != std::string::npos || name == "added_mass") continue;  // of the scene
    pb::TissueEffects on;
    effect.set(on, 1);
    std::vector<EffectValues> one = none;
    one[3] = make_effects(on, 0.4, {});
    auto hashes = run_lanes(model, f32x8(), one);
    EXPECT_NE(hashes[3], plain[3]) << effect.name;
    hashes[3] = plain[3];
    EXPECT_EQ(hashes, plain) << effect.name;
  }
}

}  // namespace
}  // namespace omentum
