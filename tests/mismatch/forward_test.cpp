// Simulations of a calibration: their mesh, their law, what the jaws hold.
#include "mismatch/fit/forward.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <vector>

#include "core/config.h"
#include "mismatch/calibrate/law_choice.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

Observation lifted(const Scene& scene, double x) {
  Observation seen;
  seen.track.time = {0, 0.1, 0.2};
  seen.track.p_WT.assign(3, scene.tissue.X_WB * Eigen::Vector3d(x, 0.03, 0));
  seen.track.jaw_rad = {1, 0, 0};
  seen.grasp.patch_radius_m = 0.005;
  return seen;
}

TEST(PinchesOf, ADisplacedPadTakesItsGridLinesAlongAndADiscDoesNot) {
  pb::Scene config = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  config.mutable_tissue()->mutable_effects()->mutable_grasp_offset()->set_x_m(0.003);
  for (const bool pad : {false, true}) {
    if (pad) config.mutable_tool()->mutable_grip()->set_hold(pb::HOLD_PAD);
    const Scene scene = make_scene(config, {});
    const Observation seen = lifted(scene, 0.01);
    const std::vector<PinchCircle> pinches = pinches_of(seen.track, scene, seen.grasp);
    ASSERT_EQ(pinches.size(), 1U);
    EXPECT_NEAR(pinches[0].centre.x(), pad ? 0.013 : 0.01, 1e-12);
    EXPECT_NEAR(pinches[0].displaced.x(), pad ? 0.003 : 0, 1e-12);
  }
}

TEST(CountElements, AllStatesOfAFitHaveOneMesh) {
  pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  const Scene made = make_scene(scene, {});
  const std::vector<Observation> seen = {lifted(made, -0.03), lifted(made, 0.01)};
  const auto elements = count_elements(scene, {}, seen, 3e-4);
  for (const int count : elements) EXPECT_GT(count, 0);
  const auto fewer = fewer_elements(elements, 1.5);
  EXPECT_NEAR(fewer[0], elements[0] / 1.5, 0.5);
  EXPECT_EQ(fewer_elements({1, 1, 1}, 1.5), (std::array<int, 3>{1, 1, 1}));
  // The mesh of a tolerance follows thickness and law; that of a state does not.
  for (const double thickness : {0.0024, 0.003, 0.0036}) {
    for (const pb::ElasticLaw law : kLaws) {
      scene.mutable_tissue()->set_thickness_m(thickness);
      scene.mutable_tissue()->mutable_material()->set_law(law);
      for (const Observation& observation : seen) {
        const SimulationTask task =
            make_calibration_task(observation, scene, {}, {pb::TISSUE_REFERENCE, elements, 1});
        const pb::ReferenceModel& mesh = task.scene.tissue().reference();
        EXPECT_EQ(static_cast<int>(mesh.elements_x()), elements[0]);
        EXPECT_EQ(static_cast<int>(mesh.elements_y()), elements[1]);
        EXPECT_EQ(static_cast<int>(mesh.elements_z()), elements[2]);
      }
    }
  }
}

// Every start of a search once failed without a word: the shell did not have the law believed.
TEST(MakeCalibrationTask, TheShellOfASearchMovesByTheLawBelieved) {
  pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  const Observation seen = lifted(make_scene(scene, {}), 0.01);
  for (const pb::ElasticLaw law : kLaws) {
    scene.mutable_tissue()->mutable_material()->set_law(law);
    const SimulationTask task = make_calibration_task(seen, scene, {}, {pb::TISSUE_ELASTIC});
    EXPECT_EQ(task.scene.tissue().material().law(), law);
    const Simulation made = simulate(task);
    EXPECT_EQ(made.recording.failure, "") << law;
    EXPECT_GT(made.recording.points.size(), 1U) << law;
  }
}

// A sheet over an organ, which lies below where the jaws close: of another stiffness it lay there.
TEST(Predict, TissueBesideTheJawsIsHeldAllTheSame) {
  const pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum_elastic.txtpb", {});
  Observation seen = lifted(make_scene(scene, {}), 0.01);
  seen.pinched = true;
  seen.track.time.push_back(0.6);
  seen.track.p_WT.push_back(seen.track.p_WT.back() + Vector3d(0, 0, 0.01));
  seen.track.jaw_rad.push_back(0);
  for (const double t : {0.04, 0.58}) seen.frames.emplace_back().t = t;
  const Numerics shell{pb::TISSUE_ELASTIC};
  ASSERT_EQ(simulate(make_calibration_task(seen, scene, {}, shell)).recording.missed_grasps, 1);
  Simulator here(1);
  const Prediction made = predict(seen, scene, {}, {}, {}, 0, shell, false, here);
  double most = 0;
  for (std::size_t i = 0; i < made.frames[0].vertices.size(); ++i) {
    const Vector3d way = made.frames[1].vertices[i] - made.frames[0].vertices[i];
    most = std::max(most, way.z());
  }
  EXPECT_NEAR(most, 0.01, 0.002);
}

}  // namespace
}  // namespace omentum
