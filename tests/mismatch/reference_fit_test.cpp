// The search of a calibration on surfaces that were made here, not simulated.
#include "mismatch/calibrate/reference_fit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>

#include "core/config.h"
#include "core/constants.h"
#include "mismatch/calibrate/clock_posterior.h"
#include "mismatch/calibrate/descent.h"
#include "mismatch/calibrate/starts.h"
#include "sim_worker/reference/reference_model.h"
#include "support/fitted_sheet.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::VectorXd;
using test::FittedSheet;

constexpr double kTurnDeg = 0.6;

PredictedFrame frame_between(double later) {
  const auto surface = [](double x) {
    return std::make_shared<const std::vector<Vector3d>>(1, Vector3d(x, 0, 0));
  };
  PredictedFrame frame;
  frame.valid = true;
  // It stands, then moves 2 mm in a step of 20 ms.
  frame.way = {{later - 0.02, surface(0)}, {later, surface(0)}, {later + 0.02, surface(0.002)}};
  frame.vertices = {Vector3d::Zero()};
  frame.velocity = {Vector3d::Zero()};
  return frame;
}

TEST(MoveInTime, FollowsTheWayAndRestsAtItsEnds) {
  const PredictedFrame frame = frame_between(0.01);
  std::vector<Vector3d> place, velocity;
  move_in_time(frame, 0.02, place, velocity);
  EXPECT_NEAR(place[0].x(), 0.001, 1e-12) << "what stands now moves later";
  EXPECT_NEAR(velocity[0].x(), 0.1, 1e-12);
  move_in_time(frame, 1, place, velocity);
  EXPECT_EQ(place[0].x(), 0.002);
  EXPECT_EQ(velocity[0].x(), 0);
  move_in_time(frame, -1, place, velocity);
  EXPECT_EQ(place[0].x(), 0);
}

/// A lift of 10 mm from 0.2 s to 0.6 s, jaws closed from 0.1 s on, a cloud at rest and one held;
/// the sensor shows `zero` and, once the jaws hold, (0, 0, -0.1 N).
Recording recording_with_force(const Scene& scene, double force_begins) {
  const Vector3d zero(0.02, -0.01, 0.03);
  Recording made;
  Series& tool = made.series["tool_commanded"];
  tool.columns = {"tip_commanded_x_m", "tip_commanded_y_m", "tip_commanded_z_m"};
  Series& jaw = made.series["jaw"];
  jaw.columns = {"jaw_commanded_rad"};
  Series& force = made.series["force"];
  force.columns = {"fx_N", "fy_N", "fz_N"};
  const auto middle =
      static_cast<std::ptrdiff_t>(scene.tissue.particles.size() / 2);  // an odd number of them
  const Vector3d centre = scene.tissue.X_WB * *(scene.tissue.particles.begin() + middle);
  for (int k = 0; k <= 100; ++k) {
    const double t = 0.01 * k;
    const double height = 0.01 * std::clamp((t - 0.2) / 0.4, 0.0, 1.0);
    for (Series* series : {&tool, &jaw, &force}) {
      if (series != &force || t >= force_begins) series->time_ns.push_back(10'000'000LL * k);
    }
    tool.values.insert(tool.values.end(), {centre.x(), centre.y(), centre.z() + height});
    jaw.values.push_back(t < 0.095 ? 0.5 : 0);
    if (t < force_begins) continue;
    for (int axis = 0; axis < 3; ++axis)
      force.values.push_back(zero[axis] - (axis == 2 && t > 0.095 ? 0.1 : 0));
  }
  made.clouds.time_ns = {50'000'000, 900'000'000};
  made.clouds.number = {0, 1};
  made.clouds.fetch = [centre](std::size_t) { return Cloud(30, centre.cast<float>()); };
  return made;
}

TEST(Observe, AForceCountsFromWhereTheJawsHoldAboveItsZero) {
  const Scene scene = make_scene(load_scene(deploy_dir() + "/scenes/omentum.txtpb", {}), "");
  std::vector<std::string> warnings;
  const Observation seen = observe("a", "a", recording_with_force(scene, 0), scene, warnings);
  ASSERT_EQ(seen.frames.size(), 2U);
  EXPECT_FALSE(seen.frames[0].force) << "nothing is held";
  ASSERT_TRUE(seen.frames[1].force);
  EXPECT_LT((seen.frames[1].force->value - Vector3d(0, 0, -0.1)).norm(), 1e-12);
  EXPECT_NEAR(seen.frames[1].force->change, 0, 1e-12);
  EXPECT_TRUE(seen.has_force());

  const Observation late = observe("a", "a", recording_with_force(scene, 0.3), scene, warnings);
  EXPECT_FALSE(late.has_force());
  EXPECT_THAT(warnings, testing::Contains(testing::HasSubstr("its zero is not known")));
}

TEST(UnknownsOf, ADensityIsLookedForWithAForceAlone) {
  const pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  const auto has_density = [&](bool with_force) {
    return std::ranges::any_of(unknowns_of(scene, {}, with_force), [](const Unknown& unknown) {
      return unknown.path == "scene.tissue.effects.density_change";
    });
  };
  EXPECT_TRUE(has_density(true));
  EXPECT_FALSE(has_density(false));
}

TEST(SceneAt, AThickerSheetLiesOnTheSameBoard) {
  const pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  ASSERT_GT(scene.rigid_body_size(), 0);
  const std::vector<Unknown> unknowns = unknowns_of(scene, {}, false);
  const auto thickness = std::ranges::find(unknowns, std::string(kThicknessPath), &Unknown::path);
  ASSERT_NE(thickness, unknowns.end());
  VectorXd x = VectorXd::Zero(static_cast<Eigen::Index>(unknowns.size()));
  x[thickness - unknowns.begin()] = std::log(1.1);
  const auto lower_face = [](const pb::Scene& of) -> Vector3d {
    const Eigen::Isometry3d X_WB = make_scene(of, {}).tissue.X_WB;
    return X_WB * Vector3d(0, 0, -of.tissue().thickness_m() / 2);
  };
  const pb::Scene thicker = scene_at(scene, unknowns, x, {});
  EXPECT_NEAR(thicker.tissue().thickness_m(), 1.1 * scene.tissue().thickness_m(), 1e-12);
  EXPECT_NEAR((lower_face(thicker) - lower_face(scene)).norm(), 0, 1e-12);
}

TEST(RangeOf, EndsInsideTheKnob) {
  const pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  for (const Unknown& unknown : unknowns_of(scene, {}, false)) {
    const Range range = range_of(unknown);
    EXPECT_LT(range.low, 0) << unknown.path;
    EXPECT_GT(range.high, 0) << unknown.path;
    EXPECT_LE(range.high, 3 * unknown.sd) << unknown.path;
    if (!unknown.in_scene) continue;
    for (const double x : {range.low, range.high}) {
      pb::Scene changed = scene;
      set_scene_number(changed, unknown.path, unknown.value(x));
      EXPECT_NEAR(scene_number(changed, unknown.path), unknown.value(x),
                  1e-9 * std::fabs(unknown.value(x)))
          << unknown.path << " is not cut off by its knob";
    }
  }
}

TEST(ReferenceFit, ATurnOfTheCameraIsATurnAndNoShift) {
  FittedSheet c(kDegree * kTurnDeg * Vector3d(1, -1, 1) / std::sqrt(3));
  const FitState state = c.improved();
  const Registration6 found = c.fit->registration(state);
  EXPECT_NEAR(found.turn.norm() / kDegree, kTurnDeg, 0.15);
  // About the sheet the same turn would be a shift of some 3 mm, beyond what is believed of one.
  EXPECT_LT(found.shift.norm(), 0.001);
}

TEST(ReferenceFit, WhatRestsTellsNothingOfClockAndDamping) {
  FittedSheet c;
  const FitState state = c.improved();
  const ArrowStep sure = c.fit->posterior(c.predictions, c.at, c.which, state);
  const int clock = c.fit->layout.clock();
  EXPECT_NEAR(state.shared[clock], 0, 1e-6);
  EXPECT_NEAR(std::sqrt(sure.shared_covariance(clock, clock)), c.fit->beliefs.shared_sd[clock],
              1e-6);
  for (int k = 0; k < c.fit->layout.unknowns; ++k)
    EXPECT_NEAR(std::sqrt(sure.shared_covariance(k, k)), c.fit->beliefs.shared_sd[k], 1e-6);
}

TEST(ReferenceFit, NeitherLeavesItsRangesNorFitsWorse) {
  FittedSheet c;
  // Clouds 3 mm above the surface; the column of the thickness says that a tenth is worth 1 um.
  for (SeenFrame& frame : c.fit->observations[0].frames) {
    for (Vector3d& p : frame.points) p.z() += 0.003;
  }
  const auto found =
      std::ranges::find(c.fit->unknowns, std::string(kThicknessPath), &Unknown::path);
  const auto k = found - c.fit->unknowns.begin();
  for (PredictedFrame& frame : c.predictions[0].frames) {
    for (Eigen::Index row = 2; row < frame.columns.rows(); row += 3) frame.columns(row, k) = 1e-2F;
  }
  c.fit->beliefs.shared_sd.segment<6>(c.fit->layout.registration()).setConstant(1e-7);
  const NoiseModel noise = c.fit->noise;
  const double before = c.fit->cost(c.predictions, c.at, c.which, c.at, noise);
  const FitState state = c.improved();
  EXPECT_LT(c.fit->cost(c.predictions, c.at, c.which, state, noise), before);
  const Ranges range = c.fit->ranges(c.at);
  for (int j = 0; j < c.fit->layout.shared(); ++j) {
    EXPECT_GE(state.shared[j], range.low[j] - 1e-12);
    EXPECT_LE(state.shared[j], range.high[j] + 1e-12);
  }
  EXPECT_NEAR(state.shared[k], range.high[k], 1e-6) << "it wants farther than the derivative holds";
}

TEST(ReferenceFit, ANumberAtTheEndOfItsRangeHoldsNoOtherBack) {
  FittedSheet c;
  for (SeenFrame& frame : c.fit->observations[0].frames) {
    for (Vector3d& p : frame.points) p.z() += 0.003;
  }
  const auto found =
      std::ranges::find(c.fit->unknowns, std::string(kThicknessPath), &Unknown::path);
  const auto k = found - c.fit->unknowns.begin();
  for (PredictedFrame& frame : c.predictions[0].frames) {
    for (Eigen::Index row = 2; row < frame.columns.rows(); row += 3) frame.columns(row, k) = 1e-2F;
  }
  FitState state = c.at;
  // A step that ended there left it a rounding away.
  state.shared[k] = std::nextafter(c.fit->ranges(c.at).high[k], 0.0);
  c.fit->improve(c.predictions, c.at, c.which, 12, state);
  EXPECT_GT(c.fit->registration(state).shift.z(), 0.001);
}

/// Surfaces that are as much higher as the stiffness is, and clouds 2 mm above those believed.
struct Descending : FittedSheet {
  static constexpr double kHigher = 0.01;  // [m] per unit of x
  int simulated = 0;

  Descending() {
    for (SeenFrame& frame : fit->observations[0].frames) {
      for (Vector3d& p : frame.points) p.z() += 0.002;
    }
    fit->beliefs.shared_sd.segment<6>(fit->layout.registration()).setConstant(1e-7);
    for (PredictedFrame& frame : predictions[0].frames) {
      for (Eigen::Index row = 2; row < frame.columns.rows(); row += 3)
        frame.columns(row, 0) = static_cast<float>(kHigher);
    }
  }
  std::vector<Prediction> at_state(const FitState& state) {
    ++simulated;
    std::vector<Prediction> here = predictions;
    for (PredictedFrame& frame : here[0].frames) {
      for (Vector3d& p : frame.vertices) p.z() += kHigher * state.shared[0];
    }
    return here;
  }
  /// Where the search ends if nothing stiffer than `most` can be simulated.
  Descent descended(double most) {
    Descent d;
    d.at = at;
    d.predictions = predictions;
    descend(
        *fit,
        [&](const FitState& state) {
          auto here = at_state(state);
          if (state.shared[0] > most)
            here[0].frames.assign(kFrames, {});  // as ReferenceFit::simulate leaves an Error
          return here;
        },
        which, 12, kSmallMove, d);
    return d;
  }
};

TEST(Descend, EndsWhereTheSimulationFits) {
  Descending c;
  const Descent d = c.descended(1e9);
  EXPECT_NEAR(d.at.shared[0], 0.2, 0.03);
  EXPECT_TRUE(d.settled);
}

TEST(Descend, TakesAStateThatCannotBeSimulatedForAWorseFit) {
  constexpr double kMost = 0.12;
  Descending c;
  const NoiseModel noise = c.fit->noise;
  const double before = c.fit->cost(c.predictions, c.at, c.which, c.at, noise);
  const Descent d = c.descended(kMost);
  EXPECT_LE(c.simulated, 12);
  EXPECT_LE(d.at.shared[0], kMost);
  EXPECT_GT(d.at.shared[0], kMost / 2) << "as near as can be simulated";
  EXPECT_EQ(count_valid(d.predictions[0]), std::ptrdiff_t{FittedSheet::kFrames});
  EXPECT_LT(c.fit->cost(d.predictions, d.at, c.which, d.at, noise), before);
}

TEST(KnownDensity, HasTheQuantilesOfANormalOne) {
  KnownDensity density;
  for (int k = -8; k <= 8; ++k) {
    density.x.push_back(0.5 * k);
    density.log_density.push_back(-0.5 * std::pow(0.5 * k, 2));
  }
  EXPECT_NEAR(density.quantile(0.05), -1.645, 0.04);
  EXPECT_NEAR(density.quantile(0.95), 1.645, 0.04);
  EXPECT_NEAR(density.shortest(0.9).high, 1.645, 0.1);
  const std::vector<double> weights = density.weights();
  double sum = 0, squares = 0;
  for (std::size_t k = 0; k < weights.size(); ++k) {
    sum += weights[k];
    squares += weights[k] * density.x[k] * density.x[k];
  }
  EXPECT_NEAR(sum, 1, 1e-12);
  EXPECT_NEAR(squares, 1, 0.1);
}

struct Integrated {
  ArrowStep sure;  ///< before
  ClockPosterior found;
};
Integrated integrate(FittedSheet& c) {
  const FitState state = c.improved();
  const ArrowStep sure = c.fit->posterior(c.predictions, c.at, c.which, state);
  return {sure, integrate_clock(*c.fit, c.predictions, c.at, c.which, state, sure)};
}

void expect_clock_as_believed(const FittedSheet& c, const ClockPosterior& found) {
  const double belief = c.fit->beliefs.shared_sd[c.fit->layout.clock()];
  EXPECT_NEAR(found.clock.high, 1.645 * belief, 0.15 * belief);
  EXPECT_NEAR(found.clock.low, -1.645 * belief, 0.15 * belief);
}

TEST(IntegrateClock, ACloudJustBeforeTheTissueMovesLeavesALateClockOpen) {
  FittedSheet c;
  c.fit->beliefs.shared_sd.segment<6>(c.fit->layout.registration()).setConstant(1e-7);
  for (PredictedFrame& frame : c.predictions[0].frames) {
    for (int k = -13; k <= 13; ++k) {
      std::vector<Vector3d> vertices = frame.vertices;
      for (Vector3d& p : vertices) p.z() += std::max(0, k) * 5e-4;  // 25 mm/s
      frame.way.push_back({0.02 * k, std::make_shared<const std::vector<Vector3d>>(vertices)});
    }
    frame.velocity.assign(frame.vertices.size(), Vector3d(0, 0, 0.025));
  }
  const auto [sure, found] = integrate(c);
  const int k = c.fit->layout.clock();
  const double belief = c.fit->beliefs.shared_sd[k];
  // A later clock is as likely as it is believed: half of a normal distribution.
  EXPECT_NEAR(found.clock.high, 1.645 * belief, 0.1 * belief);
  EXPECT_NEAR(found.state.shared[k], 0.8 * belief, 0.1 * belief);
  EXPECT_NEAR(found.clock.low, 0, 0.1 * belief);
  EXPECT_NEAR(std::sqrt(found.sure.shared_covariance(k, k)), 0.6 * belief, 0.1 * belief);
  EXPECT_LT(std::sqrt(sure.shared_covariance(k, k)), 0.2 * belief) << "by curvature";
  EXPECT_FALSE(c.fit->held_clock);
}

TEST(IntegrateClock, WhatRestsSaysNothing) {
  FittedSheet c;
  const auto [sure, found] = integrate(c);
  expect_clock_as_believed(c, found);
  for (int k = 0; k < c.fit->layout.unknowns; ++k)
    EXPECT_NEAR(found.sure.shared_covariance(k, k), sure.shared_covariance(k, k), 1e-6);
}

TEST(IntegrateClock, ASwayBelowWhatTheModelIsGoodForSaysNothing) {
  // The surface is 0.05 mm too high, as it will be 0.25 s later.
  FittedSheet c;
  c.fit->beliefs.shared_sd.segment<6>(c.fit->layout.registration()).setConstant(1e-7);
  for (PredictedFrame& frame : c.predictions[0].frames) {
    for (Vector3d& p : frame.vertices) p.z() += 5e-5;
    for (int k = -13; k <= 13; ++k) {
      std::vector<Vector3d> vertices = frame.vertices;
      for (Vector3d& p : vertices) p.z() += k * 4e-6;  // 0.2 mm/s
      frame.way.push_back({0.02 * k, std::make_shared<const std::vector<Vector3d>>(vertices)});
    }
    frame.velocity.assign(frame.vertices.size(), Vector3d(0, 0, 2e-4));
  }
  expect_clock_as_believed(c, integrate(c).found);
}

TEST(IntegrateClock, WhatDiffersByLessThanTheModelIsGoodForSaysNothing) {
  // The surface rests where it was seen; at every other time it is rough by 0.05 mm.
  FittedSheet c;
  for (PredictedFrame& frame : c.predictions[0].frames) {
    for (int k = -13; k <= 13; ++k) {
      std::vector<Vector3d> vertices = frame.vertices;
      for (std::size_t i = 0; i < vertices.size(); ++i)
        vertices[i].z() += k == 0 ? 0 : 7e-5 * std::sin(7.0 * k + 5.0 * static_cast<double>(i));
      frame.way.push_back({0.02 * k, std::make_shared<const std::vector<Vector3d>>(vertices)});
    }
    frame.velocity.assign(frame.vertices.size(), Vector3d::Zero());
  }
  expect_clock_as_believed(c, integrate(c).found);
}

TEST(FindStart, LooksAtEightFramesOfEveryRecordingAndLeavesAll) {
  constexpr std::size_t kMany = 20, kFew = 8;
  const auto start_of = [](const std::vector<std::size_t>& frames) {
    FittedSheet c(Vector3d::Zero(), 7);
    Observation& seen = c.fit->observations[0];
    seen.frames.resize(1);
    std::vector<SeenFrame> all(kMany, seen.frames[0]);
    for (std::size_t k = 0; k < kMany; ++k) {
      all[k].t = 0.02 * static_cast<double>(k);
      for (Vector3d& p : all[k].points) p.z() += 1e-4 * std::sin(static_cast<double>(k));
    }
    seen.frames.clear();
    for (const std::size_t k : frames) seen.frames.push_back(all[k]);
    const Start start = find_start(*c.fit, c.which, [](double) {});
    EXPECT_EQ(seen.frames.size(), frames.size());
    return start;
  };
  std::vector<std::size_t> many, few;
  for (std::size_t k = 0; k < kMany; ++k) many.push_back(k);
  for (std::size_t k = 1; k <= kFew; ++k) few.push_back(k * kMany / kFew - 1);
  const Start a = start_of(many), b = start_of(few);
  EXPECT_EQ(a.failure, "");
  EXPECT_GT(a.state.shared.norm(), 0);
  EXPECT_EQ(a.state.shared, b.state.shared);
  EXPECT_EQ(a.state.own[0], b.state.own[0]);
}

TEST(ReferenceFit, StatesOfAllThicknessesHaveOneMesh) {
  FittedSheet c;
  FitState state = c.at;
  const auto k = static_cast<Eigen::Index>(
      std::ranges::find(c.fit->unknowns, std::string(kThicknessPath), &Unknown::path) -
      c.fit->unknowns.begin());
  std::vector<std::vector<double>> lines;
  for (const double x : {-0.1, -0.003, 0.0, 0.003, 0.1}) {
    state.shared[k] = x;
    const SimulationTask task =
        make_calibration_task(c.fit->observations[0], c.fit->scene_of(state, 0), {},
                              {pb::TISSUE_REFERENCE, {16, 16, 1}, 1});
    std::vector<std::string> ignored;
    const auto model = make_reference_model(make_scene(task.scene, {}), 0.02, ignored,
                                            std::vector<PinchCircle>{{{0.01, 0.02}, 0.005}});
    lines.push_back(model->lines[0]);
    lines.back().insert(lines.back().end(), model->lines[1].begin(), model->lines[1].end());
    EXPECT_EQ(lines.back(), lines.front()) << x;
    EXPECT_NEAR(2 * model->lines[2].back(), scene_number(task.scene, kThicknessPath), 1e-12);
  }
}

TEST(Simulate, AnErrorIsAFailureOfThatState) {
  FittedSheet c;
  // Its place has no derivative, which the simulation says before its first command.
  c.fit->scene.mutable_tool()->mutable_grip()->set_hold(pb::HOLD_PAD);
  const auto predictions =
      c.fit->simulate(c.at, {pb::TISSUE_REFERENCE, {4, 4, 1}, 1}, true, c.which);
  EXPECT_EQ(predictions[0].frames.size(), FittedSheet::kFrames);
  EXPECT_EQ(count_valid(predictions[0]), 0);
  EXPECT_THAT(predictions[0].failure, testing::HasSubstr("size of a pad"));
  const NoiseModel noise = c.fit->noise;
  EXPECT_GT(c.fit->cost(predictions, c.at, c.which, c.at, noise),
            c.fit->cost(c.predictions, c.at, c.which, c.at, noise));
}

}  // namespace
}  // namespace omentum
