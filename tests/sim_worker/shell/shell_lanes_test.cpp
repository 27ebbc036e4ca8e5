// Lanes of the elastic shell: a lane is the same whatever the width and its neighbours, and its
// state travels.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <vector>

#include "support/shell_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::make_shell_sheet;
using test::move_tool;
using test::over_sphere;
using test::run_free;
using test::ShellCase;

constexpr int kPhases = 16;

/// A life with contact, a lift, a release and a fall, in lanes of different parameters and phases.
std::vector<std::uint64_t> live(const std::shared_ptr<const ShellTissueModel>& model,
                                const LaneKernel<float>& kernel, const std::vector<int>& phases,
                                int steps) {
  ShellTissue<float> tissue(model, kernel);
  const auto lanes = static_cast<std::size_t>(tissue.lanes());
  std::vector<Vector3d> tip(lanes, Vector3d(0, 0, 1));
  const auto phase_of = [&](std::size_t lane) { return phases[lane % phases.size()]; };
  for (std::size_t lane = 0; lane < lanes; ++lane) {
    const int p = phase_of(lane);
    tissue.set_parameters(static_cast<int>(lane), {.stiffness_scale = 1 + 0.3 * (p % 3),
                                                   .gravity_scale = 1 - 0.01 * p,
                                                   .damping_scale = 1 + 0.1 * p,
                                                   .friction_scale = 0.1 * p});
  }
  std::vector<ToolMotion> motion(lanes);
  for (int step = 0; step < steps; ++step) {
    for (std::size_t lane = 0; lane < lanes; ++lane) {
      const int now = step - 5 * phase_of(lane);
      if (now == 100) {
        tip[lane] = tissue.position(static_cast<int>(lane), 31 * (10 + phase_of(lane) % 8) + 27);
        tissue.hold(static_cast<int>(lane), tip[lane], 0.005, false);
      }
      if (now == 250) tissue.release(static_cast<int>(lane));
      const Vector3d next = tip[lane] + Vector3d(0, -1e-4, now > 100 && now < 200 ? 4e-4 : 0.0);
      motion[lane] = {tip[lane], next};
      tip[lane] = next;
    }
    tissue.step(motion);
  }
  std::vector<std::uint64_t> hashes;
  for (std::size_t lane = 0; lane < lanes; ++lane) {
    EXPECT_TRUE(tissue.healthy(static_cast<int>(lane)));
    hashes.push_back(tissue.hash(static_cast<int>(lane)));
  }
  return hashes;
}

std::shared_ptr<const ShellTissueModel> busy_sheet() {
  ShellCase c = over_sphere();
  c.poisson = 0.3;
  c.static_friction = 0.3;
  c.dynamic_friction = 0.2;
  Scene scene = test::make_shell_scene(c);
  scene.config.mutable_tool()->set_contact(true);
  std::vector<std::string> warnings;
  return make_shell_model(scene, 0.02, warnings);
}

/// The same life on a mesh without order that wants to be curved.
std::shared_ptr<const ShellTissueModel> busy_mesh() {
  ShellCase c = over_sphere();
  c.poisson = 0.3;
  c.static_friction = 0.3;
  Scene scene = test::make_mesh_scene(c, test::make_irregular_mesh(c, 0.25));
  scene.config.mutable_tool()->set_contact(true);
  scene.config.mutable_tissue()->mutable_effects()->mutable_rest_shape()->set_curvature_x_per_m(2);
  std::vector<std::string> warnings;
  return make_shell_model(scene, 0.02, warnings);
}

class BusySheet : public testing::TestWithParam<std::shared_ptr<const ShellTissueModel> (*)()> {};
INSTANTIATE_TEST_SUITE_P(Elastic, BusySheet, testing::Values(busy_sheet, busy_mesh),
                         [](const auto& sheet) { return sheet.index == 0 ? "Grid" : "Mesh"; });

TEST_P(BusySheet, WidthsAgreeAndLaneEqualsBatchOfOne) {
  constexpr int kSteps = 400;
  const auto model = GetParam()();
  std::vector<int> phases;
  for (int k = 0; k < kPhases; ++k) phases.push_back(k);
  const auto at8 = live(model, f32x8(), {0, 1, 2, 3, 4, 5, 6, 7}, kSteps);
  for (const int k : {0, 4, 7}) {
    EXPECT_EQ(live(model, f32x1(), {k}, kSteps)[0], at8[static_cast<std::size_t>(k)]) << k;
  }
  if (__builtin_cpu_supports("avx512f") == 0) {
    std::puts("16 lanes skipped: no AVX-512 on this CPU");
    return;
  }
  const auto at16 = live(model, f32x16(), phases, kSteps);
  for (std::size_t k = 0; k < 8; ++k) EXPECT_EQ(at16[k], at8[k]) << k;
}

TEST(Elastic, BatchCompositionIsIrrelevant) {
  const auto model = busy_sheet();
  const auto a = live(model, f32x8(), {0, 1, 2}, 300);
  const auto b = live(model, f32x8(), {2, 0, 9}, 300);
  EXPECT_EQ(a[2], b[0]);
  EXPECT_EQ(a[0], b[1]);
}

TEST(Elastic, ADivergedLanePoisonsItselfOnly) {
  const auto model = busy_sheet();
  ShellTissue<float> spoiled(model, f32x8());
  ShellTissue<float> healthy(model, f32x8());
  spoiled.set_velocity(3, 480, Vector3d(std::nan(""), 0, 0));
  run_free(spoiled, 1);
  run_free(healthy, 1);
  EXPECT_FALSE(spoiled.healthy(3));
  for (const int lane : {0, 1, 2, 4, 5, 6, 7}) {
    EXPECT_TRUE(spoiled.healthy(lane));
    EXPECT_EQ(spoiled.hash(lane), healthy.hash(lane)) << lane;
  }
}

TEST(Elastic, ResetOfOneLaneLeavesOthers) {
  const auto model = busy_sheet();
  ShellTissue<float> a(model, f32x8());
  ShellTissue<float> b(model, f32x8());
  run_free(a, 0.5);
  run_free(b, 0.5);
  a.reset(5, Vector3d(0, 0, 0.01));
  run_free(a, 0.2);
  run_free(b, 0.2);
  for (const int lane : {0, 4, 6, 7}) EXPECT_EQ(a.hash(lane), b.hash(lane)) << lane;
  EXPECT_NE(a.hash(5), b.hash(5));
}

TEST(Elastic, SavedStateGoesOnAsIfNothingHadHappened) {
  ShellCase first = over_sphere();
  ShellCase second = first;
  second.integrator = pb::INTEGRATOR_BDF2;
  for (const auto& model : {make_shell_sheet(first), make_shell_sheet(second), busy_mesh()}) {
    ShellTissue<float> a(model, f32x1());
    run_free(a, 0.5);
    a.set_parameters(0, {.stiffness_scale = 1.4, .gravity_scale = 0.9, .damping_scale = 2});
    const Vector3d tip = a.position(0, 31 * 15 + 28);
    a.hold(0, tip, 0.005, false);
    move_tool(a, tip, tip + Vector3d(0, 0, 0.01), 20);
    Bytes saved;
    a.save(0, saved);
    ShellTissue<float> b(model, f32x8());
    const auto used = b.load(5, saved);
    ASSERT_TRUE(used) << used.error();
    EXPECT_EQ(used.value(), saved.size());
    EXPECT_EQ(b.hash(5), a.hash(0));
    EXPECT_TRUE(std::ranges::equal(b.held(5), a.held(0)));
    move_tool(a, tip, tip + Vector3d(0, 0, 0.01), 20);
    move_tool(b, tip, tip + Vector3d(0, 0, 0.01), 20);
    EXPECT_EQ(b.hash(5), a.hash(0));
  }
}

TEST(Elastic, BadStateIsRefusedAndChangesNothing) {
  ShellTissue<float> tissue(make_shell_sheet({}), f32x1());
  tissue.hold(0, tissue.position(0, 31 * 15 + 28), 0.005, false);
  run_free(tissue, 0.1);
  Bytes good;
  tissue.save(0, good);
  const std::uint64_t hash = tissue.hash(0);
  const auto refused = [&](Bytes bytes) { return !tissue.load(0, bytes).has_value(); };
  for (std::size_t size = 0; size < good.size(); size += 97) {
    EXPECT_TRUE(refused(Bytes(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(size))));
  }
  const auto spoilt = [&](std::size_t at, const auto& value) {
    Bytes bytes = good;
    std::memcpy(bytes.data() + at, &value, sizeof value);
    return refused(bytes);
  };
  const std::size_t grasp = good.size() - 13 * sizeof(double);  // place, radius; nine targets
  EXPECT_TRUE(spoilt(400, std::nanf("")));
  EXPECT_TRUE(spoilt(grasp - 36, -1.0));               // stiffness scale
  EXPECT_TRUE(spoilt(grasp - 4, std::uint32_t{5}));    // what follows
  EXPECT_TRUE(spoilt(grasp, 0.046));                   // beside the sheet
  EXPECT_TRUE(spoilt(grasp + 8, -0.045));              // on the clamp
  EXPECT_TRUE(spoilt(grasp + 16, 1e-3));               // above it
  EXPECT_TRUE(spoilt(grasp + 24, 0.0));                // no radius
  EXPECT_TRUE(spoilt(grasp + 24, std::nan("")));       // no radius
  EXPECT_TRUE(spoilt(good.size() - 8, std::nan("")));  // a target
  EXPECT_EQ(tissue.hash(0), hash);
  EXPECT_FALSE(refused(good));
}

}  // namespace
}  // namespace omentum
