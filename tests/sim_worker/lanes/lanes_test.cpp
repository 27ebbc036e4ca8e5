// One source, three widths, one set of bits; and the single precision product against the double
// precision oracle.

#include <gtest/gtest.h>

#include <cmath>

#include "core/config.h"
#include "core/hash.h"
#include "sim_worker/backend/sim_backend.h"
#include "sim_worker/models.h"
#include "support/cluster_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

bool cpu_runs(unsigned width) {
  try {
    choose_kernel(width);
    return true;
  } catch (const Error&) {
    return false;
  }
}

/// Lift task with grasp and contact; lane k starts its lift k steps later, so that lanes are in
/// different phases.
std::vector<std::uint64_t> lift_hashes(const std::shared_ptr<const SimSetup>& setup, int lanes,
                                       unsigned width, int steps, const std::vector<int>& phases) {
  SimBackend backend(setup, lanes, width);
  for (int lane = 0; lane < lanes; ++lane) {
    EpisodeStart start;
    start.start_set = StartSet::kGraspLattice;
    start.start_index =
        static_cast<std::uint32_t>(500 + 7 * phases[static_cast<std::size_t>(lane)]);
    start.episode_limit = 100000;
    backend.reset(lane, start);
  }
  std::vector<Action> actions(static_cast<std::size_t>(lanes));
  std::vector<StepOutcome> outcomes(actions.size());
  for (int step = 0; step < steps; ++step) {
    for (int lane = 0; lane < lanes; ++lane) {
      const int phase = phases[static_cast<std::size_t>(lane)];
      Action stay;
      stay.branch = {1, 1, 1, 1};
      actions[static_cast<std::size_t>(lane)] = step < 3 * phase ? stay : backend.hold_action(lane);
      if (step > 900 + phase) actions[static_cast<std::size_t>(lane)].branch[3] = 0;  // let it fall
    }
    backend.step(actions, outcomes);
  }
  std::vector<std::uint64_t> hashes;
  for (int lane = 0; lane < lanes; ++lane) hashes.push_back(fnv1a64(backend.save(lane)));
  return hashes;
}

TEST(Tissue, WidthsAgreeAndLaneEqualsBatchOfOne) {
  const auto setup = make_sim_setup(load_config("omentum", {}), deploy_dir() + "/scenes");
  std::vector<int> phases;
  for (int k = 0; k < 16; ++k) phases.push_back(k);
  const auto at8 = lift_hashes(setup, 16, 8, 1500, phases);
  if (cpu_runs(16)) {
    EXPECT_EQ(lift_hashes(setup, 16, 16, 1500, phases), at8);
  } else {
    std::puts("16 lanes skipped: no AVX-512 on this CPU");
  }
  for (const int k : {0, 7, 13}) {
    EXPECT_EQ(lift_hashes(setup, 1, 1, 1500, {k})[0], at8[static_cast<std::size_t>(k)])
        << "lane " << k;
  }
}

TEST(Tissue, BatchCompositionIsIrrelevant) {
  const auto setup = make_sim_setup(load_config("paper", {}), deploy_dir() + "/scenes");
  const auto a = lift_hashes(setup, 3, 8, 300, {0, 1, 2});
  const auto b = lift_hashes(setup, 3, 8, 300, {2, 0, 9});
  EXPECT_EQ(a[2], b[0]);
  EXPECT_EQ(a[0], b[1]);
}

TEST(Tissue, ADivergedLanePoisonsItselfOnly) {
  test::SheetCase c;
  const auto model = test::make_sheet_model(c);
  ClusterTissue<float> spoiled(model, f32x8());
  ClusterTissue<float> healthy(model, f32x8());
  spoiled.set_velocity(3, 465, Vector3d(std::nan(""), 0, 0));
  test::run_free(spoiled, 1);
  test::run_free(healthy, 1);
  EXPECT_FALSE(spoiled.healthy(3));
  for (const int lane : {0, 1, 2, 4, 5, 6, 7}) {
    EXPECT_TRUE(spoiled.healthy(lane));
    EXPECT_EQ(spoiled.hash(lane), healthy.hash(lane)) << lane;
  }
}

TEST(Oracle, LiftTaskInSinglePrecisionFollowsDoublePrecision) {
  // 20 s: settle, lift a patch of the free edge by 60 mm, hold.
  test::SheetCase c;
  c.spacing = 0.0095;
  c.radius = 0.0127;
  c.substeps = 10;
  c.iterations = 1;
  const auto model = test::make_sheet_model(c);
  const auto lift = [&model](auto& tissue) {
    test::run_free(tissue, 5);
    const Vector3d grip = tissue.position(0, 15 * 30 + 28);
    tissue.hold(0, grip, 0.005, false);
    Vector3d tip = grip;
    for (int step = 0; step < 750; ++step) {
      const Vector3d next = step < 160 ? Vector3d(tip + Vector3d(0, 0, 0.000375)) : tip;
      std::vector<ToolMotion> motion(static_cast<std::size_t>(tissue.lanes()),
                                     ToolMotion{tip, next});
      tissue.step(motion);
      tip = next;
    }
  };
  ClusterTissue<float> single(model, f32x1());
  ClusterTissue<double> exact(model, f64x1());
  lift(single);
  lift(exact);
  double sum = 0;
  for (int i = 0; i < single.particles(); ++i)
    sum += (single.position(0, i) - exact.position(0, i)).squaredNorm();
  EXPECT_LT(std::sqrt(sum / single.particles()), 0.05e-3);  // docs/tissue.md 12
}

TEST(Scene, OmentumSheetHasSixKilopascal) {
  // docs/task.md 2.1: stiffness so that E_eff is 6 kPa; measured as extension of the sheet hanging
  // in its plane.
  const pb::Config config = load_config("omentum", {});
  const pb::ClusterModel& cluster = config.scene().tissue().cluster();
  test::SheetCase c;
  c.nx = c.ny = 31;
  c.anchor_max_y = -0.042;
  c.spacing = cluster.cluster_spacing_m();
  c.radius = cluster.cluster_radius_m();
  c.stiffness = cluster.cluster_stiffness();
  c.substeps = cluster.substeps();
  c.iterations = cluster.iterations();
  c.gravity = 0.981;
  c.X_WB.linear() =
      Eigen::AngleAxisd(-1.57079632679489661923, Vector3d::UnitX()).toRotationMatrix();
  const auto model = test::make_sheet_model(c);
  ClusterTissue<double> tissue(model, f64x1());
  test::run_free(tissue, 8);
  double extension = 0;
  for (int ix = 0; ix < 31; ++ix) extension += (-0.045 - tissue.position(0, ix * 31 + 30).z()) / 31;
  const double length = 0.045 + 0.042;
  EXPECT_NEAR(1000 * c.gravity * length * length / (2 * extension) / 6e3, 1.0, 0.05);
}

}  // namespace
}  // namespace omentum
