// Markers of motion capture as measurements of a calibration.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>

#include "core/config.h"
#include "mismatch/calibrate/scores.h"
#include "mismatch/fit/marker_binding.h"
#include "mismatch/fit/search.h"
#include "mismatch/seen/seen_markers.h"

namespace omentum {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::VectorXd;

TEST(MarkerPlace, SlopesAreTheDerivativesOfItsPlace) {
  std::vector<Vector3d> vertices = {{0.001, 0, 0.002}, {0.006, 0.001, 0}, {0.002, 0.005, 0.001}};
  MarkerPlace place = put_marker({0, 1, 2}, {0.5, 0.2, 0.3}, vertices, {0.003, 0.001, 0.009});
  const Vector3d more(1e-4, -2e-4, 3e-4);
  const Vector3d direction = Vector3d(1, -2, 0.5).normalized();
  const auto slopes =
      corner_slopes(place, place_marker(place, vertices, more), vertices, direction);
  constexpr double kStep = 1e-7;  // [m]
  for (std::size_t corner = 0; corner < 3; ++corner) {
    for (int axis = 0; axis < 3; ++axis) {
      const auto along = [&](double by) {
        std::vector<Vector3d> moved = vertices;
        moved[corner][axis] += by;
        return direction.dot(place_marker(place, moved, more).p);
      };
      EXPECT_NEAR((along(kStep) - along(-kStep)) / (2 * kStep), slopes[corner][axis], 1e-6)
          << corner << ", " << axis;
    }
  }
}

TEST(MarkerPlace, TurnsWithItsTriangle) {
  const std::vector<Vector3d> vertices = {{0, 0, 0}, {0.005, 0, 0}, {0, 0.005, 0.001}};
  const Vector3d p(0.002, 0.001, 0.006);
  const MarkerPlace place = put_marker({0, 1, 2}, {0.4, 0.4, 0.2}, vertices, p);
  const Isometry3d X =
      Eigen::Translation3d(0.1, 0.2, -0.3) * Eigen::AngleAxisd(1.2, Vector3d(1, 2, 3).normalized());
  std::vector<Vector3d> moved;
  for (const Vector3d& v : vertices) moved.push_back(X * v);
  EXPECT_LT((place_marker(place, moved, Vector3d::Zero()).p - X * p).norm(), 1e-15);
}

/// A body that hangs on a clamp, was held and let go.
pb::Scene held_scene() {
  pb::Scene scene;
  pb::Tissue& tissue = *scene.mutable_tissue();
  tissue.mutable_grid()->set_count_x(5);
  tissue.mutable_grid()->set_count_y(9);
  tissue.mutable_grid()->set_pitch_m(0.005);
  tissue.set_thickness_m(0.004);
  tissue.set_anchor_max_y_m(-0.019);
  tissue.set_model(pb::TISSUE_REFERENCE);
  tissue.mutable_material()->set_damping_per_s(5);
  scene.mutable_tool()->set_contact(false);
  scene.mutable_held_start()->set_y_m(0.02);
  return override_scene(scene, {});
}

constexpr double kRelease = 0.314;  // [s]

/// Markers at places that fall from the release on as from a swing, 100 Hz, until 1 s. They are
/// written in the order of `names`; "unseen" is seen in no row.
Recording recording_of(const std::vector<std::string>& names, double later = 0,
                       const std::function<Isometry3d(double)>& clamp = {}) {
  const std::map<std::string, Vector3d> places = {
      {"a", {0.006, 0.018, 0.004}}, {"b", {-0.007, 0.016, 0.004}}, {"c", {0.001, 0.006, 0.005}},
      {"base1", {0.02, -0.02, 0}},  {"base2", {-0.02, -0.02, 0}},  {"base3", {0, -0.03, 0.01}}};
  Recording made;
  made.info.mutable_start()->set_held_markers(true);
  Series& series = made.series["markers"];
  for (const std::string& name : names) {
    for (const char* axis : {"x", "y", "z"}) series.columns.push_back(name + "_" + axis + "_m");
  }
  for (int row = 0; row <= 100; ++row) {
    const double t = 0.01 * row;
    series.time_ns.push_back(std::llround(1e9 * (t + later)));
    const double phase = 40 * std::max(0.0, t - kRelease);
    for (const std::string& name : names) {
      Vector3d p = Vector3d::Constant(std::nan(""));
      if (places.contains(name)) {
        p = places.at(name);
        if (!name.starts_with("base"))
          p.z() -= 0.005 * (1 - std::cos(phase)) * (p.y() + 0.02) / 0.04;
        if (clamp) p = clamp(t) * p;
      }
      series.values.insert(series.values.end(), p.begin(), p.end());
    }
  }
  return made;
}

Observation observed(const Recording& recording, const MarkerNotes& notes = {}) {
  std::vector<std::string> warnings;
  const Scene scene = make_scene(held_scene(), "");
  std::vector<Observation> all = {observe("a", "a", recording, scene, notes, {}, warnings)};
  number_markers(all, warnings);
  EXPECT_TRUE(warnings.empty()) << warnings.front();
  return all.front();
}

void expect_equal(const Observation& a, const Observation& b, double later = 0,
                  double tolerance = 0) {
  EXPECT_EQ(a.markers, b.markers);
  EXPECT_NEAR(a.released + later, b.released, 1e-9);
  EXPECT_NEAR(a.track.begin() + later, b.track.begin(), 1e-9);
  ASSERT_EQ(a.frames.size(), b.frames.size());
  for (std::size_t k = 0; k < a.frames.size(); ++k) {
    EXPECT_NEAR(a.frames[k].t + later, b.frames[k].t, 1e-9);
    ASSERT_EQ(a.frames[k].markers.size(), b.frames[k].markers.size());
    for (std::size_t m = 0; m < a.frames[k].markers.size(); ++m) {
      EXPECT_EQ(a.frames[k].markers[m].marker, b.frames[k].markers[m].marker);
      EXPECT_LE((a.frames[k].markers[m].p - b.frames[k].markers[m].p).norm(), tolerance);
    }
  }
}

TEST(Markers, TheirOrderAndOneThatIsNeverSeenChangeNothing) {
  const Observation seen = observed(recording_of({"a", "b", "c"}));
  EXPECT_EQ(seen.markers, (std::vector<std::string>{"a", "b", "c"}));
  expect_equal(seen, observed(recording_of({"c", "a", "b"})));
  expect_equal(seen, observed(recording_of({"b", "unseen", "a", "c"})));
}

TEST(Markers, ABodyIsLetGoWhenTheyBeginToFall) {
  const Observation seen = observed(recording_of({"a", "b", "c"}));
  EXPECT_NEAR(seen.released, kRelease, 0.002);
  EXPECT_LT(seen.track.begin(), seen.released);
  EXPECT_GT(seen.track.jaw_rad.front(), seen.grasp.closed_rad) << "no jaws take it";
  expect_equal(seen, observed(recording_of({"a", "b", "c"}, 12.5)), 12.5);
  Recording stated = recording_of({"a", "b", "c"});
  stated.info.mutable_start()->set_release_time_s(0.4);
  EXPECT_EQ(observed(stated).released, 0.4);
}

TEST(Markers, AMotionOfTheClampIsTakenOff) {
  MarkerNotes notes;
  for (const char* name : {"base1", "base2", "base3"})
    notes.by_name[name].on = MarkerNote::On::kClamp;
  const std::vector<std::string> names = {"a", "b", "c", "base1", "base2", "base3"};
  const Recording still = recording_of(names);
  find_clamp(still, notes);
  const Recording moving = recording_of(names, 0, [](double t) -> Isometry3d {
    return Eigen::Translation3d(0, 0.001 * t, 0) *
           Eigen::AngleAxisd(0.03 * std::sin(20 * t), Vector3d(1, 1, 0).normalized());
  });
  const Observation seen = observed(still, notes);
  EXPECT_EQ(seen.markers, (std::vector<std::string>{"a", "b", "c"}));
  expect_equal(seen, observed(moving, notes), 0, 1e-12);
}

TEST(Markers, ABodyThatWasHeldNeedsThePlaceInItsScene) {
  pb::Scene scene = held_scene();
  scene.clear_held_start();
  std::vector<std::string> warnings;
  EXPECT_THROW(observe("a", "a", recording_of({"a"}), make_scene(scene, ""), warnings), Error);
}

/// A bent sheet that rises and sinks, and markers that stand off it, seen `late` [s].
struct Rising {
  static constexpr int kFrames = 30;
  pb::Scene scene = held_scene();
  std::unique_ptr<FitData> data;
  Linearisation linear;
  Which which = {0};
  std::vector<std::string> warnings;

  static double height(double t) { return 0.004 * std::sin(9 * t) * std::exp(-t); }
  /// The body at a time, and by how much a unit of the stiffness moves it.
  static std::vector<Vector3d> surface(const Scene& made, double t) {
    std::vector<Vector3d> vertices;
    for (const double side : {0.5, -0.5}) {
      for (const Vector3d& p : made.tissue.particles) {
        const double s = (p.y() + 0.02) / 0.04;
        vertices.push_back(made.tissue.X_WB *
                           (p + Vector3d(0, 0, side * made.tissue.thickness + height(t) * s * s)));
      }
    }
    return vertices;
  }

  explicit Rising(double late = 0, double stiffer = 0) {
    const Scene made = make_scene(scene, "");
    Observation seen;
    seen.name = "a";
    seen.p_WC = Vector3d(0, 0, 1);
    seen.held = true;
    seen.markers = {"a", "b", "c"};
    seen.marker_noise = 1e-5;
    seen.track.time = {0, 2};
    seen.track.p_WT.assign(2, seen.p_WC);
    seen.track.jaw_rad.assign(2, 1);
    const auto places = static_cast<int>(made.tissue.particles.size());
    const std::vector<Eigen::Vector3i> upper(made.tissue.surface_triangles.begin(),
                                             made.tissue.surface_triangles.end());
    const std::vector<Vector3d> first = surface(made, 0);
    std::vector<MarkerPlace> truth;
    for (const Eigen::Vector3i& corner : {upper[5], upper[30], upper[upper.size() - 3]}) {
      const Vector3d foot =
          (first[static_cast<std::size_t>(corner[0])] + first[static_cast<std::size_t>(corner[1])] +
           first[static_cast<std::size_t>(corner[2])]) /
          3;
      truth.push_back(put_marker(corner, Vector3d::Constant(1.0 / 3), first,
                                 foot + Vector3d(5e-4, -3e-4, 0.005)));
    }
    Prediction prediction;
    for (int k = 0; k < kFrames; ++k) {
      SeenFrame frame;
      frame.t = 0.04 * k;
      std::vector<Vector3d> here = surface(made, frame.t - late);
      for (std::size_t v = 0; v < here.size(); ++v)
        here[v].z() += stiffer * kSlope * height(frame.t - late) * first[v].y();
      for (int m = 0; m < 3; ++m) {
        frame.markers.push_back(
            {m, place_marker(truth[static_cast<std::size_t>(m)], here, Vector3d::Zero()).p +
                    1e-5 * Vector3d(std::sin(7.0 * k + m), std::cos(11.0 * k), std::sin(5.0 * k))});
      }
      seen.frames.push_back(frame);
      PredictedFrame& predicted = prediction.frames.emplace_back();
      predicted.valid = true;
      predicted.tip = seen.p_WC;
      predicted.vertices = surface(made, frame.t);
      const std::vector<Vector3d> next = surface(made, frame.t + 1e-4);
      for (std::size_t v = 0; v < next.size(); ++v)
        predicted.velocity.push_back((next[v] - predicted.vertices[v]) / 1e-4);
      for (int step = -50; step <= 50; ++step) {
        predicted.trajectory.push_back({0.005 * step, std::make_shared<const std::vector<Vector3d>>(
                                                          surface(made, frame.t + 0.005 * step))});
      }
    }
    data = std::make_unique<FitData>(make_fit_data(scene, {seen}, {}));
    for (int k = 0; k < kFrames; ++k) {
      PredictedFrame& predicted = prediction.frames[static_cast<std::size_t>(k)];
      predicted.columns.setZero(3 * 2 * places + 3,
                                data->layout.unknowns.count + kOwnColumns + kHeldColumns);
      for (std::size_t v = 0; v < predicted.vertices.size(); ++v) {
        predicted.columns(3 * static_cast<Eigen::Index>(v) + 2, 0) =
            static_cast<float>(kSlope * height(0.04 * k) * first[v].y());
      }
    }
    linear.predictions.push_back(std::move(prediction));
    set_markers(bind_markers(*data, linear.predictions, warnings), *data);
    linear.at = believed_state(*data);
    data->beliefs.shared_sd.segment<6>(data->layout.registration.begin).setConstant(1e-7);
  }
  static constexpr double kSlope = 20;  // [1/m]

  FitState improved() const {
    return improve(*data, linear, which, 20, {}, {linear.at, first_scales(*data)}).state;
  }
};

TEST(Markers, TheLikelihoodsGradientIsTheDerivativeOfItsCost) {
  Rising c(0.003, 0.1);
  FitData& data = *c.data;
  const Layout& layout = data.layout;
  data.beliefs.shared_sd.setConstant(1e6);
  data.beliefs.own_sd.setConstant(1e6);
  Scales scales = first_scales(data);
  scales.noise.marker = 1e-4;
  scales.noise.along_motion = 1e-7;  // no frame has a time of its own
  FitState state = c.linear.at;
  state.shared.segment<3>(layout.registration.begin + 3) = Vector3d(0.01, -0.02, 0.005);
  const NormalEquations block = compare(data, c.linear, c.which, state, scales.noise, true).front();
  EXPECT_EQ(block.hits, 3U * Rising::kFrames);
  const auto cost = [&](int k, double by) {
    FitState other = state;
    if (k < layout.shared()) {
      other.shared[k] += by;
    } else {
      other.own[0][k - layout.shared()] += by;
    }
    return cost_of(data, c.linear, c.which, other, scales);
  };
  for (int k = 0; k < layout.size(); ++k) {
    if (!(block.A(k, k) > 0)) continue;
    const double step = 1e-3 / std::sqrt(block.A(k, k));
    const double slope = (cost(k, step) - cost(k, -step)) / (2 * step);
    const double scale = std::sqrt(block.A(k, k));
    EXPECT_NEAR(slope / scale, -block.b[k] / scale, 0.02 * (std::fabs(block.b[k] / scale) + 1))
        << "column " << k;
  }
}

TEST(Markers, AreBoundOverTheNearestPointAndThoseFarOffAreNamed) {
  Rising c;
  EXPECT_TRUE(c.warnings.empty());
  for (const MarkerPlace& place : c.data->likelihood.markers()) {
    ASSERT_TRUE(place.on_tissue());
    EXPECT_NEAR(place.offset.z(), 0.005, 1e-3);
  }
  Observation far = c.data->observations[0];
  for (SeenFrame& frame : far.frames) frame.markers[1].p.z() += 0.03;
  const FitData data = make_fit_data(c.scene, {far}, {});
  std::vector<std::string> warnings;
  const auto markers = bind_markers(data, c.linear.predictions, warnings);
  EXPECT_FALSE(markers[1].on_tissue());
  EXPECT_TRUE(markers[2].on_tissue());
  EXPECT_THAT(warnings, testing::ElementsAre(testing::HasSubstr("b (35 mm)")));
}

TEST(Markers, AStatedPlaceOnTheBodyIsTaken) {
  Rising c;
  FitSetup setup;
  setup.markers.by_name["b"].p_B = Vector3d(0.004, 0.011, 0.006);
  const FitData data = make_fit_data(c.scene, c.data->observations, setup);
  const std::vector<MarkerPlace>& markers = data.likelihood.markers();
  ASSERT_TRUE(markers[1].on_tissue());
  EXPECT_NEAR(markers[1].offset.z(), 0.004, 1e-9);
  EXPECT_FALSE(markers[0].on_tissue());
}

TEST(Markers, ALaterClockIsFoundLater) {
  for (const double late : {-0.01, 0.0, 0.015}) {
    Rising c(late);
    const FitState state = c.improved();
    EXPECT_NEAR(state.shared[c.data->layout.clock.begin] + state.own[0][3], late, 2e-4) << late;
    EXPECT_NEAR(state.shared[0], 0, 0.01) << "the stiffness is as it was";
  }
}

TEST(Markers, TellTheStiffnessAndOneThatJumpsDoesNot) {
  Rising c(0, 0.2);
  const auto stiffness = [&] {
    const FitState state = c.improved();
    return state.shared[0] + state.own[0][2];
  };
  const double clean = stiffness();
  EXPECT_NEAR(clean, 0.2, 0.01);
  for (const std::size_t k : {7U, 15U, 22U})
    c.data->observations[0].frames[k].markers[1].p += Vector3d(0.01, 0, 0.02);
  EXPECT_NEAR(stiffness(), clean, 0.01);
}

TEST(Markers, ThatNeverRestHaveTheFloorThatTheFitLeavesBetweenFrames) {
  Rising c;
  const NoiseModel noise = first_scales(*c.data).noise;
  const NormalEquations block =
      compare(*c.data, c.linear, c.which, c.linear.at, noise, false).front();
  Observation seen = c.data->observations[0];
  seen.marker_noise = 0.004;  // their motion, taken for noise
  EXPECT_NEAR(floor_of(seen, block), 1.2e-5, 0.5e-5);
  seen.marker_noise = 1e-6;
  EXPECT_NEAR(floor_of(seen, block), std::sqrt(3) * 1e-6, 1e-12);
}

TEST(Markers, WhatIsLeftAlikeInAllFramesCountsOnce) {
  std::vector<NormalEquations> blocks(1);
  EXPECT_EQ(independent_share(blocks), 1);
  blocks[0].marker_squares = 2;
  blocks[0].marker_products = 1;
  EXPECT_NEAR(independent_share(blocks), 1.0 / 3, 1e-12);
  blocks[0].marker_products = 2;
  EXPECT_NEAR(independent_share(blocks), 0.01, 1e-12);
}

}  // namespace
}  // namespace omentum
