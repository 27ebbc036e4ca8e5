// A lane whose state is no longer finite is begun anew as if nothing had been: a task depends on
// its start alone, whatever the lane held before.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "core/config.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kBroken = 2;

/// The tool comes down beside the tumour, through sheet and what is under it, and drags a grasp.
void drag_through(Tissue<float>& tissue) {
  const Vector3d from(-0.025, 0.045, 0.06);
  Vector3d tip = from;
  for (int step = 0; step < 24; ++step) {
    const Vector3d next = tip + Vector3d(0, 0, step < 12 ? -0.003 : 0.002);
    if (step == 12) {
      for (int lane = 0; lane < tissue.lanes(); ++lane) tissue.hold(lane, tip, 0.02, false);
    }
    tissue.step(std::vector<ToolMotion>(static_cast<std::size_t>(tissue.lanes()), {tip, next}));
    tip = next;
  }
}

class BrokenLane : public testing::TestWithParam<std::string> {};

TEST_P(BrokenLane, LeavesNoTraceAfterAResetOrALoad) {
  const pb::Config config = load_config(GetParam(), {});
  const auto setup = make_sim_setup(config, deploy_dir() + "/scenes");
  const auto fresh = setup->tissue->make_tissue(f32x8());
  for (int lane = 0; lane < fresh->lanes(); ++lane) fresh->reset(lane, Vector3d::Zero());
  Bytes start;
  fresh->save(kBroken, start);
  drag_through(*fresh);
  ASSERT_TRUE(fresh->healthy(kBroken));

  for (const double speed : {1e3, 1e30, std::numeric_limits<double>::quiet_NaN()}) {
    for (const bool by_load : {false, true}) {
      const auto tissue = setup->tissue->make_tissue(f32x8());
      for (int lane = 0; lane < tissue->lanes(); ++lane) tissue->reset(lane, Vector3d::Zero());
      for (int i = 0; i < tissue->particles(); ++i)
        tissue->set_velocity(kBroken, i, Vector3d(speed, -speed, i % 2 == 0 ? speed : -speed));
      drag_through(*tissue);
      if (std::isnan(speed)) {
        EXPECT_FALSE(tissue->healthy(kBroken));
      }
      for (int lane = 0; lane < tissue->lanes(); ++lane) {
        if (lane == kBroken) continue;
        EXPECT_EQ(tissue->hash(lane), fresh->hash(lane)) << "beside it: lane " << lane;
        tissue->reset(lane, Vector3d::Zero());
      }
      if (by_load) {
        ASSERT_TRUE(tissue->load(kBroken, start).has_value());
      } else {
        tissue->reset(kBroken, Vector3d::Zero());
      }
      drag_through(*tissue);
      EXPECT_TRUE(tissue->healthy(kBroken));
      EXPECT_EQ(tissue->hash(kBroken), fresh->hash(kBroken)) << speed << (by_load ? " load" : "");
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Presets, BrokenLane,
                         testing::Values("omentum", "paper_literal", "omentum_elastic",
                                         "omentum_soft"),
                         [](const auto& param_info) { return param_info.param; });

}  // namespace
}  // namespace omentum
