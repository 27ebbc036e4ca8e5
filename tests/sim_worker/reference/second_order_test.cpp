// The reference solid at its default tolerance against second-order bricks of another engine
// (tests/reference/README.md). All cases, with the shell and the printed error: second_order_study.

#include "support/second_order.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <string>

namespace omentum {
namespace {

constexpr double kTolerance = 5e-5;  // of the surface [m], the default
constexpr double kForce = 0.01;      // relative

class SecondOrderBricks : public testing::TestWithParam<const char*> {};

TEST_P(SecondOrderBricks, AgreeWithTheDefaultMesh) {
  const test::SecondOrder c =
      test::read_second_order(std::string(OMENTUM_SOURCE_DIR) +
                              "/tests/reference/results/second_order/" + GetParam() + ".txt");
  // An engine whose own grids differ by more judges nothing.
  ASSERT_LT(c.values.at("own_error")[0], 0.3 * kTolerance);
  const test::StaticState state = test::settle_reference(c, test::make_second_order_scene(c));
  ASSERT_EQ(state.failure, "");
  const double rms = test::rms_distance(state.points, c.deformed);
  const double force =
      c.has("force") ? (state.force - c.vector("force")).norm() / c.vector("force").norm() : 0;
  std::printf("# %s: %.4f mm rms, force %.3f %%\n", GetParam(), 1e3 * rms, 100 * force);
  EXPECT_LT(rms, kTolerance);
  EXPECT_LT(force, kForce);
}

const auto kName = [](const testing::TestParamInfo<const char*>& info) {
  return std::string(info.param);
};

INSTANTIATE_TEST_SUITE_P(Reference, SecondOrderBricks,
                         testing::Values("droop_60kPa", "droop_10kPa", "beam_60kPa",
                                         "edge_disc_60kPa"),
                         kName);

}  // namespace
}  // namespace omentum
