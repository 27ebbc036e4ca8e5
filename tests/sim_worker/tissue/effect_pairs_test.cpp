// What holds for every effect, alone and with every other: zero is off, the state travels, finite
// differences are smooth, a lane keeps its bits whatever its neighbours do.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "core/rng.h"
#include "sim_worker/models.h"
#include "support/effect_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::all_effects;
using test::EffectCase;
using test::largest_distance;
using test::lift;
using test::lift_case;
using test::make_effect_tissue;
using test::Model;
using test::NamedEffect;

// Far above what rounding and the solvers' tolerances leave (1e-11 m), so that an effect has moved
// the tissue and not a bit of it; of two effects one may leave little for the other to do.
constexpr double kFelt = 1e-7;               // [m]
constexpr double kFeltBesideAnother = 1e-9;  // [m]

class EveryEffect : public testing::TestWithParam<Model> {};

INSTANTIATE_TEST_SUITE_P(Both, EveryEffect, testing::Values(Model::kElastic, Model::kReference),
                         [](const auto& p) {
                           return p.param == Model::kElastic ? "Elastic" : "Reference";
                         });

/// Every message and number present, everything zero but for scales.
void set_all_to_zero(pb::TissueEffects& effects) {
  for (const NamedEffect& effect : all_effects()) effect.set(effects, 0);
  test::inclusion_of(effects)->set_x_m(0.003);
  effects.mutable_plastic_set()->set_yield_strain(0.3);
  effects.mutable_suction()->set_reach_m(0.002);
  effects.mutable_mullins()->set_strain(0.3);
  effects.mutable_anchor()->set_free_to_m(effects.anchor().free_from_m());
}

TEST_P(EveryEffect, ZeroIsOffToTheBit) {
  EffectCase c = lift_case(true);
  const auto off = make_effect_tissue(c, GetParam());
  set_all_to_zero(c.effects);
  const auto zero = make_effect_tissue(c, GetParam());
  lift(*off, 0, 12);
  lift(*zero, 0, 12);
  EXPECT_EQ(off->hash(0), zero->hash(0));
}

TEST_P(EveryEffect, AloneAndInPairsItStaysFiniteAndIsFelt) {
  const auto run = [&](std::initializer_list<const NamedEffect*> effects) {
    EffectCase c = lift_case(true);
    for (const NamedEffect* effect : effects) effect->set(c.effects, 1);
    const auto tissue = make_effect_tissue(c, GetParam());
    lift(*tissue, 0, 9);
    const Vector3d high = Vector3d(0.001, 0.0095, 0) + 9 * Vector3d(0.0001, -0.0001, 0.0005);
    const ToolMotion down{high, high - Vector3d(0, 0, 0.001)};  // unloads
    tissue->step({&down, 1});
    std::string names;
    for (const NamedEffect* effect : effects) names += std::string(" ") + effect->name;
    EXPECT_TRUE(tissue->healthy(0)) << names;
    // What the tissue does, not the parameters that the state also holds.
    std::vector<Vector3d> shape;
    for (int i = 0; i < tissue->particles(); ++i) {
      shape.push_back(tissue->position(0, i));
      EXPECT_LT(shape.back().norm(), 0.1) << names;
    }
    return shape;
  };
  const auto effects = all_effects();
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
  for (const NamedEffect& effect : all_effects()) {
    EffectCase c = lift_case(true);
    effect.set(c.effects, 1);
    const auto whole = make_effect_tissue(c, GetParam());
    lift(*whole, 0, 7);
    Bytes state;
    whole->save(0, state);
    const auto resumed = make_effect_tissue(c, GetParam());
    const Result<std::size_t> used = resumed->load(0, state);
    ASSERT_TRUE(used.has_value()) << effect.name << ": " << used.error();
    EXPECT_EQ(used.value(), state.size()) << effect.name;
    EXPECT_EQ(resumed->hash(0), whole->hash(0)) << effect.name;
    lift(*whole, 7, 12);
    lift(*resumed, 7, 12);
    EXPECT_EQ(resumed->hash(0), whole->hash(0)) << effect.name;
    for (const std::size_t size : {state.size() - 1, state.size() / 2, std::size_t{3}}) {
      EXPECT_FALSE(resumed->load(0, std::span(state).first(size)).has_value()) << effect.name;
    }
  }
}

TEST_P(EveryEffect, FiniteDifferencesAreSmooth) {
  for (const NamedEffect& effect : all_effects()) {
    const auto shape = [&](double amplitude) {
      EffectCase c = lift_case(effect.needs_board);
      effect.set(c.effects, amplitude);
      const auto tissue = make_effect_tissue(c, GetParam());
      lift(*tissue, 0, 14);
      Eigen::VectorXd x(3 * tissue->particles());
      for (int i = 0; i < tissue->particles(); ++i) x.segment<3>(3 * i) = tissue->position(0, i);
      return x;
    };
    const Eigen::VectorXd first = shape(0.50);
    const Eigen::VectorXd second = shape(0.51);
    const Eigen::VectorXd third = shape(0.52);
    const double slope = (third - first).norm() / 2;
    const double bend = (third - 2 * second + first).norm();
    // Contact of the shell is settled to its tolerance only: 6 um rms. Stiffening changes its
    // factor in steps as the strain grows, and a lift in motion shows when. Of the
    // reference, a node that begins to slip is a kink: at the slip speed it goes 0.1 um per step,
    // 1.4 um in all.
    const bool steps = std::string(effect.name) == "strain_stiffening";
    double noise = 0;
    if (GetParam() == Model::kElastic && effect.needs_board) noise = 1e-4;
    if (GetParam() == Model::kElastic && steps) noise = 2e-5;
    if (GetParam() == Model::kReference && effect.needs_board) noise = 1.4e-6;
    EXPECT_LT(bend, 0.15 * slope + noise) << effect.name << ": " << slope << " m per step";
    EXPECT_GT(slope, 1e-9) << effect.name;
  }
}

/// Effects of one lane, each lane others.
EffectValues lane_effects(int lane) {
  pb::TissueEffects effects;
  const auto list = all_effects();
  for (std::uint32_t k = 0; k < 5; ++k) {
    const PhiloxWords words = philox({static_cast<std::uint32_t>(lane), k, 0, 0}, {3, 1});
    const NamedEffect& effect = list[words[0] % list.size()];
    const std::string name = effect.name;
    if (lane % 4 == 0 || name.find("anchor") != std::string::npos || name == "added_mass") continue;
    effect.set(effects, 0.3 + 0.7 * static_cast<double>(words[1]) * 0x1p-32);
  }
  if (lane % 4 == 1) effects.mutable_mullins()->set_softening(0.1 + 0.04 * lane);
  return make_effects(effects, 0.4, {});
}

template <typename Real>
std::vector<std::uint64_t> run_lanes(const LaneKernel<Real>& kernel,
                                     const std::vector<int>& lanes) {
  std::vector<std::string> warnings;
  const auto model =
      make_shell_model(make_effect_scene(lift_case(true), Model::kElastic), 0.02, warnings);
  std::vector<std::uint64_t> hashes;
  for (std::size_t first = 0; first < lanes.size();
       first += static_cast<std::size_t>(kernel.lanes)) {
    const auto tissue = model->make_tissue(kernel);
    const auto count =
        std::min<std::size_t>(static_cast<std::size_t>(kernel.lanes), lanes.size() - first);
    for (std::size_t k = 0; k < count; ++k) {
      LaneParameters parameters;
      parameters.effects = lane_effects(lanes[first + k]);
      tissue->set_parameters(static_cast<int>(k), parameters);
      tissue->reset(static_cast<int>(k), Vector3d::Zero());
    }
    const auto tip = [](int step) {
      return Vector3d(0.001, 0.0095, 0.0004 * std::max(0, step - 2));
    };
    for (int step = 0; step < 40; ++step) {
      for (std::size_t k = 0; k < count; ++k) {
        if (step == 2 + lanes[first + k] % 3)
          tissue->hold(static_cast<int>(k), tip(step), 0.0045, false);
      }
      const std::vector<ToolMotion> motion(static_cast<std::size_t>(kernel.lanes),
                                           ToolMotion{tip(step), tip(step + 1)});
      tissue->step(motion);
    }
    for (std::size_t k = 0; k < count; ++k) {
      EXPECT_TRUE(tissue->healthy(static_cast<int>(k))) << lanes[first + k];
      hashes.push_back(tissue->hash(static_cast<int>(k)));
    }
  }
  return hashes;
}

TEST(LaneEffects, LanesWithOtherEffectsKeepTheirBitsAtEveryWidth) {
  std::vector<int> lanes;
  for (int k = 0; k < 16; ++k) lanes.push_back(k);
  const auto alone = run_lanes(f32x1(), lanes);
  EXPECT_EQ(run_lanes(f32x8(), lanes), alone);
  try {
    EXPECT_EQ(run_lanes(choose_kernel(16), lanes), alone);
  } catch (const Error&) {
    std::puts("16 lanes skipped: no AVX-512 on this CPU");
  }
  std::map<std::uint64_t, int> seen;
  for (const std::uint64_t hash : alone) ++seen[hash];
  EXPECT_GT(seen.size(), 10U);
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
