// Parts of a calibration: what a camera sees of a surface, likelihood, normal equations, the
// search.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <map>

#include "core/config.h"
#include "mismatch/calibrate/calibration_file.h"
#include "mismatch/calibrate/genetic_search.h"
#include "mismatch/fit/likelihood.h"
#include "mismatch/fit/normal_equations.h"
#include "mismatch/fit/unknowns.h"
#include "mismatch/seen/seen_surface.h"

namespace omentum {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr int kSide = 9;          // places of the grid along an edge
constexpr double kPitch = 0.01;   // [m]
constexpr double kThick = 0.004;  // [m]

/// A slightly curved sheet, 80 mm wide, its middle at the origin.
struct Sheet {
  std::vector<Eigen::Vector3i> triangles;
  std::vector<Vector3d> vertices;
  std::vector<Vector2d> uv;
};
Sheet make_sheet() {
  Sheet sheet;
  std::vector<Eigen::Vector3i> upper;
  for (const double side : {0.5, -0.5}) {
    for (int i = 0; i < kSide; ++i) {
      for (int j = 0; j < kSide; ++j) {
        const double x = kPitch * (i - (kSide - 1) / 2), y = kPitch * (j - (kSide - 1) / 2);
        sheet.vertices.emplace_back(x, y, 4 * x * y + 3 * x * x + side * kThick);
        if (side > 0) sheet.uv.emplace_back(i / (kSide - 1.0), j / (kSide - 1.0));
        if (side < 0 || i == 0 || j == 0) continue;
        const int d = i * kSide + j, a = d - kSide - 1, b = d - 1, c = d - kSide;
        upper.emplace_back(a, b, d);
        upper.emplace_back(a, d, c);
      }
    }
  }
  sheet.triangles = close_sheet(upper, kSide * kSide);
  return sheet;
}

/// A camera above the sheet, tilted.
Observation camera_over(const std::vector<Vector3d>& points) {
  Observation seen;
  seen.name = "a";
  seen.p_WC = Vector3d(0.02, 0.15, 0.3);
  const Vector3d axis = -seen.p_WC.normalized();
  seen.R_WC.col(2) = -axis;
  seen.R_WC.col(0) = axis.cross(Vector3d::UnitZ()).normalized();
  seen.R_WC.col(1) = seen.R_WC.col(2).cross(seen.R_WC.col(0));
  seen.track.time = {0, 1};
  seen.track.p_WT = {Vector3d(0, 0, 0.3), Vector3d(0, 0, 0.3)};
  seen.frames.push_back({0.5, points, SeenForce{Vector3d(0.02, -0.01, -0.15), 0}});
  return seen;
}

TEST(CloseSheet, EveryEdgeBelongsToTwoTrianglesThatFaceTheSameWay) {
  std::map<std::pair<int, int>, int> edges;
  for (const Eigen::Vector3i& t : make_sheet().triangles) {
    for (int k = 0; k < 3; ++k) ++edges[{t[k], t[(k + 1) % 3]}];
  }
  for (const auto& [edge, count] : edges) {
    EXPECT_EQ(count, 1) << edge.first << " " << edge.second;
    EXPECT_TRUE(edges.contains({edge.second, edge.first}));
  }
}

TEST(SeenSurface, ARayMeetsTheNearFaceAtItsRange) {
  const Sheet sheet = make_sheet();
  SeenSurface surface(sheet.triangles, sheet.vertices);
  const Observation camera = camera_over({});
  surface.fit(sheet.vertices, camera.p_WC, camera.R_WC);
  int met = 0;
  for (int k = 0; k < 200; ++k) {
    const Vector3d target(0.038 * std::sin(7.0 * k), 0.038 * std::cos(3.0 * k), 0.001);
    const auto hit = surface.cast(target);
    if (!hit) continue;
    ++met;
    const Vector3d place = surface.at(*hit);
    const Vector3d d = (target - camera.p_WC).normalized();
    EXPECT_NEAR((place - camera.p_WC).norm(), hit->range, 1e-12);
    EXPECT_NEAR((place - camera.p_WC).cross(d).norm(), 0, 1e-12) << "on the ray";
    EXPECT_LT(surface.normal(hit->triangle).dot(d), 0) << "a face that looks at the camera";
  }
  EXPECT_GT(met, 150);
  EXPECT_FALSE(surface.cast(Vector3d(0.2, 0, 0)));
  EXPECT_TRUE(surface.sees(kSide * kSide / 2));
  EXPECT_FALSE(surface.sees(kSide * kSide + kSide * kSide / 2)) << "the lower face";
}

TEST(SeenSurface, BetweenItsPlacesASmoothFaceIsNoChord) {
  const Sheet sheet = make_sheet();
  SeenSurface surface(sheet.triangles, sheet.vertices);
  const Observation camera = camera_over({});
  surface.fit(sheet.vertices, camera.p_WC, camera.R_WC);
  double chord = 0, smooth = 0;
  for (int k = 0; k < 200; ++k) {  // normals of the rim are one-sided: places inside of it
    const Vector3d target(0.028 * std::sin(7.0 * k), 0.028 * std::cos(3.0 * k), 0.002);
    const auto hit = surface.cast(target);
    ASSERT_TRUE(hit);
    const Vector3d d = (target - camera.p_WC).normalized();
    const auto off = [&](double range) {
      const Vector3d p = camera.p_WC + range * d;
      return std::fabs(p.z() - 4 * p.x() * p.y() - 3 * p.x() * p.x() - kThick / 2);
    };
    chord = std::max(chord, off(hit->range));
    smooth = std::max(smooth, off(hit->range + hit->bulge / surface.normal(hit->triangle).dot(d)));
  }
  EXPECT_GT(chord, 7e-5);
  EXPECT_LT(smooth, 0.1 * chord);
}

constexpr int kCosinesPerSide = 3, kCosines = kCosinesPerSide * kCosinesPerSide;

/// A prediction with some columns, and points that do not lie on it.
struct Case {
  Sheet sheet = make_sheet();
  Layout layout{2, 0, 0, kCosines};
  Prediction prediction;
  Observation seen;
  NoiseModel noise{1e-3, 5e-4, 0.02, 4, 1e-4, 0.01};

  Case() {
    PredictedFrame frame;
    frame.valid = true;
    frame.vertices = sheet.vertices;
    frame.tip = Vector3d(0, 0, 0.305);  // half of the lift
    frame.columns.setZero(3 * static_cast<Eigen::Index>(sheet.vertices.size()) + 3,
                          layout.unknowns.count + kOwnColumns);
    for (std::size_t i = 0; i < sheet.vertices.size(); ++i) {
      const Vector3d& p = sheet.vertices[i];
      frame.velocity.emplace_back(0.02, -0.01, 0.3 * p.x());
      const auto at = 3 * static_cast<Eigen::Index>(i);
      frame.columns(at + 2, 0) = static_cast<float>(0.02 * p.y() + 0.001);
      frame.columns(at + 1, 1) = static_cast<float>(0.05 * p.x());
      frame.columns(at + 2, 2) = static_cast<float>(p.x());
      frame.columns(at + 2, 3) = static_cast<float>(p.y() + 0.01);
    }
    frame.force = Vector3d(0.025, 0, -0.12);
    frame.columns.bottomRows<3>() << 0.02F, 0.1F, 0.3F, 0, 0, 0.01F, 0, 0.4F, -0.1F, -0.03F, 0, 1;
    prediction.frames.push_back(frame);
    prediction.lift = 0.01;
    std::vector<Vector3d> points;
    for (int k = 0; k < 400; ++k) {
      const double x = 0.036 * std::sin(1.7 * k), y = 0.036 * std::cos(2.9 * k);
      points.emplace_back(x, y, 4 * x * y + 3 * x * x + kThick / 2 + 0.001 * std::sin(11.0 * k));
    }
    seen = camera_over(points);
  }
  /// At a step of one column, or of the registration.
  Comparison at(const Registration6& registration = {}, int column = 0, double by = 0) const {
    VectorXd delta = VectorXd::Zero(layout.size());
    delta[column] = by;
    return {seen, prediction, layout, registration, delta};
  }
  NormalEquations compared(const Likelihood& likelihood) const {
    return likelihood.compare(at(), noise, true);
  }
};

TEST(Likelihood, ItsGradientIsTheDerivativeOfItsCost) {
  Case c;
  Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                        kCosinesPerSide);
  const NormalEquations block = c.compared(likelihood);
  EXPECT_GT(block.hits, 350U);
  EXPECT_EQ(block.no_tissue, 0U);
  const auto cost = [&](int k, double by) {
    Registration6 registration;
    const int place = k - c.layout.registration.begin;
    if (place >= 0 && place < 3) {
      registration.shift[place] = by;
    } else if (place >= 3 && place < 6) {
      registration.turn[place - 3] = by;
    } else {
      return likelihood.compare(c.at({}, k, by), c.noise, false).cost;
    }
    return likelihood.compare(c.at(registration), c.noise, false).cost;
  };
  for (int k = 0; k < c.layout.size(); ++k) {
    // A step that moves the surface by about 1 um.
    const Layout& l = c.layout;
    const double step = k < l.unknowns.count || k == l.stiffness_factor.begin ? 1e-3
                        : k == l.clock.begin || k == l.own_clock.begin        ? 1e-4
                        : k >= l.registration.begin + 3 && k < l.clock.begin  ? 3e-5
                                                                              : 1e-6;
    const double slope = (cost(k, step) - cost(k, -step)) / (2 * step);
    const double scale = std::sqrt(block.A(k, k));
    EXPECT_NEAR(slope / scale, -block.b[k] / scale,
                0.05 * std::fabs(block.b[k] / scale) + 1)  // of 400 rows: edges move too
        << "column " << k;
  }
}

TEST(Likelihood, AFrameTellsOfTheSmoothDifferenceByItsFunctionsOfTime) {
  Case c;
  Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                        kCosinesPerSide);
  const auto block = [&](double t) {
    Case other = c;
    other.seen.frames[0].t = t;
    other.seen.frames.push_back(c.seen.frames[0]);  // at 0
    other.prediction.frames.push_back(c.prediction.frames[0]);
    other.prediction.frames[0].tip.z() += 0.002;
    other.prediction.frames[1].valid = false;
    std::swap(other.seen.frames[0], other.seen.frames[1]);
    std::swap(other.prediction.frames[0], other.prediction.frames[1]);
    return other.compared(likelihood);
  };
  const NormalEquations late = block(1);  // a lift of 0.7 at the end
  const Eigen::Vector4d time = discrepancy_in_time(0.7, 1);
  EXPECT_NEAR(time[2], 0.49, 1e-12);
  EXPECT_NEAR(time[3], -0.7, 1e-12);
  const int n = c.layout.modes.begin;
  const Eigen::MatrixXd one = late.A.block(n, n, kCosines, kCosines);
  EXPECT_GT(one.norm(), 0);
  for (int i = 0; i < kTimeFunctions; ++i) {
    for (int j = 0; j < kTimeFunctions; ++j) {
      const auto part = late.A.block(n + i * kCosines, n + j * kCosines, kCosines, kCosines);
      EXPECT_LT((part - time[i] * time[j] * one).norm(), 1e-9 * one.norm()) << i << ", " << j;
    }
  }
  EXPECT_LT((late.A - late.A.transpose()).norm(), 1e-12 * late.A.norm());
}

TEST(Likelihood, WhatHardlyMovesTellsNoTime) {
  // Where model and tissue may be 0.1 mm apart, no frame tells its time better than as long as the
  // tissue takes for that, however many points it has.
  Case c;
  c.noise.along_motion = 1e-4;
  for (const double speed : {1e-4, 1e-2, 1.0}) {
    for (PredictedFrame& frame : c.prediction.frames)
      frame.velocity.assign(frame.vertices.size(), Vector3d(0, 0, speed));
    Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                          kCosinesPerSide);
    const NormalEquations block = c.compared(likelihood);
    const int k = c.layout.clock.begin;
    const double sd = 1 / std::sqrt(block.A(k, k));
    const double frames = static_cast<double>(c.prediction.frames.size());
    const double least = 1e-4 / speed / std::sqrt(frames);
    EXPECT_GT(sd, least) << speed;
    EXPECT_LT(sd, 1.5 * least) << speed;
  }
}

TEST(Likelihood, PointsFarFromTheBodyAreNoTissue) {
  Case c;
  for (int k = 0; k < 50; ++k) c.seen.frames[0].points.emplace_back(0.01 * k - 0.2, 0.1, 0);
  Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                        kCosinesPerSide);
  const NormalEquations block = c.compared(likelihood);
  EXPECT_EQ(block.no_tissue, 50U);
}

TEST(Likelihood, ASheetThatIsSeenLargerThanSimulatedIsPulledOutwards) {
  Case c;
  // The simulated sheet shrinks by a tenth: its rim has rays beside it.
  for (Vector3d& p : c.prediction.frames[0].vertices) p.head<2>() *= 0.9;
  Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                        kCosinesPerSide);
  const NormalEquations block = c.compared(likelihood);
  EXPECT_GT(block.passing, 5U);
}

TEST(Likelihood, ARayThatSlipsOffTheEdgeChangesNothingAtOnce) {
  Case c;
  Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                        kCosinesPerSide);
  constexpr double kStep = 1e-6;  // [m]
  for (const double off : {-0.002, 0.002}) {
    // Two standard deviations before or behind the face, near its edge at x = 40 mm.
    const double x = 0.0397, y = 0.011;
    Vector3d p(x, y, 4 * x * y + 3 * x * x + kThick / 2);
    p += off * (p - c.seen.p_WC).normalized();
    c.seen.frames[0].points = {p};
    double before = 0, largest = 0;
    std::size_t hits = 0, beside = 0;
    for (int k = 0; k < 700; ++k) {  // the body slides away under the ray
      Registration6 registration;
      registration.shift.x() = -k * kStep;
      const NormalEquations block = likelihood.compare(c.at(registration), c.noise, false);
      if (k > 0) largest = std::max(largest, std::fabs(block.cost - before));
      before = block.cost;
      hits += block.hits;
      beside += block.passing;
    }
    EXPECT_GT(hits, 100U);
    EXPECT_GT(beside, 100U);
    EXPECT_LT(largest, 0.02) << "the whole row counts 1.7";
  }
}

/// What a camera of 2 mm per pixel sees of the body, its picture turned about its axis.
std::vector<Vector3d> seen_by_pixels(const Case& c, double turn) {
  constexpr double kPixel = 0.002 / 0.34;
  SeenSurface surface(c.sheet.triangles, c.sheet.vertices);
  surface.fit(c.sheet.vertices, c.seen.p_WC, c.seen.R_WC);
  std::vector<Vector3d> points;
  for (int i = -50; i <= 50; ++i) {
    for (int j = -50; j <= 50; ++j) {
      const Vector2d at = Eigen::Rotation2Dd(turn) * Vector2d(kPixel * i, kPixel * j);
      const Vector3d d = c.seen.R_WC * Vector3d(at.x(), at.y(), -1).normalized();
      if (const auto hit = surface.cast(c.seen.p_WC + d))
        points.push_back(c.seen.p_WC + hit->range * d);
    }
  }
  return points;
}

TEST(Likelihood, TheBodyThatWasSeenLacksNoPointAtItsEdges) {
  for (const double turn : {0.0, 0.2, 0.4, 0.6, 0.8}) {
    Case c;
    c.seen.frames[0].points = seen_by_pixels(c, turn);
    ASSERT_GT(c.seen.frames[0].points.size(), 1000U);
    const auto block_of = [&](double growth) {
      for (std::size_t i = 0; i < c.sheet.vertices.size(); ++i) {
        Vector3d& p = c.prediction.frames[0].vertices[i];
        p = c.sheet.vertices[i];
        p.head<2>() *= 1 + growth / 0.04;
      }
      Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                            kCosinesPerSide);
      return likelihood.compare(c.at(), c.noise, false);
    };
    const NormalEquations exact = block_of(0);
    EXPECT_EQ(exact.gaps, 0U) << turn;
    EXPECT_EQ(exact.passing, 0U) << turn;
    EXPECT_GT(block_of(0.006).gaps, 5U) << "three pixels larger";
    EXPECT_GT(block_of(-0.006).passing, 50U) << "three pixels smaller";
  }
}

TEST(Likelihood, PlacesUnderTheBarOfAClampNeedNotBeSeen) {
  constexpr double kBar = -0.025;  // [m] it covers what lies below, along y
  Case c;
  c.seen.frames[0].points = seen_by_pixels(c, 0.2);
  std::erase_if(c.seen.frames[0].points, [](const Vector3d& p) { return p.y() < kBar; });
  Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                        kCosinesPerSide);
  EXPECT_GT(likelihood.compare(c.at(), c.noise, false).gaps, 5U);
  std::vector<bool> covered;
  for (const Vector3d& p : c.sheet.vertices) covered.push_back(p.y() < kBar);
  likelihood.set_covered(covered);
  EXPECT_EQ(likelihood.compare(c.at(), c.noise, false).gaps, 0U);
}

TEST(Likelihood, ACloudOfTheUpperFaceAlonePullsNothing) {
  Case c;
  // Ten millimetres more: the camera would see of the rim what is far from every point.
  for (std::size_t i = c.sheet.uv.size(); i < c.sheet.vertices.size(); ++i)
    c.sheet.vertices[i].z() -= 0.01;
  c.prediction.frames[0].vertices = c.sheet.vertices;
  std::vector<Vector3d>& points = c.seen.frames[0].points;
  points = seen_by_pixels(c, 0.2);
  const std::size_t all = points.size();
  std::erase_if(points, [](const Vector3d& p) {
    return p.z() < 4 * p.x() * p.y() + 3 * p.x() * p.x() + kThick / 2 - 1e-3;
  });
  ASSERT_LT(points.size(), all) << "the rim was seen";
  Likelihood likelihood(c.sheet.triangles, c.sheet.vertices, c.sheet.uv, Vector3d::Zero(),
                        kCosinesPerSide);
  EXPECT_EQ(likelihood.compare(c.at(), c.noise, false).gaps, 0U);
}

TEST(SolveNormalEquations, IsTheDenseSystem) {
  const Layout layout{1, 0, 0, kCosines};
  const int n = layout.size(), s = layout.shared(), o = layout.own();
  std::vector<NormalEquations> blocks(3);
  std::vector<VectorXd> own(3, VectorXd::Constant(o, 0.01));
  const VectorXd shared = VectorXd::Constant(s, -0.02);
  Beliefs beliefs{VectorXd::Constant(s, 0.5), VectorXd::Constant(o, 0.2)};
  MatrixXd H = MatrixXd::Zero(s + 3 * o, s + 3 * o);
  VectorXd g = VectorXd::Zero(s + 3 * o);
  H.topLeftCorner(s, s).diagonal().setConstant(1 / 0.25);
  g.head(s) = -shared / 0.25;
  std::srand(1);
  for (int k = 0; k < 3; ++k) {
    const MatrixXd J = MatrixXd::Random(n, 200);
    blocks[k].A = J * J.transpose();
    blocks[k].b = VectorXd::Random(n);
    const int at = s + k * o;
    H.topLeftCorner(s, s) += blocks[k].A.topLeftCorner(s, s);
    H.block(0, at, s, o) += blocks[k].A.topRightCorner(s, o);
    H.block(at, 0, o, s) += blocks[k].A.bottomLeftCorner(o, s);
    H.block(at, at, o, o) += blocks[k].A.bottomRightCorner(o, o);
    H.block(at, at, o, o).diagonal().array() += 1 / 0.04;
    g.head(s) += blocks[k].b.head(s);
    g.segment(at, o) += blocks[k].b.tail(o) - own[k] / 0.04;
  }
  const MatrixXd covariance = H.inverse();
  const VectorXd step = covariance * g;
  const FitPosterior found = solve_normal_equations(blocks, layout, beliefs, shared, own, 1);
  EXPECT_LT((found.shared_step - step.head(s)).norm(), 1e-9);
  EXPECT_LT((found.shared_covariance - covariance.topLeftCorner(s, s)).norm(), 1e-9);
  EXPECT_NEAR(found.log_determinant, 2 * MatrixXd(H.llt().matrixL()).diagonal().array().log().sum(),
              1e-6);
  for (int k = 0; k < 3; ++k) {
    const int at = s + k * o;
    EXPECT_LT((found.own_step[k] - step.segment(at, o)).norm(), 1e-9);
    EXPECT_LT((found.own_sd[k] - covariance.diagonal().segment(at, o).cwiseSqrt()).norm(), 1e-9);
  }
}

TEST(Unknowns, ValueAndItsInverseAgreeAndTheSlopeIsTheDerivative) {
  const pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  pb::Priors priors;
  pb::Prior& prior = *priors.add_prior();
  prior.set_path("scene.tissue.material.young_modulus_pa");
  prior.set_factor(2);
  const std::vector<Unknown> unknowns = unknowns_of(scene, priors, false);
  EXPECT_EQ(unknowns.front().sd, std::log(2.0));
  for (const Unknown& u : unknowns) {
    EXPECT_NEAR(u.value(0), u.believed, 1e-12 * std::fabs(u.believed)) << u.path;
    for (const double x : {-0.3, 0.2}) {
      EXPECT_NEAR(u.at(u.value(x)), x, 1e-9) << u.path;
      EXPECT_NEAR((u.value(x + 1e-6) - u.value(x - 1e-6)) / 2e-6, u.slope(x),
                  1e-6 * std::fabs(u.slope(x)) + 1e-6)
          << u.path;
    }
  }
  const VectorXd far = VectorXd::Constant(static_cast<Eigen::Index>(unknowns.size()), 50);
  EXPECT_NO_THROW(check_ranges(scene_at(scene, unknowns, far, {}), "scene"))
      << "values stay inside the range of their knobs";
}

TEST(GeneticSearch, FindsAMinimumAndTheSameOneTwice) {
  const auto costs = [](std::vector<Candidate>& candidates) {
    for (Candidate& c : candidates) {
      const VectorXd d = Vector3d(c.gene[0] - 0.3, c.gene[1] - 0.8, c.gene[2] - 0.55);
      c.cost = d.squaredNorm() + 0.05 * (1 - std::cos(20 * d[0]));
    }
  };
  GeneticSettings settings{24, 25, 7};
  const auto all = search_genetically(settings, costs);
  EXPECT_LT(all.front().cost, 2e-3);
  const auto again = search_genetically(settings, costs);
  ASSERT_EQ(all.size(), again.size());
  for (std::size_t k = 0; k < all.size(); ++k) EXPECT_EQ(all[k].gene, again[k].gene);
  settings.seed = 8;
  EXPECT_NE(search_genetically(settings, costs).front().gene, all.front().gene);
}

TEST(CalibrationFile, HasTheFieldsThatOthersRelyOn) {
  Calibration c;
  c.method = "reference";
  CalibratedNumber n;
  n.name = "scene.tissue.material.young_modulus_pa";
  n.value = std::nan("");
  c.parameters.push_back(n);
  FitRow row;
  row.rmse_model = 2;
  c.fit.push_back(row);
  const std::string text = print_calibration(c);
  for (const char* field : {"format_version", "method",     "parameters", "name",       "unit",
                            "value",          "low90",      "high90",     "prior",      "at_bound",
                            "groups",         "nuisances",  "fit",        "recording",  "role",
                            "rmse_base",      "rmse_model", "floor",      "numerics_m", "warnings",
                            "core_seconds"}) {
    EXPECT_THAT(text, testing::HasSubstr(fmt::format("\"{}\"", field))) << field;
  }
}

}  // namespace
}  // namespace omentum
