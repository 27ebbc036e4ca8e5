// The exposure without rendering (sim_worker/backend/exposure.h) against the image it stands for.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstdio>
#include <random>

#include "core/config.h"
#include "sim_worker/backend/sim_backend.h"
#include "sim_worker/camera/camera.h"
#include "sim_worker/models.h"
#include "tests/support/image_exposure.h"
#include "tests/support/screen.h"

namespace omentum {
namespace {

using test::scene_with_one_rectangle;
using test::screen;

constexpr int kStates = 200;

/// Calls `visit` with the back end and a lane in `count` states of the sheet of preset omentum:
/// lifted from random points of the lattice, and held for random times.
template <typename Visit>
void for_random_states(SimBackend& backend, int count, Visit&& visit) {
  std::minstd_rand random(7);
  const auto draw = [&random](std::uint32_t below) {
    return static_cast<std::uint32_t>(random() % below);
  };
  const auto particles = static_cast<std::uint32_t>(backend.setup().scene.tissue.particles.size());
  std::vector<Action> actions(static_cast<std::size_t>(backend.lanes()));
  std::vector<StepOutcome> outcomes(actions.size());
  for (int states = 0; states < count;) {
    for (int lane = 0; lane < backend.lanes(); ++lane) {
      EpisodeStart start;
      start.start_set = StartSet::kGraspLattice;
      start.start_index = draw(particles);
      start.episode_limit = 1U << 30;
      backend.reset(lane, start);
    }
    const unsigned steps = draw(250);
    for (unsigned step = 0; step < steps; ++step) {
      for (std::size_t k = 0; k < actions.size(); ++k) {
        actions[k] = backend.hold_action(static_cast<int>(k));
      }
      backend.step(actions, outcomes);
    }
    for (int lane = 0; lane < backend.lanes() && states < count; ++lane, ++states) {
      visit(backend, lane);
    }
  }
}

std::shared_ptr<const SimSetup> omentum_setup(const std::vector<std::string>& overrides = {}) {
  return make_sim_setup(load_config("omentum", overrides), deploy_dir() + "/scenes");
}

int widest() { return choose_kernel(0).lanes; }

TEST(ExposureEstimate, EqualsTheImageOnRandomLifts) {
  const auto setup = omentum_setup();
  SimBackend backend(setup, widest());
  Camera camera(setup->scene, 64, 64);
  double largest = 0, squares = 0, low = 1, high = 0;
  std::vector<float> vertices;
  for_random_states(backend, kStates, [&](SimBackend& b, int lane) {
    b.surface(lane, vertices);
    const double image = test::exposure_from_image(camera, setup->scene, {vertices, {}}).fraction();
    const double difference = setup->exposure->full(vertices) - image;
    largest = std::max(largest, std::fabs(difference));
    squares += difference * difference;
    low = std::min(low, image);
    high = std::max(high, image);
  });
  std::printf("exposure full - image: rms %.4f, largest %.4f; images %.3f ... %.3f\n",
              std::sqrt(squares / kStates), largest, low, high);
  EXPECT_LE(largest, 0.02);  // required: of full scale
  EXPECT_LT(low, 0.05);      // the states cover the range
  EXPECT_GT(high, 0.5);
}

TEST(ExposureEstimate, SubsetIsNearTheFullEstimate) {
  const auto setup = omentum_setup();
  ASSERT_GE(setup->exposure->full_samples().size(), 10'000);
  ASSERT_EQ(setup->exposure->subset_samples().size(), 256);
  SimBackend backend(setup, widest());
  double largest = 0, squares = 0;
  std::vector<float> vertices;
  for_random_states(backend, kStates, [&](SimBackend& b, int lane) {
    b.surface(lane, vertices);
    const double difference = setup->exposure->subset(vertices) - setup->exposure->full(vertices);
    largest = std::max(largest, std::fabs(difference));
    squares += difference * difference;
  });
  const double rms = std::sqrt(squares / kStates);
  std::printf("exposure subset - full: rms %.4f, largest %.4f\n", rms, largest);
  EXPECT_LE(rms, 0.01);  // 256 samples: an edge across the disc cuts about 18 cells of 1/256
  EXPECT_LE(largest, 0.04);
}

TEST(ExposureEstimate, OfLanesEqualsSubsetBitForBit) {
  const auto setup = omentum_setup();
  for (const unsigned width : {1U, 8U, static_cast<unsigned>(widest())}) {
    const int lanes = choose_kernel(width).lanes;
    SimBackend backend(setup, lanes, width);
    ExposureEstimator estimator = *setup->exposure;
    std::vector<float> vertices;
    for_random_states(backend, width == 1 ? 8 : 64, [&](SimBackend& b, int lane) {
      b.surface(lane, vertices);
      std::vector<float> exposures(static_cast<std::size_t>(lanes), -1.0F);
      estimator.of_lanes(b.tissue_of(lane), 1U << lane, exposures);
      for (int other = 0; other < lanes; ++other) {
        const float wanted = other == lane ? static_cast<float>(estimator.subset(vertices)) : -1.0F;
        EXPECT_EQ(std::bit_cast<std::uint32_t>(exposures[static_cast<std::size_t>(other)]),
                  std::bit_cast<std::uint32_t>(wanted));
      }
    });
  }
}

/// The same scene with what the loader would have made of its bodies.
Scene rectangle_scene() {
  Scene scene = scene_with_one_rectangle();
  for (RigidShape& body : scene.bodies) body.surface = make_ellipsoid_mesh(body.size, 48, 96);
  return scene;
}

TEST(ExposureEstimate, HalfCovered) {
  const Scene scene = rectangle_scene();
  const ExposureEstimator estimator(scene, 256);
  for (const auto& [low, high] : {std::pair{-4.0, 0.0}, {0.0, 4.0}}) {
    const std::vector<float> positions = screen(scene, low, high);
    EXPECT_NEAR(estimator.full(positions), 0.5, 0.01);    // required: within 1 %
    EXPECT_NEAR(estimator.subset(positions), 0.5, 0.02);  // half of 18 cells along the edge
  }
  // A chord at half the radius leaves 1 - (1/3 - sqrt(3) / (4 pi)) = 0.8045 of the disc.
  EXPECT_NEAR(estimator.full(screen(scene, 0.5, 4)), 0.8045, 0.01);
}

TEST(ExposureEstimate, FullAndNone) {
  const Scene scene = rectangle_scene();
  const ExposureEstimator estimator(scene, 256);
  for (const auto& [low, high, share] : {std::tuple{1.1, 4.0, 1.0}, {-4.0, 4.0, 0.0}}) {
    const std::vector<float> positions = screen(scene, low, high);
    EXPECT_EQ(estimator.full(positions), share);
    EXPECT_EQ(estimator.subset(positions), share);
    EXPECT_EQ(estimator.seed_64px(positions), share);
  }
  Scene without = scene;
  without.tumour = -1;
  EXPECT_EQ(ExposureEstimator(without, 256).full(screen(scene, 1.1, 4)), 0);
}

TEST(ExposureEstimate, IsAPureFunctionOfTheStateUnlessTheDefectIsOn) {
  SimBackend pure(omentum_setup(), 1, 1);
  SimBackend racy(omentum_setup({"defects.exposure_racy=true"}), 1, 1);
  EpisodeStart start;
  start.start_set = StartSet::kGraspLattice;
  start.start_index = 600;
  start.episode_limit = 1U << 30;
  pure.reset(0, start);
  std::vector<Action> actions(1);
  std::vector<StepOutcome> outcomes(1);
  for (int step = 0; step < 150; ++step) {
    actions[0] = pure.hold_action(0);
    pure.step(actions, outcomes);
  }
  const Bytes state = pure.save(0);
  const float exposure = pure.facts(0).exposure;
  ASSERT_GT(exposure, 0.1F);
  EXPECT_EQ(pure.facts(0).exposure, exposure);
  pure.reset(0, start);
  ASSERT_TRUE(pure.load(0, state));
  EXPECT_EQ(pure.facts(0).exposure, exposure);
  // The same sheet, read at the next moment: the seed's counter is empty every other time.
  actions[0] = pure.hold_action(0);
  pure.step(actions, outcomes);
  ASSERT_TRUE(racy.load(0, state));
  EXPECT_EQ(racy.facts(0).exposure, exposure);
  racy.step(actions, outcomes);
  EXPECT_GT(pure.facts(0).exposure, 0.1F);
  EXPECT_EQ(racy.facts(0).exposure, 0);
}

}  // namespace
}  // namespace omentum
