// Effects in the elastic solid against their known answers (mismatch.md 5.1), and what holds for
// every one of them: zero is off, the state travels, finite differences are smooth, a lane keeps
// its bits whatever its neighbours do.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <numbers>

#include "core/rng.h"
#include "support/effect_scene.h"
#include "support/solid_scene.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using test::make_solid;
using test::NamedEffect;
using test::rest;
using test::SolidCase;

using Solid = SolidTissue<double>;

/// Bar of 10 x 120 x 10 mm along y that is held nowhere.
SolidCase free_bar() {
  SolidCase c;
  c.anchor_max_y = -1;
  c.young = 20e3;
  c.gravity.setZero();
  return c;
}

/// The same, clamped at its lower end in y.
SolidCase clamped_bar() {
  SolidCase c = free_bar();
  c.anchor_max_y = SolidCase{}.anchor_max_y;
  c.damping = 20;
  return c;
}

void deform(Solid& tissue, const Matrix3d& F) {
  for (int i = 0; i < tissue.particles(); ++i)
    tissue.set_position(0, i, F * tissue.model().mesh.nodes[static_cast<std::size_t>(i)]);
}

/// Force of a body in a homogeneous deformation through its section y_B = const: what its end is
/// pulled with [N].
Vector3d end_force(Solid& tissue) {
  const auto gradient = tissue.elastic_gradient(0);
  const double end = tissue.model().mesh.nodes.front().cwiseAbs().y();
  double far = end;
  for (const Vector3d& p : tissue.model().mesh.nodes) far = std::max(far, p.y());
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 0; i < gradient.size(); ++i) {
    if (tissue.model().mesh.nodes[i].y() > far - 1e-9) sum += gradient[i];
  }
  return sum;
}

/// Mean of the nodes of the free end.
Vector3d tip_of(const Solid& tissue) {
  double far = -1;
  for (const Vector3d& p : tissue.model().mesh.nodes) far = std::max(far, p.y());
  Vector3d sum = Vector3d::Zero();
  int count = 0;
  for (int i = 0; i < tissue.particles(); ++i) {
    if (tissue.model().mesh.nodes[static_cast<std::size_t>(i)].y() < far - 1e-6) continue;
    sum += tissue.position(0, i);
    ++count;
  }
  return sum / count;
}

double weight_of(const Solid& tissue) {
  double mass = 0;
  for (const double m : tissue.model().mass) mass += m;
  return 9.81 * mass;
}

// ---- density, stiffness, Poisson ----------------------------------------------------------------

TEST(SolidEffect, DensityScalesTheWeight) {
  SolidCase c = clamped_bar();
  c.gravity = Vector3d(0, 9.81, 0);
  c.effects.set_density_change(0.4);
  Solid tissue(make_solid(c), kKernelF64x1);
  rest(tissue, 2);
  EXPECT_NEAR(tissue.anchor_force(0).y() / (1.4 * weight_of(tissue)), 1, 1e-4);
}

TEST(SolidEffect, PoissonChangeContractsAcrossAndKeepsYoungsModulus) {
  for (const double change : {-0.3, 0.1, 0.19}) {
    SolidCase c = free_bar();
    c.effects.set_poisson_change(change);
    Solid tissue(make_solid(c), kKernelF64x1);
    const double e = 1e-6;
    const double across = 1 - (c.poisson + change) * e;
    deform(tissue, Vector3d(across, 1 + e, across).asDiagonal());
    EXPECT_NEAR(end_force(tissue).y() / (c.young * 1e-4 * e), 1, 1e-4) << change;
    double largest = 0;  // nothing pulls at the sides
    for (const Vector3d& g : tissue.elastic_gradient(0))
      largest = std::max(largest, std::max(std::fabs(g.x()), std::fabs(g.z())));
    EXPECT_LT(largest, 1e-4 * c.young * 1e-4 * e) << change;
  }
}

TEST(SolidEffect, InclusionOverEverythingIsAnotherModulus) {
  SolidCase c = free_bar();
  c.poisson = 0.45;
  const Matrix3d F = (Matrix3d() << 1.02, 0.1, 0, -0.05, 1.1, 0.02, 0, 0.1, 0.97).finished();
  Solid plain(make_solid(c), kKernelF64x1);
  c.effects.mutable_inclusion()->set_radius_m(0.5);
  c.effects.mutable_inclusion()->set_stiffness_change(1);
  Solid stiff(make_solid(c), kKernelF64x1);
  deform(plain, F);
  deform(stiff, F);
  EXPECT_LT((end_force(stiff) - 2 * end_force(plain)).norm(), 1e-12 * end_force(plain).norm());
}

TEST(SolidEffect, SoftSpotThroughTheSectionStretchesAsSlicesInSeries) {
  SolidCase c = clamped_bar();
  c.poisson = 0;
  c.gravity = Vector3d(0, 9.81, 0);
  c.young = 1e6;
  c.edge_length = 0.008;
  const auto end = [&] {
    Solid tissue(make_solid(c), kKernelF64x1);
    rest(tissue, 1);
    return tip_of(tissue).y();
  };
  const double plain = end();
  c.effects.mutable_inclusion()->set_y_m(-0.02);
  c.effects.mutable_inclusion()->set_radius_m(0.025);
  c.effects.mutable_inclusion()->set_stiffness_change(-0.5);
  double expected = 0;
  for (int k = 0; k < 1200; ++k) {
    const double y = -0.06 + (k + 0.5) * 1e-4;
    const double t = std::clamp((1.25 - std::fabs(y + 0.02) / 0.025) / 0.5, 0.0, 1.0);
    const double w = t * t * (3 - 2 * t);
    const double carried = c.density * 9.81 * (0.06 - y);
    expected += carried / c.young * (1 / (1 - 0.5 * w) - 1) * 1e-4;
  }
  EXPECT_NEAR((end() - plain) / expected, 1, 0.02);
}

// ---- grasp --------------------------------------------------------------------------------------

const Vector3d kEnd(0, 0.06, 0);  // where the bar is taken

/// Takes the bar's end and pulls it by `pull` within a control step; the tip afterwards.
Vector3d take(Solid& tissue, const Vector3d& pull) {
  tissue.hold(0, kEnd, 0.009, false);
  const ToolMotion motion{kEnd, kEnd + pull};
  tissue.step({&motion, 1});
  return kEnd + pull;
}

TEST(SolidGraspEffect, OffsetTakesThePatchBesideTheTip) {
  SolidCase c = clamped_bar();
  Solid plain(make_solid(c), kKernelF64x1);
  plain.hold(0, kEnd + Vector3d(0.003, -0.002, 0), 0.006, false);
  c.effects.mutable_grasp_offset()->set_x_m(0.003);
  c.effects.mutable_grasp_offset()->set_y_m(-0.002);
  c.effects.mutable_grasp_offset()->set_radius_m(0.001);
  Solid beside(make_solid(c), kKernelF64x1);
  beside.hold(0, kEnd, 0.005, false);
  EXPECT_THAT(beside.held(0), testing::ElementsAreArray(plain.held(0)));
  ASSERT_FALSE(beside.held(0).empty());
  const int node = beside.held(0)[0];
  const Vector3d before = beside.position(0, node);
  rest(beside, 0.1, kEnd);  // it stays where it was taken
  EXPECT_LT((beside.position(0, node) - before).norm(), 1e-9);
}

TEST(SolidGraspEffect, ComplianceIsASpringInSeriesAndThePatchKeepsItsShape) {
  for (const double radius : {0.009, 0.004}) {  // the whole end; one node firmly, some partly
    SolidCase c = clamped_bar();
    const double pull = 0.001;
    const auto pulled = [&] {
      auto tissue = std::make_unique<Solid>(make_solid(c), kKernelF64x1);
      tissue->hold(0, kEnd, radius, false);
      const ToolMotion motion{kEnd, kEnd + Vector3d(0, pull, 0)};
      tissue->step({&motion, 1});
      rest(*tissue, 2, motion.to);
      return tissue;
    };
    const auto stiff = pulled();
    const double rigid = -stiff->held_force(0).y();
    c.effects.set_grasp_compliance_m_per_n(0.01);
    const auto soft = pulled();
    EXPECT_NEAR(-soft->held_force(0).y() / (rigid / (1 + 0.01 * rigid / pull)), 1, 0.002) << radius;
    EXPECT_NEAR(soft->anchor_force(0).y() / -soft->held_force(0).y(), 1, 1e-3) << radius;
    // Scaled by the force the patch moved as a whole.
    const auto held = soft->held(0);
    const double share = soft->held_force(0).y() / stiff->held_force(0).y();
    for (const std::int32_t i : held) {
      const Vector3d at = soft->model().mesh.nodes[static_cast<std::size_t>(i)];
      const Vector3d expected = share * (stiff->position(0, i) - at);
      EXPECT_LT((soft->position(0, i) - at - expected).norm(), 0.005 * pull) << radius;
    }
  }
}

TEST(SolidGraspEffect, SlipRelaxesTheForceAndLossLetsGo) {
  SolidCase c = clamped_bar();
  const double pull = 0.001;
  Solid rigid(make_solid(c), kKernelF64x1);
  Vector3d tip = take(rigid, Vector3d(0, pull, 0));
  rest(rigid, 0.5, tip);
  const double first = rigid.held_force(0).norm();
  const double k = first / pull;
  const double limit = 0.25 * first;
  const double speed = 1e-4;
  c.effects.mutable_grasp_slip()->set_speed_m_per_s(speed);
  c.effects.mutable_grasp_slip()->set_force_n(limit);
  Solid slipping(make_solid(c), kKernelF64x1);
  tip = take(slipping, Vector3d(0, pull, 0));
  rest(slipping, 0.5, tip);
  const double start = slipping.held_force(0).norm();
  rest(slipping, 1, tip);
  // dF/dt = -k v0 (F/Fs - 1)
  const double expected = limit + (start - limit) * std::exp(-k * speed / limit);
  EXPECT_NEAR(slipping.held_force(0).norm() / expected, 1, 0.03);

  c.effects.mutable_grasp_slip()->set_loss_m(1e-4);
  Solid lost(make_solid(c), kKernelF64x1);
  tip = take(lost, Vector3d(0, pull, 0));
  EXPECT_FALSE(lost.held(0).empty());
  rest(lost, 2, tip);
  EXPECT_TRUE(lost.held(0).empty());
}

TEST(SolidGraspEffect, JawsTurnWhatTheyHold) {
  SolidCase c = clamped_bar();
  c.effects.set_jaw_roll_deg(20);
  c.effects.set_jaw_tilt_deg(-10);
  const auto model = make_solid(c);
  Solid tissue(model, kKernelF64x1);
  tissue.hold(0, kEnd, 0.009, false);
  rest(tissue, 0.1, kEnd);
  const double degree = std::numbers::pi / 180;
  const Matrix3d turn = (Eigen::AngleAxisd(-10 * degree, Vector3d::UnitX()) *
                         Eigen::AngleAxisd(20 * degree, model->shaft_axis))
                            .toRotationMatrix();
  int firm = 0;
  for (const std::int32_t i : tissue.held(0)) {
    const Vector3d from = model->mesh.nodes[static_cast<std::size_t>(i)] - kEnd;
    if (from.norm() > 0.009 - 0.5 * model->spacing) continue;
    EXPECT_LT((tissue.position(0, i) - kEnd - turn * from).norm(), 1e-12) << i;
    ++firm;
  }
  EXPECT_GT(firm, 5);
}

// ---- every effect -------------------------------------------------------------------------------

/// Those of the common list that a solid can do.
std::vector<NamedEffect> solid_effects() {
  std::vector<NamedEffect> list;
  for (const NamedEffect& effect : test::all_effects()) {
    pb::TissueEffects effects;
    effect.set(effects, 1);
    try {
      refuse_effects(effects, "", kSolidEffects);
      list.push_back(effect);
    } catch (const Error&) {
    }
  }
  return list;
}

/// Pad of 24 x 24 x 8 mm, clamped along one side, that is taken at the opposite side and lifted.
SolidCase pad(bool board) {
  SolidCase c;
  c.size = {0.024, 0.024, 0.008};
  c.edge_length = 0.01;
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
  Solid off(make_solid(c), kKernelF64x1);
  for (const NamedEffect& effect : solid_effects()) effect.set(c.effects, 0);
  c.effects.mutable_inclusion()->set_x_m(0.003);
  c.effects.mutable_plastic_set()->set_yield_strain(0.3);
  c.effects.mutable_suction()->set_reach_m(0.002);
  c.effects.mutable_mullins()->set_strain(0.3);
  c.effects.mutable_anchor()->set_free_to_m(c.effects.anchor().free_from_m());
  Solid zero(make_solid(c), kKernelF64x1);
  test::lift(off, 0, 10);
  test::lift(zero, 0, 10);
  EXPECT_EQ(off.hash(0), zero.hash(0));
}

TEST(EverySolidEffect, AloneAndInPairsItStaysFiniteAndIsFelt) {
  const SolidCase base = pad(true);
  const auto run = [&](std::initializer_list<const NamedEffect*> effects) {
    SolidCase c = base;
    std::string names;
    for (const NamedEffect* effect : effects) {
      effect->set(c.effects, 1);
      names += std::string(" ") + effect->name;
    }
    SolidTissue<double> tissue(make_solid(c), kKernelF64x1);
    test::lift(tissue, 0, 5);
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
    EXPECT_NE(alone.back(), plain) << effect.name;
  }
  for (std::size_t a = 0; a < effects.size(); ++a) {
    for (std::size_t b = a + 1; b < effects.size(); ++b) {
      if (std::string(effects[a].name) == "inclusion" &&
          std::string(effects[b].name) == "soft_spot")
        continue;  // one message
      const std::vector<Vector3d> both = run({&effects[a], &effects[b]});
      EXPECT_NE(both, alone[a]) << effects[a].name << " with " << effects[b].name;
      EXPECT_NE(both, alone[b]) << effects[b].name << " with " << effects[a].name;
    }
  }
}

TEST(EverySolidEffect, SavedStateGoesOnAsIfNothingHadHappened) {
  for (const NamedEffect& effect : solid_effects()) {
    SolidCase c = pad(true);
    effect.set(c.effects, 1);
    const auto model = make_solid(c);
    Solid whole(model, kKernelF64x1);
    test::lift(whole, 0, 6);
    Bytes state;
    whole.save(0, state);
    Solid resumed(model, kKernelF64x1);
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
    Solid fresh(model, kKernelF64x1);
    EXPECT_EQ(resumed.hash(0), fresh.hash(0)) << effect.name;
  }
}

TEST(EverySolidEffect, FiniteDifferencesAreSmooth) {
  for (const NamedEffect& effect : solid_effects()) {
    const auto shape = [&](double amplitude) {
      SolidCase c = pad(effect.needs_board);
      effect.set(c.effects, amplitude);
      Solid tissue(make_solid(c), kKernelF64x1);
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
    if (lane % 4 == 0 || name.find("anchor") != std::string::npos) continue;
    effect.set(effects, 0.3 + 0.7 * static_cast<double>(words[1]) * 0x1p-32);
  }
  return make_effects(effects, 0.4, {});
}

template <typename Real>
std::vector<std::uint64_t> run_lanes(const std::shared_ptr<const SolidTissueModel>& model,
                                     const Kernel<Real>& kernel,
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
    for (int step = 0; step < 12; ++step) {
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
  const auto alone = run_lanes(model, kKernelF32x1, effects);
  EXPECT_EQ(run_lanes(model, kKernelF32x8, effects), alone);
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
  const auto plain = run_lanes(model, kKernelF32x8, none);
  for (const NamedEffect& effect : solid_effects()) {
    if (std::string(effect.name).find("anchor") != std::string::npos) continue;  // of the scene
    pb::TissueEffects on;
    effect.set(on, 1);
    std::vector<EffectValues> one = none;
    one[3] = make_effects(on, 0.4, {});
    auto hashes = run_lanes(model, kKernelF32x8, one);
    EXPECT_NE(hashes[3], plain[3]) << effect.name;
    hashes[3] = plain[3];
    EXPECT_EQ(hashes, plain) << effect.name;
  }
}

}  // namespace
}  // namespace omentum
