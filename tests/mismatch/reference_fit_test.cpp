// The search of a calibration on surfaces that were made here, not simulated.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>

#include "core/config.h"
#include "core/constants.h"
#include "mismatch/fit/clock_posterior.h"
#include "mismatch/fit/descent.h"
#include "mismatch/fit/forward_model.h"
#include "mismatch/fit/starts.h"
#include "sim_worker/playback/simulation.h"
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
  frame.trajectory = {
      {later - 0.02, surface(0)}, {later, surface(0)}, {later + 0.02, surface(0.002)}};
  frame.vertices = {Vector3d::Zero()};
  frame.velocity = {Vector3d::Zero()};
  return frame;
}

TEST(MoveInTime, FollowsTheTrajectoryAndRestsAtItsEnds) {
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
    if (!unknown.in_scene()) continue;
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
  const Registration6 found = registration_of(*c.data, c.improved().state);
  EXPECT_NEAR(found.turn.norm() / kDegree, kTurnDeg, 0.15);
  // About the sheet the same turn would be a shift of some 3 mm, beyond what is believed of one.
  EXPECT_LT(found.shift.norm(), 0.001);
}

TEST(ReferenceFit, WhatRestsTellsNothingOfClockAndDamping) {
  FittedSheet c;
  const SearchState found = c.improved();
  const FitPosterior posterior = posterior_at(*c.data, c.linear, c.which, {}, found);
  const int clock = c.data->layout.clock.begin;
  EXPECT_NEAR(found.state.shared[clock], 0, 1e-6);
  EXPECT_NEAR(std::sqrt(posterior.shared_covariance(clock, clock)),
              c.data->beliefs.shared_sd[clock], 1e-6);
  for (int k = 0; k < c.data->layout.unknowns.count; ++k)
    EXPECT_NEAR(std::sqrt(posterior.shared_covariance(k, k)), c.data->beliefs.shared_sd[k], 1e-6);
}

TEST(ReferenceFit, NeitherLeavesItsRangesNorFitsWorse) {
  FittedSheet c;
  // Clouds 3 mm above the surface; the column of the thickness says that a tenth is worth 1 um.
  for (SeenFrame& frame : c.data->observations[0].frames) {
    for (Vector3d& p : frame.points) p.z() += 0.003;
  }
  const auto found =
      std::ranges::find(c.data->unknowns, std::string(kThicknessPath), &Unknown::path);
  const auto k = found - c.data->unknowns.begin();
  for (PredictedFrame& frame : c.frames()) {
    for (Eigen::Index row = 2; row < frame.columns.rows(); row += 3) frame.columns(row, k) = 1e-2F;
  }
  c.data->beliefs.shared_sd.segment<6>(c.data->layout.registration.begin).setConstant(1e-7);
  const Scales scales = first_scales(*c.data);
  const FitState state = c.improved().state;
  EXPECT_LT(c.cost_at(state, scales), c.cost_at(c.linear.at, scales));
  const Ranges range = ranges_of(*c.data, c.linear.at, {});
  for (int j = 0; j < c.data->layout.shared(); ++j) {
    EXPECT_GE(state.shared[j], range.low[j] - 1e-12);
    EXPECT_LE(state.shared[j], range.high[j] + 1e-12);
  }
  EXPECT_NEAR(state.shared[k], range.high[k], 1e-6) << "it wants farther than the derivative holds";
}

TEST(ReferenceFit, ANumberAtTheEndOfItsRangeHoldsNoOtherBack) {
  FittedSheet c;
  for (SeenFrame& frame : c.data->observations[0].frames) {
    for (Vector3d& p : frame.points) p.z() += 0.003;
  }
  const auto found =
      std::ranges::find(c.data->unknowns, std::string(kThicknessPath), &Unknown::path);
  const auto k = found - c.data->unknowns.begin();
  for (PredictedFrame& frame : c.frames()) {
    for (Eigen::Index row = 2; row < frame.columns.rows(); row += 3) frame.columns(row, k) = 1e-2F;
  }
  SearchState begin = c.begin();
  // A step that ended there left it a rounding away.
  begin.state.shared[k] = std::nextafter(ranges_of(*c.data, c.linear.at, {}).high[k], 0.0);
  const SearchState ended = improve(*c.data, c.linear, c.which, 12, {}, begin);
  EXPECT_GT(registration_of(*c.data, ended.state).shift.z(), 0.001);
}

/// Surfaces that are as much higher as the stiffness is, and clouds 2 mm above those believed.
struct Descending : FittedSheet {
  static constexpr double kHigher = 0.01;  // [m] per unit of x
  int simulated = 0;

  Descending() {
    for (SeenFrame& frame : data->observations[0].frames) {
      for (Vector3d& p : frame.points) p.z() += 0.002;
    }
    data->beliefs.shared_sd.segment<6>(data->layout.registration.begin).setConstant(1e-7);
    for (PredictedFrame& frame : frames()) {
      for (Eigen::Index row = 2; row < frame.columns.rows(); row += 3)
        frame.columns(row, 0) = static_cast<float>(kHigher);
    }
  }
  Linearisation at_state(const FitState& state) {
    ++simulated;
    Linearisation here{state, linear.predictions};
    for (PredictedFrame& frame : here.predictions[0].frames) {
      for (Vector3d& p : frame.vertices) p.z() += kHigher * state.shared[0];
    }
    return here;
  }
  /// Where the search ends if nothing stiffer than `most` can be simulated.
  Descent descended(double most) {
    const auto linearise = [&](const FitState& state) {
      Linearisation here = at_state(state);
      if (state.shared[0] > most)
        here.predictions[0] = failed_prediction(data->observations[0], "too stiff");
      return here;
    };
    DescentOptions options;
    options.most_simulations = 12;
    return descend(*data, linearise, which, options, linear, first_scales(*data));
  }
};

TEST(Descend, EndsWhereTheSimulationFits) {
  Descending c;
  const Descent d = c.descended(1e9);
  EXPECT_NEAR(d.linear.at.shared[0], 0.2, 0.03);
  EXPECT_TRUE(d.settled);
}

TEST(Descend, TakesAStateThatCannotBeSimulatedForAWorseFit) {
  constexpr double kMost = 0.12;
  Descending c;
  const Scales scales = first_scales(*c.data);
  const Descent d = c.descended(kMost);
  EXPECT_LE(c.simulated, 12);
  EXPECT_LE(d.linear.at.shared[0], kMost);
  EXPECT_GT(d.linear.at.shared[0], kMost / 2) << "as near as can be simulated";
  EXPECT_EQ(count_valid(d.linear.predictions[0]), std::ptrdiff_t{FittedSheet::kFrames});
  EXPECT_LT(cost_of(*c.data, d.linear, c.which, d.linear.at, scales),
            c.cost_at(c.linear.at, scales));
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
  FitPosterior before;
  ClockPosterior found;
};
Integrated integrate(const FittedSheet& c) {
  const SearchState state = c.improved();
  const FitPosterior before = posterior_at(*c.data, c.linear, c.which, {}, state);
  return {before, integrate_clock(*c.data, c.linear, c.which, state, before)};
}

void expect_clock_as_believed(const FittedSheet& c, const ClockPosterior& found) {
  const double belief = c.data->beliefs.shared_sd[c.data->layout.clock.begin];
  EXPECT_NEAR(found.clock.high, 1.645 * belief, 0.15 * belief);
  EXPECT_NEAR(found.clock.low, -1.645 * belief, 0.15 * belief);
}

TEST(IntegrateClock, ACloudJustBeforeTheTissueMovesLeavesALateClockOpen) {
  FittedSheet c;
  c.data->beliefs.shared_sd.segment<6>(c.data->layout.registration.begin).setConstant(1e-7);
  for (PredictedFrame& frame : c.frames()) {
    for (int k = -13; k <= 13; ++k) {
      std::vector<Vector3d> vertices = frame.vertices;
      for (Vector3d& p : vertices) p.z() += std::max(0, k) * 5e-4;  // 25 mm/s
      frame.trajectory.push_back(
          {0.02 * k, std::make_shared<const std::vector<Vector3d>>(vertices)});
    }
    frame.velocity.assign(frame.vertices.size(), Vector3d(0, 0, 0.025));
  }
  const auto [before, found] = integrate(c);
  const int k = c.data->layout.clock.begin;
  const double belief = c.data->beliefs.shared_sd[k];
  // A later clock is as likely as it is believed: half of a normal distribution.
  EXPECT_NEAR(found.clock.high, 1.645 * belief, 0.1 * belief);
  EXPECT_NEAR(found.state.shared[k], 0.8 * belief, 0.1 * belief);
  EXPECT_NEAR(found.clock.low, 0, 0.1 * belief);
  EXPECT_NEAR(std::sqrt(found.posterior.shared_covariance(k, k)), 0.6 * belief, 0.1 * belief);
  EXPECT_LT(std::sqrt(before.shared_covariance(k, k)), 0.2 * belief) << "by curvature";
}

TEST(IntegrateClock, WhatRestsSaysNothing) {
  FittedSheet c;
  const auto [before, found] = integrate(c);
  expect_clock_as_believed(c, found);
  for (int k = 0; k < c.data->layout.unknowns.count; ++k)
    EXPECT_NEAR(found.posterior.shared_covariance(k, k), before.shared_covariance(k, k), 1e-6);
}

TEST(IntegrateClock, ASwayBelowWhatTheModelIsGoodForSaysNothing) {
  // The surface is 0.05 mm too high, as it will be 0.25 s later.
  FittedSheet c;
  c.data->beliefs.shared_sd.segment<6>(c.data->layout.registration.begin).setConstant(1e-7);
  for (PredictedFrame& frame : c.frames()) {
    for (Vector3d& p : frame.vertices) p.z() += 5e-5;
    for (int k = -13; k <= 13; ++k) {
      std::vector<Vector3d> vertices = frame.vertices;
      for (Vector3d& p : vertices) p.z() += k * 4e-6;  // 0.2 mm/s
      frame.trajectory.push_back(
          {0.02 * k, std::make_shared<const std::vector<Vector3d>>(vertices)});
    }
    frame.velocity.assign(frame.vertices.size(), Vector3d(0, 0, 2e-4));
  }
  expect_clock_as_believed(c, integrate(c).found);
}

TEST(IntegrateClock, WhatDiffersByLessThanTheModelIsGoodForSaysNothing) {
  // The surface rests where it was seen; at every other time it is rough by 0.05 mm.
  FittedSheet c;
  for (PredictedFrame& frame : c.frames()) {
    for (int k = -13; k <= 13; ++k) {
      std::vector<Vector3d> vertices = frame.vertices;
      for (std::size_t i = 0; i < vertices.size(); ++i)
        vertices[i].z() += k == 0 ? 0 : 7e-5 * std::sin(7.0 * k + 5.0 * static_cast<double>(i));
      frame.trajectory.push_back(
          {0.02 * k, std::make_shared<const std::vector<Vector3d>>(vertices)});
    }
    frame.velocity.assign(frame.vertices.size(), Vector3d::Zero());
  }
  expect_clock_as_believed(c, integrate(c).found);
}

TEST(FindStart, LooksAtEightFramesOfEveryRecording) {
  constexpr std::size_t kMany = 20, kFew = 8;
  const auto start_of = [](const std::vector<std::size_t>& frames) {
    FittedSheet c(Vector3d::Zero(), 7);
    Observation& seen = c.data->observations[0];
    seen.frames.resize(1);
    std::vector<SeenFrame> all(kMany, seen.frames[0]);
    for (std::size_t k = 0; k < kMany; ++k) {
      all[k].t = 0.02 * static_cast<double>(k);
      for (Vector3d& p : all[k].points) p.z() += 1e-4 * std::sin(static_cast<double>(k));
    }
    seen.frames.clear();
    for (const std::size_t k : frames) seen.frames.push_back(all[k]);
    ReferenceForward model;
    return find_start(*c.data, model, c.which, [](double) {});
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
  FitState state = c.linear.at;
  const auto k = static_cast<Eigen::Index>(
      std::ranges::find(c.data->unknowns, std::string(kThicknessPath), &Unknown::path) -
      c.data->unknowns.begin());
  std::vector<std::vector<double>> lines;
  for (const double x : {-0.1, -0.003, 0.0, 0.003, 0.1}) {
    state.shared[k] = x;
    const SimulationTask task =
        make_calibration_task(c.data->observations[0], scene_of(*c.data, state, 0), {},
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

TEST(Simulate, ASceneThatCannotBeSimulatedIsAFailureOfThatState) {
  FittedSheet c;
  c.data->unknowns.front().column = "no_such_number";
  ReferenceForward model;
  const Linearisation failed =
      model.linearise(*c.data, c.linear.at, {pb::TISSUE_REFERENCE, {4, 4, 1}, 1}, c.which);
  const Prediction& prediction = failed.predictions[0];
  EXPECT_EQ(prediction.frames.size(), FittedSheet::kFrames);
  EXPECT_EQ(count_valid(prediction), 0);
  EXPECT_TRUE(prediction.refused);
  EXPECT_THAT(prediction.failure, testing::HasSubstr("no_such_number"));
  const Scales scales = first_scales(*c.data);
  EXPECT_GT(cost_of(*c.data, failed, c.which, c.linear.at, scales), c.cost_at(c.linear.at, scales));
}

// Searches of one data set share nothing that changes.
TEST(Improve, TwoAtATimeGiveTheBytesOfOneAfterTheOther) {
  Descending c;
  constexpr std::size_t kTimes = 4;
  std::vector<SearchState> alone(kTimes), together(kTimes);
  const auto search = [&](std::size_t k) {
    SearchState begin = c.begin();
    begin.state.shared[0] = 0.02 * static_cast<double>(k);
    return improve(*c.data, c.linear, c.which, 12, {}, begin);
  };
  for (std::size_t k = 0; k < kTimes; ++k) alone[k] = search(k);
  run_parallel(kTimes, kTimes, [&](std::size_t k) { together[k] = search(k); });
  for (std::size_t k = 0; k < kTimes; ++k) {
    EXPECT_EQ(alone[k].state.shared, together[k].state.shared);
    EXPECT_EQ(alone[k].state.own[0], together[k].state.own[0]);
    EXPECT_EQ(alone[k].scales.noise.sigma, together[k].scales.noise.sigma);
  }
}

TEST(Compare, RowsThatAreWorthATenthSayATenth) {
  FittedSheet one;
  FitData data = *one.data;
  const NoiseModel noise = first_scales(data).noise;
  const auto compared = [&](double worth) {
    data.setup.row_worth = worth;
    return compare(data, one.linear, {0}, one.linear.at, noise, true).front();
  };
  const NormalEquations whole = compared(1), tenth = compared(0.1);
  ASSERT_GT(whole.A.norm(), 0);
  EXPECT_LT((0.1 * whole.A - tenth.A).norm(), 1e-12 * whole.A.norm());
  EXPECT_LT((0.1 * whole.b - tenth.b).norm(), 1e-12 * whole.b.norm());
  EXPECT_NEAR(tenth.cost, 0.1 * whole.cost, 1e-12 * whole.cost);
  // Beliefs are worth what they were.
  Scales scales = first_scales(data);
  FitState off = one.linear.at;
  off.shared[0] += data.beliefs.shared_sd[0];
  const double rows = compare(data, one.linear, {0}, off, scales.noise, false).front().cost;
  EXPECT_NEAR(cost_of(data, one.linear, {0}, off, scales) - rows, 0.5, 0.01);
}

TEST(Compare, AFailedRecordingLeavesTheBytesOfTheOthers) {
  FittedSheet one;
  FitSetup setup = one.setup;
  Observation other = one.data->observations[0];
  other.name = "b";
  const FitData both = make_fit_data(one.scene, {one.data->observations[0], other}, setup);
  Linearisation linear{believed_state(both),
                       {one.linear.predictions[0], one.linear.predictions[0]}};
  const NoiseModel noise = first_scales(both).noise;
  const auto whole = compare(both, linear, {0, 1}, linear.at, noise, true);
  linear.predictions[1] = failed_prediction(other, "torn");
  const auto torn = compare(both, linear, {0, 1}, linear.at, noise, true);
  EXPECT_EQ(whole[0].A, torn[0].A);
  EXPECT_EQ(whole[0].b, torn[0].b);
  EXPECT_EQ(whole[0].cost, torn[0].cost);
  EXPECT_GT(torn[1].cost, whole[1].cost);
}

}  // namespace
}  // namespace omentum
