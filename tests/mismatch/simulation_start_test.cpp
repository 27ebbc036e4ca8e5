// How a simulated recording begins and what holds the body: a second clamp, none, a start velocity.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <string>

#include "core/check.h"
#include "core/config.h"
#include "sim_worker/playback/simulation.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kGravity = 9.80665;  // [m/s^2]

/// A strip 9 mm wide and 48 mm long, without Poisson's ratio, in air; nothing is held
/// and nothing touches it. `more` goes into scene.tissue, `scene` beside it.
SimulationTask strip_task(const std::string& model, const std::string& more,
                          const std::string& scene = "", double damping_per_s = 0) {
  const test::TempDir folder;
  std::ofstream(folder / "strip.txtpb") << R"(
tissue {
  grid { count_x: 7 count_y: 33 pitch_m: 0.0015 }
  density_kg_per_m3: 1000
  thickness_m: 0.003
  model: )" << model << R"(
  material { young_modulus_pa: 1e6 poisson_ratio: 0 damping_per_s: )"
                                        << damping_per_s << R"( }
  elastic { substeps: 10 }
)" << more << "}\ntool { base { translation_m { x: 0.1427 z: 0.1584 } } contact: false }\n"
                                        << scene;
  SimulationTask task;
  task.scene = load_scene(folder / "strip.txtpb", {});
  task.commands.time = {0, 0.1};
  task.commands.p_WT = {Vector3d(0.3, 0, 0.1), Vector3d(0.3, 0, 0.1)};
  task.commands.jaw_rad = {1, 1};
  return task;
}

Vector3d mean_of(const std::vector<Vector3d>& points) {
  Vector3d sum = Vector3d::Zero();
  for (const Vector3d& p : points) sum += p;
  return sum / static_cast<double>(points.size());
}

class SimulationStart : public testing::TestWithParam<const char*> {};

// Both clamps leave 42 mm: w = q L^4 / (384 D) in the middle, D = E t^3 / 12, q = rho g t, and of a
// solid the shear adds q L^2 / (8 (5/6) G t), which a shell has none of.
TEST_P(SimulationStart, AStripBetweenTwoClampsHangsAsABuiltInBeamAndAlike) {
  const Simulation made =
      simulate(strip_task(GetParam(), "anchor_max_y_m: -0.021 anchor_min_y_m: 0.021"));
  ASSERT_EQ(made.recording.failure, "");
  const std::vector<Vector3d>& end = made.recording.points.back();
  const auto at = [&](int iy) { return end[static_cast<std::size_t>(33 + iy)].z(); };
  const double rigidity = 1e6 * std::pow(0.003, 3) / 12;
  const double load = 1000 * kGravity * 0.003;
  const bool shears = std::string(GetParam()) == "TISSUE_REFERENCE";
  const double sag = load * std::pow(0.042, 4) / (384 * rigidity) +
                     (shears ? load * 0.042 * 0.042 / (8 * 5.0 / 6 * 5e5 * 0.003) : 0);
  EXPECT_NEAR(at(0) - at(16), sag, 0.03 * sag);
  for (int iy = 0; iy < 16; ++iy) EXPECT_NEAR(at(iy), at(32 - iy), 1e-3 * sag) << iy;
  EXPECT_NEAR(at(32), at(30), 1e-12) << "the second clamp holds its strip";
}

TEST_P(SimulationStart, AFreeBodyFallsAsAWholeFromTheVelocityOfItsStart) {
  const Vector3d v(0.2, -0.1, 0.3);
  const Simulation made = simulate(strip_task(GetParam(), "anchor_max_y_m: -1",
                                              "start_velocity_m_per_s { x: 0.2 y: -0.1 z: 0.3 }"));
  ASSERT_EQ(made.recording.failure, "");
  EXPECT_THAT(made.scene.warnings, testing::Contains(testing::HasSubstr("so it falls")));
  const double t = made.recording.time.back();
  const Vector3d way = v * t - Vector3d(0, 0, 0.5 * kGravity * t * t);
  const std::vector<Vector3d>& first = made.recording.points.front();
  const std::vector<Vector3d>& last = made.recording.points.back();
  // Implicit steps of first order are late by half a step of the fall.
  const double late = 0.5 * kGravity * t * 0.02;
  EXPECT_LT((mean_of(last) - mean_of(first) - way).norm(), 1.01 * late);
  for (std::size_t i = 0; i < first.size(); ++i)
    EXPECT_LT((last[i] - first[i] - (last[0] - first[0])).norm(), 1e-6) << i;
}

TEST_P(SimulationStart, AVelocityMovesAClampedStripFromItsRest) {
  constexpr double kStep = 0.002;  // [s]: a thirtieth of its first swing
  const auto first_step = [](const std::string& scene) {
    SimulationTask task = strip_task(GetParam(), "anchor_max_y_m: -0.021", scene, 20);
    task.period = kStep;
    return simulate(task).recording.points;
  };
  const auto rests = first_step("");
  const auto moves = first_step("start_velocity_m_per_s { z: 0.05 }");
  EXPECT_EQ(rests.front(), moves.front());
  const std::size_t tip = 33 + 32;
  EXPECT_NEAR((moves[1][tip] - rests[1][tip]).z(), 0.05 * kStep, 0.1 * 0.05 * kStep);
  EXPECT_EQ(rests[1][0], moves[1][0]) << "clamped";
}

INSTANTIATE_TEST_SUITE_P(Models, SimulationStart,
                         testing::Values("TISSUE_REFERENCE", "TISSUE_ELASTIC"));

TEST(SimulationStart, ThePlaceWhereABodyWasHeldHasItsDerivative) {
  constexpr double kStep = 1e-5;   // [m]
  constexpr double kUntil = 0.04;  // [s]
  const auto held_at = [&](double z, const std::string& columns) {
    SimulationTask task = strip_task(
        "TISSUE_REFERENCE",
        "anchor_max_y_m: -0.021 reference { elements_x: 1 elements_y: 12 elements_z: 1 }",
        fmt::format("held_start {{ y_m: 0.0225 radius_m: 0.003 position_m {{ y: 0.0222 z: {} }} "
                    "until_s: {} }}",
                    z, kUntil),
        5);
    task.parameters = columns;
    for (std::size_t step = 0; step <= 5; ++step) task.column_steps.push_back(step);
    return simulate(task);
  };
  const Simulation base = held_at(0.003, "held_start.z,held_start.x");
  const Simulation low = held_at(0.003 - kStep, ""), high = held_at(0.003 + kStep, "");
  for (std::size_t step = 0; step <= 5; ++step) {
    const std::vector<float>& column = base.columns.at(step).surface[0];
    double squares = 0, errors = 0;
    for (std::size_t i = 0; i < base.recording.points[step].size(); ++i) {
      const Vector3d slope =
          (high.recording.points[step][i] - low.recording.points[step][i]) / (2 * kStep);
      squares += slope.squaredNorm();
      errors += (slope - Eigen::Map<const Eigen::Vector3f>(column.data() + 3 * i).cast<double>())
                    .squaredNorm();
    }
    EXPECT_LT(errors, 1e-4 * squares) << "step " << step;
  }
  EXPECT_GT(base.columns.at(0).surface[1][3 * 32], 0.3) << "the end follows sideways, too";
}

TEST(SimulationStart, WhatCannotBeMeantIsRefusedByName) {
  const auto refusal = [](const std::string& tissue, const std::string& scene = "") {
    try {
      simulate(strip_task("TISSUE_REFERENCE", tissue, scene));
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  EXPECT_THAT(refusal("anchor_max_y_m: -1", "target_m { z: 0.1 }"),
              testing::HasSubstr("anchor_max_y_m: -1 fixes no particle"));
  EXPECT_THAT(refusal("anchor_max_y_m: 0 anchor_min_y_m: 0.001"),
              testing::HasSubstr("fix 231 of 231 particles"));
  EXPECT_THAT(refusal("anchor_max_y_m: -0.021 anchor_min_y_m: 0.021 "
                      "effects { anchor { compliance_m2_per_n: 1e-3 } }"),
              testing::HasSubstr("allowed with one clamp"));
  EXPECT_THAT(refusal("anchor_max_y_m: -0.021",
                      "held_start { y_m: 0.02 } start_velocity_m_per_s { z: 0.1 }"),
              testing::HasSubstr("allowed without scene.held_start"));
  SimulationTask task = strip_task("TISSUE_REFERENCE", "anchor_max_y_m: -0.021");
  task.parameters = "held_start.z";
  EXPECT_THROW(simulate(task), Error);
}

}  // namespace
}  // namespace omentum
