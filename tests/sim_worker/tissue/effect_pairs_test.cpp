// What holds for every effect of shell, reference and solid, alone and with every other: zero is
// off, the state travels, finite differences are smooth, a lane keeps its bits whatever its
// neighbours do.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "core/rng.h"
#include "sim_worker/models.h"
#include "support/effect_scene.h"
#include "support/solid_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::all_effects;
using test::EffectCase;
using test::largest_distance;
using test::lift;
using test::lift_case;
using test::make_effect_scene;
using test::Model;
using test::NamedEffect;

// Far above what rounding and the solvers' tolerances leave (1e-11 m), so that an effect has moved
// the tissue and not a bit of it; of two effects one may leave little for the other to do.
constexpr double kFelt = 1e-7;               // [m]
constexpr double kFeltBesideAnother = 1e-9;  // [m]

/// Sheet of 24 mm, clamped along one side, that is taken at the opposite side and lifted.
template <Model kModel>
Scene sheet(const pb::TissueEffects& effects, bool board, unsigned /*substeps*/) {
  EffectCase c = lift_case(board);
  c.effects = effects;
  return make_effect_scene(c, kModel);
}

/// Pad of 24 x 24 x 8 mm, held in the same way.
Scene pad(const pb::TissueEffects& effects, bool board, unsigned substeps) {
  test::SolidCase c;
  c.size = {0.024, 0.024, 0.008};
  c.edge_length = 0.014;
  static const SolidMesh mesh = fill_mesh(make_box_mesh(0.5 * c.size), "box", c.edge_length);
  c.mesh = mesh;
  c.anchor_max_y = -0.012 + 1e-9;
  c.young = 5e3;
  c.poisson = 0.4;
  c.substeps = substeps;
  c.static_friction = c.dynamic_friction = 0.3;
  if (board) c.bodies = {test::make_board(0.00552)};
  c.effects = effects;
  return make_solid_scene(c);
}

/// A body to lift, and for how many control steps each law lifts it.
struct Body {
  const char* name;
  Scene (*scene)(const pb::TissueEffects& effects, bool board, unsigned substeps);
  int zero_steps, pair_steps, saved_at, saved_to, smooth_steps;
  unsigned pair_substeps = 5;
  int lane_steps = 40;
  double lane_rise = 0.0004;  ///< of a control step [m]
};

std::shared_ptr<const TissueModel> make_model(const Body& body, const pb::TissueEffects& effects,
                                              bool board, unsigned substeps = 5) {
  std::vector<std::string> warnings;
  return make_tissue_model(body.scene(effects, board, substeps), 0.02, warnings);
}

constexpr Body kElastic{"Elastic", sheet<Model::kElastic>, 12, 9, 7, 12, 14};
constexpr Body kReference{"Reference", sheet<Model::kReference>, 12, 9, 7, 12, 14};
constexpr Body kSolid{"Solid", pad, 10, 4, 6, 9, 8, 2, 9, 0.0006};  // 250 pairs

/// Those of the common list that a body can do.
std::vector<NamedEffect> effects_of(const Body& body) {
  std::vector<NamedEffect> list;
  for (const NamedEffect& effect : all_effects()) {
    pb::TissueEffects effects;
    effect.set(effects, 1);
    if (body.scene != pad || has_effects(effects, kSolidModel)) list.push_back(effect);
  }
  return list;
}

class EveryEffect : public testing::TestWithParam<Body> {};

INSTANTIATE_TEST_SUITE_P(Bodies, EveryEffect, testing::Values(kElastic, kReference, kSolid),
                         [](const auto& p) { return std::string(p.param.name); });

TEST_P(EveryEffect, ZeroIsOffToTheBit) {
  pb::TissueEffects effects;
  const auto off = make_model(GetParam(), effects, true)->make_tissue(f64x1());
  // Every message and number is present, and everything is zero but for scales.
  for (const NamedEffect& effect : effects_of(GetParam())) effect.set(effects, 0);
  test::inclusion_of(effects)->set_x_m(0.003);
  effects.mutable_plastic_set()->set_yield_strain(0.3);
  effects.mutable_suction()->set_reach_m(0.002);
  effects.mutable_mullins()->set_strain(0.3);
  effects.mutable_anchor()->set_free_to_m(effects.anchor().free_from_m());
  const auto zero = make_model(GetParam(), effects, true)->make_tissue(f64x1());
  lift(*off, 0, GetParam().zero_steps);
  lift(*zero, 0, GetParam().zero_steps);
  EXPECT_EQ(off->hash(0), zero->hash(0));
}

TEST_P(EveryEffect, AloneAndInPairsItStaysFiniteAndIsFelt) {
  const Body& body = GetParam();
  const auto run = [&](std::initializer_list<const NamedEffect*> list) {
    pb::TissueEffects effects;
    std::string names;
    for (const NamedEffect* effect : list) {
      effect->set(effects, 1);
      names += std::string(" ") + effect->name;
    }
    const auto tissue = make_model(body, effects, true, body.pair_substeps)->make_tissue(f64x1());
    lift(*tissue, 0, body.pair_steps);
    const Vector3d high =
        Vector3d(0.001, 0.0095, 0) + body.pair_steps * Vector3d(0.0001, -0.0001, 0.0005);
    const ToolMotion down{high, high - Vector3d(0, 0, 0.001)};  // unloads
    tissue->step({&down, 1});
    EXPECT_TRUE(tissue->healthy(0)) << names;
    // What the tissue does, not the parameters that the state also holds.
    std::vector<Vector3d> shape;
    for (int i = 0; i < tissue->particles(); ++i) {
      shape.push_back(tissue->position(0, i));
      EXPECT_LT(shape.back().norm(), 0.1) << names;
    }
    return shape;
  };
  const auto effects = effects_of(body);
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

TEST_P(EveryEffect, SavedStateGoesOnAsIfNothingHadHappened) {
  const Body& body = GetParam();
  for (const NamedEffect& effect : effects_of(body)) {
    pb::TissueEffects effects;
    effect.set(effects, 1);
    const auto model = make_model(body, effects, true);
    const auto whole = model->make_tissue(f64x1());
    lift(*whole, 0, body.saved_at);
    Bytes state;
    whole->save(0, state);
    const auto resumed = model->make_tissue(f64x1());
    const Result<std::size_t> used = resumed->load(0, state);
    ASSERT_TRUE(used.has_value()) << effect.name << ": " << used.error();
    EXPECT_EQ(used.value(), state.size()) << effect.name;
    EXPECT_EQ(resumed->hash(0), whole->hash(0)) << effect.name;
    lift(*whole, body.saved_at, body.saved_to);
    lift(*resumed, body.saved_at, body.saved_to);
    EXPECT_EQ(resumed->hash(0), whole->hash(0)) << effect.name;
    for (const std::size_t size : {state.size() - 1, state.size() / 2, std::size_t{3}}) {
      EXPECT_FALSE(resumed->load(0, std::span(state).first(size)).has_value()) << effect.name;
    }
    // What the memory held is gone after a reset.
    resumed->reset(0, Vector3d::Zero());
    EXPECT_EQ(resumed->hash(0), model->make_tissue(f64x1())->hash(0)) << effect.name;
  }
}

/// What rounding, solvers and kinks leave of a second difference of shapes [m].
double bend_allowed(const Body& body, const NamedEffect& effect) {
  // Newton's method leaves a hundred thousandth of a residual.
  if (body.scene == pad) return effect.needs_board ? 1e-5 : 2e-7;
  // Contact of the shell is settled to its tolerance only: 6 um rms. Stiffening changes its factor
  // in steps as the strain grows, and a lift in motion shows when.
  if (body.scene == kElastic.scene)
    return effect.needs_board ? 1e-4 : std::string(effect.name) == "strain_stiffening" ? 2e-5 : 0;
  // A node that begins to slip is a kink: at the slip speed it goes 0.1 um per step, 1.4 in all.
  return effect.needs_board ? 1.4e-6 : 0;
}

TEST_P(EveryEffect, FiniteDifferencesAreSmooth) {
  const Body& body = GetParam();
  for (const NamedEffect& effect : effects_of(body)) {
    const auto shape = [&](double amplitude) {
      pb::TissueEffects effects;
      effect.set(effects, amplitude);
      const auto tissue = make_model(body, effects, effect.needs_board)->make_tissue(f64x1());
      lift(*tissue, 0, body.smooth_steps);
      Eigen::VectorXd x(3 * tissue->particles());
      for (int i = 0; i < tissue->particles(); ++i) x.segment<3>(3 * i) = tissue->position(0, i);
      return x;
    };
    const Eigen::VectorXd first = shape(0.50);
    const Eigen::VectorXd second = shape(0.51);
    const Eigen::VectorXd third = shape(0.52);
    const double slope = (third - first).norm() / 2;
    const double bend = (third - 2 * second + first).norm();
    EXPECT_LT(bend, 0.15 * slope + bend_allowed(body, effect))
        << effect.name << ": " << slope << " m per step";
    EXPECT_GT(slope, 1e-9) << effect.name;
  }
}

// ---- lanes --------------------------------------------------------------------------------------

bool is_of_the_scene(const NamedEffect& effect) {
  const std::string name = effect.name;
  return name.find("anchor") != std::string::npos || name == "added_mass";
}

/// Effects of one lane, each lane others; every fourth has none.
EffectValues lane_effects(const Body& body, int lane) {
  pb::TissueEffects effects;
  const auto list = effects_of(body);
  for (std::uint32_t k = 0; k < 5; ++k) {
    const PhiloxWords words = philox({static_cast<std::uint32_t>(lane), k, 0, 0}, {3, 1});
    const NamedEffect& effect = list[words[0] % list.size()];
    if (lane % 4 == 0 || is_of_the_scene(effect)) continue;
    effect.set(effects, 0.3 + 0.7 * static_cast<double>(words[1]) * 0x1p-32);
  }
  if (lane % 4 == 1) effects.mutable_mullins()->set_softening(0.1 + 0.04 * lane);
  return make_effects(effects, 0.4, {});
}

template <typename Real>
std::vector<std::uint64_t> run_lanes(const Body& body, const TissueModel& model,
                                     const LaneKernel<Real>& kernel,
                                     const std::vector<EffectValues>& effects) {
  std::vector<std::uint64_t> hashes;
  const auto W = static_cast<std::size_t>(kernel.lanes);
  for (std::size_t first = 0; first < effects.size(); first += W) {
    const auto tissue = model.make_tissue(kernel);
    const std::size_t count = std::min(W, effects.size() - first);
    for (std::size_t k = 0; k < count; ++k) {
      LaneParameters parameters;
      parameters.effects = effects[first + k];
      tissue->set_parameters(static_cast<int>(k), parameters);
      tissue->reset(static_cast<int>(k), Vector3d::Zero());
    }
    const auto tip = [&body](int step) {
      return Vector3d(0.001, 0.0095, body.lane_rise * std::max(0, step - 2));
    };
    for (int step = 0; step < body.lane_steps; ++step) {
      for (std::size_t k = 0; k < count; ++k) {
        if (step == 1 + static_cast<int>(first + k) % 3)
          tissue->hold(static_cast<int>(k), tip(step), 0.0045, false);
      }
      const std::vector<ToolMotion> motion(W, ToolMotion{tip(step), tip(step + 1)});
      tissue->step(motion);
    }
    for (std::size_t k = 0; k < count; ++k) {
      EXPECT_TRUE(tissue->healthy(static_cast<int>(k))) << first + k;
      hashes.push_back(tissue->hash(static_cast<int>(k)));
    }
  }
  return hashes;
}

class EffectsOfLanes : public testing::TestWithParam<Body> {};

INSTANTIATE_TEST_SUITE_P(Bodies, EffectsOfLanes, testing::Values(kElastic, kSolid),
                         [](const auto& p) { return std::string(p.param.name); });

TEST_P(EffectsOfLanes, LanesWithOtherEffectsKeepTheirBitsAtEveryWidth) {
  const auto model = make_model(GetParam(), {}, true);
  std::vector<EffectValues> effects;
  for (int k = 0; k < 16; ++k) effects.push_back(lane_effects(GetParam(), k));
  const auto alone = run_lanes(GetParam(), *model, f32x1(), effects);
  EXPECT_EQ(run_lanes(GetParam(), *model, f32x8(), effects), alone);
  try {
    EXPECT_EQ(run_lanes(GetParam(), *model, choose_kernel(16), effects), alone);
  } catch (const Error&) {
    std::puts("16 lanes skipped: no AVX-512 on this CPU");
  }
  std::map<std::uint64_t, int> seen;
  for (const std::uint64_t hash : alone) ++seen[hash];
  EXPECT_GT(seen.size(), 10U);
}

TEST_P(EffectsOfLanes, InOneLaneOnlyTheyLeaveTheOthersAlone) {
  const auto model = make_model(GetParam(), {}, true);
  const std::vector<EffectValues> none(8);
  const auto plain = run_lanes(GetParam(), *model, f32x8(), none);
  for (const NamedEffect& effect : effects_of(GetParam())) {
    if (is_of_the_scene(effect)) continue;
    pb::TissueEffects on;
    effect.set(on, 1);
    std::vector<EffectValues> one = none;
    one[3] = make_effects(on, 0.4, {});
    auto hashes = run_lanes(GetParam(), *model, f32x8(), one);
    EXPECT_NE(hashes[3], plain[3]) << effect.name;
    hashes[3] = plain[3];
    EXPECT_EQ(hashes, plain) << effect.name;
  }
}

// ---- bad input ----------------------------------------------------------------------------------

TEST(EffectInput, WhatAModelCannotDoIsRefusedInOneLine) {
  const auto message = [](const EffectCase& c, pb::TissueModelKind kind) -> std::string {
    Scene scene = make_effect_scene(c, Model::kElastic);
    scene.config.mutable_tissue()->set_model(kind);
    std::vector<std::string> warnings;
    try {
      make_tissue_model(scene, 0.02, warnings);
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  };
  EffectCase c = lift_case(false);
  c.effects.mutable_anisotropy()->set_fibre_ratio(1);
  EXPECT_THAT(
      message(c, pb::TISSUE_CLUSTER),
      testing::AllOf(testing::StartsWith("scene.tissue.effects.anisotropy: "),
                     testing::HasSubstr("TISSUE_CLUSTER"), testing::Not(testing::HasSubstr("\n"))));
  c.effects.Clear();
  c.effects.mutable_adhesion()->set_stiffness_pa_per_m(1e5);
  for (const auto kind : {pb::TISSUE_CLUSTER, pb::TISSUE_ELASTIC, pb::TISSUE_REFERENCE})
    EXPECT_THAT(message(c, kind), testing::HasSubstr("needs a scene.rigid_body"));
  c.effects.Clear();
  c.effects.set_poisson_change(0.2);
  EXPECT_THAT(message(c, pb::TISSUE_ELASTIC), testing::HasSubstr("allowed 0 ... 0.49"));
  c.effects.Clear();
  c.effects.mutable_thickness()->set_x_per_m(20);
  c.nx = 61;
  EXPECT_EQ(message(c, pb::TISSUE_ELASTIC).find("scene.tissue.effects.thickness"), 0U);
  c.effects.Clear();
  for (int k = 0; k < 4; ++k) c.effects.add_viscoelastic()->set_share(0.1);
  EXPECT_THAT(message(c, pb::TISSUE_ELASTIC), testing::HasSubstr("4 branches, allowed at most 3"));
  c.effects.Clear();
  for (int k = 0; k < 4; ++k) c.effects.add_inclusion();
  EXPECT_THAT(message(c, pb::TISSUE_REFERENCE), testing::HasSubstr("4 of them, allowed at most 3"));
  c = lift_case(false);
  for (const char* path :
       {"added_mass.mass_kg", "local_force.strength", "inclusion[1].stiffness_change"}) {
    c.effects.Clear();
    set_effect(c.effects, path, 0.1);
    const std::string name = std::string(path).substr(0, std::string(path).find_first_of(".["));
    set_effect(c.effects, std::string(path).substr(0, std::string(path).find('.')) + ".x_m", 0.3);
    for (const auto kind : {pb::TISSUE_ELASTIC, pb::TISSUE_REFERENCE})
      EXPECT_THAT(message(c, kind), testing::HasSubstr("effects." + name +
                                                       ": its place (0.3, 0) m "
                                                       "is off the tissue"));
  }
}

TEST(EffectInput, PathsAreCheckedByNameAndRange) {
  pb::TissueEffects effects;
  set_effect(effects, "inclusion.x_m", 0.01);
  set_effect(effects, "viscoelastic[1].share", 0.2);
  set_effect(effects, "strain_stiffening", 2);
  set_effect(effects, "mullins.softening", 0.4);
  EXPECT_EQ(effects.mullins().softening(), 0.4);
  EXPECT_EQ(effects.inclusion(0).x_m(), 0.01);
  EXPECT_EQ(effects.viscoelastic(1).share(), 0.2);
  EXPECT_EQ(effects.viscoelastic(0).share(), 0);
  EXPECT_EQ(effects.strain_stiffening(), 2);
  for (const char* path : {"wobble", "inclusion", "inclusion.wobble", "viscoelastic[7].share"})
    EXPECT_THROW(set_effect(effects, path, 0), Error) << path;
  EXPECT_THROW(set_effect(effects, "strain_stiffening", 1e4), Error);
  EXPECT_THROW(set_effect(effects, "mullins.softening", 1), Error);
}

}  // namespace
}  // namespace omentum
