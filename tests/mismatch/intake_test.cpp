// Intake: figures that were put into a recording are found in it.
#include "mismatch/intake/intake.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace omentum {
namespace {

using testing::HasSubstr;

/// A path that never repeats itself, at rest from 4 to 6 s.
double path(double t, int axis) {
  const double s = t < 4 ? t : t < 6 ? 4 : t - 2;
  return 0.01 * std::sin(1.1 * s + axis) + 0.004 * std::sin(2.7 * s * (1 + 0.01 * s) + 2 * axis);
}

Series track(const std::string& stem, double period, double length, double late, double drift,
             double noise, double memory = 0) {
  std::mt19937 generator(7);
  std::normal_distribution<double> normal;
  Series series;
  for (const char* axis : {"x_m", "y_m", "z_m"}) series.columns.push_back(stem + axis);
  double left[3] = {0, 0, 0};
  for (double t = 0; t <= length; t += period) {
    series.time_ns.push_back(std::llround(1e9 * t));
    for (int axis = 0; axis < 3; ++axis) {
      left[axis] = memory * left[axis] + std::sqrt(1 - memory * memory) * normal(generator);
      series.values.push_back(path(t * (1 - drift) - late, axis) + noise * left[axis]);
    }
  }
  return series;
}

const ClockFigures* clock_of(const IntakeFigures& figures, const std::string& topic) {
  for (const ClockFigures& clock : figures.clocks) {
    if (clock.topic == topic) return &clock;
  }
  return nullptr;
}

TEST(Intake, AClockOffsetIsFoundWithItsSign) {
  for (const double late : {0.0, 0.037, -0.083, 0.5}) {
    Recording recording;
    recording.series["tool_commanded"] = track("tip_commanded_", 0.02, 20, 0, 0, 0);
    recording.series["tracker"] = track("tip_optical_", 0.013, 20, late, 0, 1e-4);
    const IntakeFigures figures = take_in(recording);
    const ClockFigures* clock = clock_of(figures, "tracker");
    ASSERT_NE(clock, nullptr) << late;
    EXPECT_NEAR(clock->offset_s, late, 0.002);
    EXPECT_EQ(clock->reference, "tool_commanded");
  }
}

TEST(Intake, ADriftIsFound) {
  Recording recording;
  recording.series["tool"] = track("tip_measured_", 0.01, 40, 0, 0, 0);
  recording.series["tracker"] = track("tip_optical_", 0.011, 40, 0.02, 2e-3, 0);
  const IntakeFigures figures = take_in(recording);
  const ClockFigures* clock = clock_of(figures, "tracker");
  ASSERT_NE(clock, nullptr);
  EXPECT_NEAR(clock->drift_ppm, 2000, 300);
}

/// A tool that moves along x and rests along y and z but for noise, with joints that shake.
Recording moving_arm(double late) {
  Recording recording;
  std::mt19937 generator(3);
  std::normal_distribution<double> normal;
  Series& goals = recording.series["tool_commanded"];
  Series& joints = recording.series["joints"];
  goals.columns = {"tip_commanded_x_m", "tip_commanded_y_m", "tip_commanded_z_m"};
  joints.columns = {"q1_measured_rad", "dq1_measured_rad_per_s", "effort1_Nm",
                    "q2_measured_rad", "dq2_measured_rad_per_s", "effort2_Nm"};
  for (double t = 0; t <= 20; t += 0.01) {
    goals.time_ns.push_back(std::llround(1e9 * t));
    goals.values.insert(goals.values.end(), {path(t, 0), 0.02, 0.03});
    joints.time_ns.push_back(std::llround(1e9 * (t + 0.004)));
    joints.values.insert(
        joints.values.end(),
        {5 * path(t + 0.004 - late, 0) + 1e-5 * normal(generator), normal(generator),
         0.1 * normal(generator), 1e-5 * normal(generator), normal(generator), std::sin(0.7 * t)});
  }
  return recording;
}

TEST(Intake, AnOffsetComesFromWhatMovesAndItsIntervalHolds) {
  for (const double late : {0.03, 0.12}) {
    const IntakeFigures figures = take_in(moving_arm(late));
    const ClockFigures* clock = clock_of(figures, "joints");
    ASSERT_NE(clock, nullptr) << late;
    EXPECT_NEAR(clock->offset_s, late, std::max(2 * clock->sd_s, 1e-3)) << print_intake(figures);
    EXPECT_LT(clock->sd_s, 0.02);
  }
}

TEST(Intake, ChannelsOfOneRowHaveNoClocksOfTheirOwn) {
  Recording recording = moving_arm(0.12);
  recording.series["joints"].time_ns = recording.series["tool_commanded"].time_ns;
  EXPECT_TRUE(take_in(recording).clocks.empty());
}

TEST(Intake, AGapOfYearsTakesNoLongerThanTheSamples) {
  Recording recording;
  Series series = track("tip_optical_", 0.01, 20, 0, 0, 1e-5);
  for (std::size_t row = 1500; row < series.rows(); ++row)
    series.time_ns[row] += 1'700'000'000'000'000'000;
  recording.series["tracker"] = series;
  recording.series["tool"] = track("tip_measured_", 0.01, 20, 0, 0, 1e-5);
  const IntakeFigures figures = take_in(recording);
  ASSERT_FALSE(figures.noise.empty());
  EXPECT_LT(figures.noise.front().windows, 200U);
  EXPECT_FALSE(repeatability({&recording, &recording}).empty());
}

TEST(Intake, AChannelThatShowsSomethingElseGetsNoClock) {
  Recording recording;
  recording.series["tool"] = track("tip_measured_", 0.01, 20, 0, 0, 0);
  recording.series["force"] = track("", 0.01, 20, 300, 0, 1);
  recording.series["force"].columns = {"fx_N", "fy_N", "fz_N"};
  EXPECT_EQ(clock_of(take_in(recording), "force"), nullptr);
}

TEST(Intake, NoiseInHoldsHasItsSizeAndMemory) {
  for (const double memory : {0.0, 0.8}) {
    Recording recording;
    recording.series["tool_commanded"] = track("tip_commanded_", 0.005, 60, 0, 0, 0);
    recording.series["tracker"] = track("tip_optical_", 0.005, 60, 0, 0, 2e-5, memory);
    const IntakeFigures figures = take_in(recording);
    ASSERT_EQ(figures.noise.size(), 1);
    const NoiseFigures& noise = figures.noise.front();
    EXPECT_TRUE(noise.in_holds);
    EXPECT_EQ(noise.unit, "m");
    EXPECT_NEAR(noise.sd, 2e-5, 2e-6);
    EXPECT_NEAR(noise.correlation_s, memory > 0 ? -0.005 / std::log(memory) : 0, 0.006);
  }
}

TEST(Intake, RoundingIsNeitherNoiseNorOutliers) {
  Recording recording;
  recording.series["tool_commanded"] = track("tip_commanded_", 0.02, 20, 0, 0, 0);
  Series still = track("tip_measured_", 0.01, 20, 0, 0, 0);
  for (std::size_t k = 0; k < still.values.size(); ++k)
    still.values[k] = 0.01 + 1e-16 * static_cast<double>(k * 7919 % 13);
  still.values[300] += 1e-14;
  recording.series["tool"] = still;
  for (const NoiseFigures& noise : take_in(recording).noise) {
    EXPECT_EQ(noise.sd, 0) << noise.topic;
    EXPECT_EQ(noise.outliers, 0U) << noise.topic;
  }
}

TEST(Intake, GapsAndOutliersAreCounted) {
  Recording recording;
  Series series = track("tip_optical_", 0.01, 20, 0, 0, 1e-5);
  for (std::size_t row = 500; row < series.rows(); ++row) series.time_ns[row] += 300'000'000;
  for (const std::size_t row : {100U, 900U, 1700U}) series.values[3 * row] += 0.05;
  recording.series["tracker"] = series;
  const IntakeFigures figures = take_in(recording);
  EXPECT_EQ(figures.sampling.front().gaps, 1);
  EXPECT_NEAR(figures.sampling.front().longest_gap_s, 0.31, 1e-9);
  EXPECT_NEAR(figures.sampling.front().period_s, 0.01, 1e-12);
  ASSERT_FALSE(figures.noise.empty());
  EXPECT_GE(figures.noise.front().outliers, 3) << print_intake(figures);
  EXPECT_LE(figures.noise.front().outliers, 6);
  EXPECT_THAT(print_intake(figures), HasSubstr("1 gaps up to 0.31 s"));
}

TEST(Intake, CommandsThatAreCutOffAreSaid) {
  Recording recording;
  Series series = track("tip_commanded_", 0.02, 20, 0, 0, 0);
  EXPECT_TRUE(
      take_in(Recording{{}, {{"tool_commanded", series}}, {}, {}, {}, {}, {}, {}}).clipped.empty());
  for (std::size_t row = 0; row < series.rows(); ++row)
    series.values[3 * row] = std::min(series.values[3 * row], 0.006);
  recording.series["tool_commanded"] = series;
  const IntakeFigures figures = take_in(recording);
  ASSERT_EQ(figures.clipped.size(), 1);
  EXPECT_EQ(figures.clipped.front().column, "tip_commanded_x_m");
  EXPECT_EQ(figures.clipped.front().value, 0.006);
  EXPECT_GE(figures.clipped.front().stretches, 2);
}

TEST(Intake, RepeatsGiveTheFloor) {
  std::vector<Recording> recordings(3);
  for (std::size_t k = 0; k < 3; ++k) {
    recordings[k].series["tracker"] = track("tip_optical_", 0.01, 20, 0, 0, 0);
    for (double& value : recordings[k].series["tracker"].values)
      value += 1e-3 * (static_cast<double>(k) - 1);
    // Another origin of time changes nothing.
    for (std::int64_t& t : recordings[k].series["tracker"].time_ns)
      t += static_cast<std::int64_t>(k) * 5'000'000'000;
  }
  const auto floor = repeatability({&recordings[0], &recordings[1], &recordings[2]});
  ASSERT_EQ(floor.size(), 1);
  EXPECT_NEAR(floor.front().rms, 1e-3, 1e-6);
  EXPECT_NEAR(floor.front().largest, 2e-3, 1e-6);
  EXPECT_TRUE(repeatability({&recordings[0]}).empty());
}

TEST(Intake, RepeatsWhoseCommandsDifferAreComparedByWhatTheyMakeOfThem) {
  // A tool that lags by 1 mm and scatters by 0.1 mm from repeat to repeat, on ways 10 mm apart.
  std::vector<Recording> recordings(2);
  for (int r = 0; r < 2; ++r) {
    for (const bool commanded : {true, false}) {
      const std::string source = commanded ? "commanded" : "measured";
      Series& tool =
          recordings[static_cast<std::size_t>(r)].series[commanded ? "tool_commanded" : "tool"];
      for (const char axis : {'x', 'y', 'z'})
        tool.columns.push_back(fmt::format("tip_{}_{}_m", source, axis));
      for (int k = 0; k <= 200; ++k) {
        const double command = 0.01 * r + 0.02 * std::sin(0.05 * k);
        tool.time_ns.push_back(k * std::int64_t{20'000'000});
        const double off = commanded ? 0 : 1e-3 + (r == 0 ? 1e-4 : -1e-4);
        tool.values.insert(tool.values.end(), {command + off, command + off, command + off});
      }
    }
  }
  const auto floor = repeatability({&recordings[0], &recordings[1]});
  ASSERT_EQ(floor.size(), 2);
  EXPECT_EQ(floor[0].less, "");
  EXPECT_NEAR(floor[0].rms, (0.01 - 2e-4) / std::sqrt(2.0), 1e-9);
  EXPECT_EQ(floor[1].less, "its command");
  EXPECT_NEAR(floor[1].rms, std::sqrt(2.0) * 1e-4, 1e-9);
}

TEST(Intake, CloudsCountByTheirCentre) {
  Recording recording;
  recording.series["tool_commanded"] = track("tip_commanded_", 0.02, 20, 0, 0, 0);
  for (std::int64_t k = 0; k < 200; ++k) recording.clouds.time_ns.push_back(k * 100'000'000);
  recording.clouds.fetch = [](std::size_t k) {
    const double t = 0.1 * static_cast<double>(k) - 0.15;
    return Cloud(5, Eigen::Vector3d(path(t, 0), path(t, 1), path(t, 2)).cast<float>());
  };
  const IntakeFigures figures = take_in(recording);
  const ClockFigures* clock = clock_of(figures, "cloud");
  ASSERT_NE(clock, nullptr);
  EXPECT_NEAR(clock->offset_s, 0.15, 0.01);
}

}  // namespace
}  // namespace omentum
