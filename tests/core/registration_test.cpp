#include "core/registration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "core/rng.h"

namespace omentum {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

const Vector3d kBoxMin(-0.0916, -0.0825, 0.001);  // workspace of the scene omentum
const Vector3d kBoxMax(0.0691, 0.1155, 0.119);
constexpr double kTouchNoise = 0.0005;

class Draws {
 public:
  explicit Draws(std::uint32_t seed) : stream_(seed, 0, Purpose::kReset, 0) {}
  double uniform(double min, double max) { return uniform_between(stream_.next(), min, max); }
  /// Box-Muller.
  double normal() {
    const double radius = std::sqrt(-2 * std::log(uniform(1e-12, 1)));
    return radius * std::cos(2 * std::acos(-1.0) * uniform(0, 1));
  }
  Vector3d normals() { return {normal(), normal(), normal()}; }
  Vector3d in_box(const Vector3d& min, const Vector3d& max) {
    return {uniform(min.x(), max.x()), uniform(min.y(), max.y()), uniform(min.z(), max.z())};
  }

 private:
  RandomStream stream_;
};

Isometry3d true_pose() {
  Isometry3d X_WR = Isometry3d::Identity();
  X_WR.linear() = Eigen::AngleAxisd(0.7, Vector3d(0.2, -0.1, 0.9).normalized()).toRotationMatrix();
  X_WR.translation() = Vector3d(0.1427, 0.02, 0.1584);
  return X_WR;
}

/// Four columns by three rows over the board, every second one on a pin of this height.
std::vector<Vector3d> board(double pin_height) {
  std::vector<Vector3d> points;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) {
      const double height = (row + column) % 2 == 0 ? pin_height : 0.0;
      points.emplace_back(-0.085 + 0.05 * column, -0.075 + 0.09 * row, height);
    }
  }
  return points;
}

/// Touches of points; `noise`: root mean square of the length of a touch's error.
std::vector<TouchedPoint> touched(const std::vector<Vector3d>& points, double noise, Draws& draws) {
  std::vector<TouchedPoint> result;
  const Isometry3d X_RW = true_pose().inverse();
  for (const Vector3d& p_WT : points) {
    const Vector3d error = noise / std::sqrt(3.0) * draws.normals();
    result.push_back({"p" + std::to_string(result.size() + 1), p_WT, X_RW * p_WT + error});
  }
  return result;
}

Result<Registration> registered(const std::vector<TouchedPoint>& points) {
  return register_points(points, pb::RegistrationRules::default_instance(), kBoxMin, kBoxMax);
}

std::string points_refusal(const std::vector<TouchedPoint>& points) {
  const Result<Registration> result = registered(points);
  return result ? "accepted" : result.error();
}

TEST(FitRigid, RecoversAnyPoseOfExactPoints) {
  Draws draws(1);
  for (int n = 0; n < 200; ++n) {
    Isometry3d X = Isometry3d::Identity();
    X.linear() = Eigen::Quaterniond(draws.normal(), draws.normal(), draws.normal(), draws.normal())
                     .normalized()
                     .toRotationMatrix();
    X.translation() = draws.normals();
    std::vector<Vector3d> from, to;
    for (int k = 0; k < 3 + n % 10; ++k) {
      from.push_back(draws.normals());
      to.push_back(X * from.back());
    }
    EXPECT_LT((fit_rigid(from, to).matrix() - X.matrix()).norm(), 1e-12);
  }
}

TEST(FitRigid, IsNeverAReflection) {
  std::vector<Vector3d> from, to;
  Draws draws(2);
  for (int k = 0; k < 6; ++k) {
    from.push_back(draws.normals());
    to.push_back(from.back().cwiseProduct(Vector3d(1, 1, -1)));
  }
  EXPECT_NEAR(fit_rigid(from, to).linear().determinant(), 1, 1e-12);
}

TEST(FitRigid, NoPoseNearbyHasSmallerResiduals) {
  Draws draws(3);
  const auto points = touched(board(0.04), 0.002, draws);
  std::vector<Vector3d> from, to;
  for (const TouchedPoint& p : points) {
    from.push_back(p.p_RT);
    to.push_back(p.p_WT);
  }
  const auto sum_under = [&](const Isometry3d& X) {
    double sum = 0;
    for (std::size_t i = 0; i < from.size(); ++i) sum += (X * from[i] - to[i]).squaredNorm();
    return sum;
  };
  const Isometry3d best = fit_rigid(from, to);
  for (int n = 0; n < 100; ++n) {
    Isometry3d moved = best;
    moved.rotate(Eigen::AngleAxisd(1e-4, draws.normals().normalized()));
    moved.translation() += 1e-5 * draws.normals();
    EXPECT_GT(sum_under(moved), sum_under(best));
  }
}

TEST(Registration, ExactTouchesGiveThePoseAndNoResidual) {
  Draws draws(4);
  const Result<Registration> result = registered(touched(board(0.04), 0, draws));
  ASSERT_TRUE(result.has_value()) << result.error();
  EXPECT_LT((result.value().X_WR.matrix() - true_pose().matrix()).norm(), 1e-12);
  EXPECT_LT(result.value().residual_rms, 1e-15);
  EXPECT_LT(result.value().leave_one_out_rms, 1e-15);
  EXPECT_THAT(result.value().warnings, ElementsAre());
}

TEST(Registration, LeaveOneOutErrorIsThatOfAFitWithoutThePoint) {
  Draws draws(5);
  const auto points = touched(board(0.04), kTouchNoise, draws);
  const Result<Registration> result = registered(points);
  ASSERT_TRUE(result.has_value()) << result.error();
  for (std::size_t out = 0; out < points.size(); ++out) {
    std::vector<Vector3d> from, to;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (i == out) continue;
      from.push_back(points[i].p_RT);
      to.push_back(points[i].p_WT);
    }
    const double error = (fit_rigid(from, to) * points[out].p_RT - points[out].p_WT).norm();
    EXPECT_NEAR(result.value().points[out].leave_one_out, error, 1e-15);
    EXPECT_GT(error, result.value().points[out].residual);
  }
}

TEST(Registration, PredictionEqualsTheLinearisedCovariance) {
  Draws draws(6);
  const Result<Registration> result = registered(touched(board(0.03), kTouchNoise, draws));
  ASSERT_TRUE(result.has_value()) << result.error();
  for (int n = 0; n < 100; ++n) {
    const Vector3d p_WT = draws.in_box(kBoxMin, kBoxMax);
    const double predicted = predicted_error(result.value(), kTouchNoise, p_WT);
    EXPECT_NEAR(tip_covariance(result.value(), kTouchNoise, p_WT).trace(), predicted * predicted,
                1e-18);
    EXPECT_LE(predicted,
              worst_predicted_error(result.value(), kTouchNoise, kBoxMin, kBoxMax) + 1e-15);
  }
}

struct TipErrors {
  double percentile_95 = 0, rms = 0;
  double theory_95 = 0, theory_rms = 0;  ///< of the linearised fit, which is the bound of theory
  double touch_error = 0;                ///< mean of the squares of the estimates, root
};

double percentile_95(std::vector<double>& values) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 95 / 100);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Of 1000 points of the workspace under 200 draws of touches.
TipErrors tip_errors(const std::vector<Vector3d>& points, double noise, std::uint32_t seed) {
  Draws draws(seed);
  std::vector<Vector3d> tips;
  for (int n = 0; n < 1000; ++n) tips.push_back(draws.in_box(kBoxMin, kBoxMax));
  Registration exact;
  for (const Vector3d& p : points) exact.points.push_back({{"", p, p}, 0, 0, false});
  pb::RegistrationRules rules;
  rules.set_touch_noise_m(noise);
  std::vector<double> found, theory;
  TipErrors errors;
  std::vector<Eigen::Matrix3d> spread;
  for (const Vector3d& p_WT : tips) {
    const Eigen::Matrix3d covariance = tip_covariance(exact, noise, p_WT);
    spread.emplace_back(covariance.llt().matrixL());
    errors.theory_rms += covariance.trace() / 1000;
  }
  for (int draw = 0; draw < 200; ++draw) {
    const Result<Registration> result =
        register_points(touched(points, noise, draws), rules, kBoxMin, kBoxMax);
    EXPECT_TRUE(result.has_value()) << result.error();
    if (!result) return errors;
    const Isometry3d X = result.value().X_WR * true_pose().inverse();  // ideally the identity
    errors.touch_error += result.value().touch_error * result.value().touch_error / 200;
    for (std::size_t n = 0; n < tips.size(); ++n) {
      found.push_back((X * tips[n] - tips[n]).norm());
      errors.rms += found.back() * found.back() / 200'000;
      theory.push_back((spread[n] * draws.normals()).norm());
    }
  }
  errors.rms = std::sqrt(errors.rms);
  errors.theory_rms = std::sqrt(errors.theory_rms);
  errors.touch_error = std::sqrt(errors.touch_error);
  errors.percentile_95 = percentile_95(found);
  errors.theory_95 = percentile_95(theory);
  return errors;
}

TEST(Registration, TwelveNoisyTouchesPlaceTheTipWithinHalfAMillimetre) {
  for (const double pins : {0.0, 0.04, 0.08}) {
    const TipErrors errors = tip_errors(board(pins), kTouchNoise, 7);
    std::printf(
        "registration pins_mm=%.0f tip_error_p95_mm=%.3f theory_p95_mm=%.3f rms_mm=%.3f "
        "theory_rms_mm=%.3f\n",
        1e3 * pins, 1e3 * errors.percentile_95, 1e3 * errors.theory_95, 1e3 * errors.rms,
        1e3 * errors.theory_rms);
    EXPECT_NEAR(errors.touch_error, kTouchNoise, 0.03 * kTouchNoise);  // 30 x 200 degrees
    EXPECT_NEAR(errors.rms / errors.theory_rms, 1, 0.1);  // 200 draws of 6 numbers: 4 %
    EXPECT_LE(errors.percentile_95, 0.0005);
  }
}

TEST(Registration, NamesOutliersAndFitsWithoutThem) {
  Draws draws(8);
  auto points = touched(board(0.04), kTouchNoise, draws);
  const Result<Registration> clean = registered(points);
  points[4].p_RT += Vector3d(0.004, 0, 0);
  points[9].p_RT += Vector3d(0, -0.02, 0.01);
  const Result<Registration> result = registered(points);
  ASSERT_TRUE(clean.has_value() && result.has_value()) << result.error();
  for (std::size_t i = 0; i < points.size(); ++i)
    EXPECT_EQ(result.value().points[i].outlier, i == 4 || i == 9) << i;
  EXPECT_THAT(result.value().warnings,
              ElementsAre(HasSubstr("point p5 is"), HasSubstr("point p10 is")));
  // The good points alone decide.
  for (const std::size_t bad : {9U, 4U}) points.erase(points.begin() + bad);
  const Result<Registration> without = registered(points);
  ASSERT_TRUE(without.has_value());
  EXPECT_LT((without.value().X_WR.matrix() - result.value().X_WR.matrix()).norm(), 1e-12);
}

TEST(Registration, AThirdOfThePointsWrongIsStillFound) {
  Draws draws(9);
  for (int n = 0; n < 20; ++n) {
    auto points = touched(board(0.04), kTouchNoise, draws);
    for (const std::size_t i : {1U, 5U, 6U, 11U})
      points[i].p_RT += 0.03 * draws.normals().normalized();
    const Result<Registration> result = registered(points);
    ASSERT_TRUE(result.has_value()) << result.error();
    EXPECT_LT((result.value().X_WR * true_pose().inverse().matrix().col(3).head<3>()).norm(),
              0.002);
  }
}

TEST(Registration, RefusesMoreThanAThirdWrongAndNamesThem) {
  Draws draws(10);
  auto points = touched(board(0.04), kTouchNoise, draws);
  for (const std::size_t i : {0U, 2U, 5U, 7U, 9U})
    points[i].p_RT += 0.03 * draws.normals().normalized();
  EXPECT_THAT(points_refusal(points), AllOf(HasSubstr("do not fit"), HasSubstr("mm")));
}

TEST(Registration, RefusesSwappedPointsAndNamesThem) {
  Draws draws(11);
  for (std::size_t i = 0; i < 12; ++i) {
    for (std::size_t j = i + 1; j < 12; ++j) {
      auto points = touched(board(0.04), kTouchNoise, draws);
      std::swap(points[i].p_RT, points[j].p_RT);
      EXPECT_EQ(points_refusal(points), "points p" + std::to_string(i + 1) + " and p" +
                                            std::to_string(j + 1) +
                                            " were touched in each other's place");
    }
  }
}

TEST(Registration, RefusesASwapThatNothingTellsFromTheTruth) {
  // Exchanging two opposite corners of a square mirrors it, and a mirrored plane is a turned one.
  Draws draws(12);
  const auto points =
      touched({{-0.05, -0.05, 0}, {0.05, -0.05, 0}, {0.05, 0.05, 0}, {-0.05, 0.05, 0}}, 0, draws);
  EXPECT_THAT(points_refusal(points), HasSubstr("could be exchanged"));
}

TEST(Registration, RefusesCollinearPointsInWAndInR) {
  Draws draws(13);
  std::vector<Vector3d> line;
  for (int k = 0; k < 12; ++k) line.emplace_back(0.012 * k - 0.07, 0.02, 0.0);
  EXPECT_THAT(points_refusal(touched(line, kTouchNoise, draws)), HasSubstr("from one line in W"));
  line[3].y() += 0.003;  // near a line is as bad
  EXPECT_THAT(points_refusal(touched(line, kTouchNoise, draws)), HasSubstr("from one line in W"));
  // One point touched over and over, although others were meant.
  auto points = touched(board(0.04), kTouchNoise, draws);
  for (TouchedPoint& point : points) point.p_RT = points[0].p_RT;
  EXPECT_THAT(points_refusal(points), HasSubstr("from one line in R"));
}

TEST(Registration, RefusesWhatIsLeftOnALineWithoutTheOutliers) {
  Draws draws(14);
  std::vector<Vector3d> places;
  for (int k = 0; k < 8; ++k) places.emplace_back(0.02 * k - 0.07, 0.02, 0.0);
  places.emplace_back(0, 0.08, 0.01);
  places.emplace_back(0, -0.06, 0.02);
  auto points = touched(places, kTouchNoise, draws);
  points[8].p_RT.x() += 0.03;
  points[9].p_RT.y() -= 0.02;
  EXPECT_NE(points_refusal(points), "accepted");
}

TEST(Registration, RefusesTooFewDoubleAndInfinitePoints) {
  Draws draws(15);
  auto points = touched(board(0.04), 0, draws);
  EXPECT_THAT(points_refusal({points.begin(), points.begin() + 3}),
              HasSubstr("3 points, allowed 4"));
  auto twice = points;
  twice[3].name = "p2";
  EXPECT_THAT(points_refusal(twice), HasSubstr("two points are called p2"));
  points[6].p_RT.y() = std::nan("");
  EXPECT_THAT(points_refusal(points), HasSubstr("point p7 is not finite"));
}

TEST(Registration, WarnsOfFewPointsAndOfAPoorPrediction) {
  Draws draws(16);
  // A small patch below a high workspace.
  const std::vector<Vector3d> patch = {
      {0, 0, 0}, {0.03, 0, 0.004}, {0.03, 0.03, 0.012}, {0, 0.03, 0.001}, {0.012, 0.02, 0.01}};
  const Result<Registration> result = registered(touched(patch, 0.0002, draws));
  ASSERT_TRUE(result.has_value()) << result.error();
  EXPECT_THAT(result.value().warnings,
              ElementsAre(HasSubstr("5 points in the fit"), HasSubstr("predicted error")));
}

TEST(Registration, WarnsOfDistancesThatDoNotAgree) {
  Draws draws(17);
  auto points = touched(board(0.04), 0, draws);
  for (TouchedPoint& point : points) point.p_RT *= 1.006;  // within the tolerance of each point
  const Result<Registration> result = registered(points);
  ASSERT_TRUE(result.has_value()) << result.error();
  EXPECT_THAT(result.value().warnings, ElementsAre(HasSubstr("1.0060 times those in W")));
}

TEST(Registration, WarnsOfAgeAndOfTheFuture) {
  Registration registration;
  registration.date_ns = 1'000'000'000'000'000;
  const auto after_h = [&](double hours) {
    return age_warning(registration, pb::RegistrationRules::default_instance(),
                       registration.date_ns + static_cast<std::int64_t>(hours * 3.6e12));
  };
  EXPECT_EQ(after_h(0), "");
  EXPECT_EQ(after_h(23.9), "");
  EXPECT_THAT(after_h(25), HasSubstr("25.0 h old, allowed 24 h"));
  EXPECT_THAT(after_h(-2), HasSubstr("2.0 h in the future"));
}

/// Poses whose tip is at p_RP, turned by up to `angle` about all axes.
std::vector<PsmPose> pivoted(int count, double angle, double noise, Draws& draws) {
  std::vector<PsmPose> poses;
  const Vector3d p_CT(0.0003, -0.0002, 0.0102);
  const Vector3d p_RP(0.02, 0.03, -0.12);
  for (int n = 0; n < count; ++n) {
    PsmPose pose;
    pose.R = Eigen::AngleAxisd(draws.uniform(-angle, angle), draws.normals().normalized())
                 .toRotationMatrix();
    pose.p = p_RP - pose.R * p_CT + noise * draws.normals();
    poses.push_back(pose);
  }
  return poses;
}

TEST(PivotTip, FindsTheTipThatStaysAtAPoint) {
  Draws draws(18);
  const Result<TipPivot> pivot = pivot_tip(pivoted(10, 0.8, 0, draws));
  ASSERT_TRUE(pivot.has_value()) << pivot.error();
  EXPECT_LT((pivot.value().p_CT - Vector3d(0.0003, -0.0002, 0.0102)).norm(), 1e-12);
  EXPECT_LT((pivot.value().p_RP - Vector3d(0.02, 0.03, -0.12)).norm(), 1e-12);
  EXPECT_GT(pivot.value().condition, 1);
  EXPECT_LT(pivot.value().condition, 30);
}

TEST(PivotTip, ItsDeviationIsThatOfTheDraws) {
  Draws draws(19);
  Vector3d squares = Vector3d::Zero();
  Vector3d predicted = Vector3d::Zero();
  for (int n = 0; n < 400; ++n) {
    const Result<TipPivot> pivot = pivot_tip(pivoted(30, 0.8, 0.0003, draws));
    ASSERT_TRUE(pivot.has_value()) << pivot.error();
    const Vector3d error = pivot.value().p_CT - Vector3d(0.0003, -0.0002, 0.0102);
    squares += error.cwiseAbs2() / 400;
    predicted += pivot.value().p_CT_std.cwiseAbs2() / 400;
    EXPECT_NEAR(pivot.value().residual_rms, 0.0003 * std::sqrt(3.0), 0.0002);
  }
  // 400 draws know a variance within 7 %.
  for (int k = 0; k < 3; ++k) EXPECT_NEAR(squares[k] / predicted[k], 1, 0.3);
}

TEST(PivotTip, RefusesPosesThatHardlyTurn) {
  Draws draws(20);
  EXPECT_FALSE(pivot_tip(pivoted(3, 0.8, 0, draws)).has_value());
  const Result<TipPivot> pivot = pivot_tip(pivoted(12, 0.01, 0, draws));
  ASSERT_FALSE(pivot.has_value());
  EXPECT_THAT(pivot.error(), AllOf(HasSubstr("turned too little"), HasSubstr("allowed 30")));
}

}  // namespace
}  // namespace omentum
