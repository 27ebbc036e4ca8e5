// Meshes in place of our shapes, through the real programs: a fat pad that is neither flat nor
// square nor centred as tissue, and an organ from an STL file as obstacle, 100,000 steps.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::metric;
using test::operator+;
using test::Process;
using test::Programs;
using test::Strings;

const std::string kFixtures = std::string(OMENTUM_TESTS_DIR) + "/fixtures/";

TEST(MeshScene, TrainsAHundredThousandStepsOnAFatPadBesideAnStlOrgan) {
  Programs programs;
  const Strings sets = {
      R"(scene.tissue.volume={ mesh { path: ")" + kFixtures +
          R"(fat_pad.obj" unit_m: 0.001 } particle_spacing_m: 0.004 })",
      "scene.tissue.anchor_max_y_m=-0.028",
      // Beside tumour and kidney, half in the board, within reach of the pad's rim.
      R"(scene.rigid_body={ name: "spleen" role: ROLE_OBSTACLE mesh { path: ")" + kFixtures +
          R"(organ.stl" unit_m: 0.0005 } pose { translation_m { x: -0.05 y: 0.03 z: 0.01 } } })",
      // Low starts above the pad, so that the jaws meet it early.
      "scene.start_grid.centre_m={ x: -0.0052 y: 0.0466 z: 0.06 }",
      "scene.start_grid.row_pitch_m=0.004", "scene.start_grid.column_pitch_m=0.006",
      "rollout.max_steps=100000", "rollout.slots=32", "rollout.steps_per_segment=160",
      "task.episode_steps=300", "ppo.hidden=32", "ppo.epochs=2", "evaluation.lattice_stride=10",
      "scene.start_grid.rows=3", "scene.start_grid.columns=3", "scene.robot_grid.rows=1",
      "scene.robot_grid.columns=1", "task.hold_s=0.2"};
  Process one = programs.worker("mesh");
  Process two = programs.worker("mesh");
  Process learner = programs.learner("mesh", sets);
  ASSERT_EQ(learner.wait(std::chrono::seconds(800)), 0) << test::read_text(programs.err("mesh"));
  EXPECT_EQ(one.wait(std::chrono::seconds(20)), 0);
  EXPECT_EQ(two.wait(std::chrono::seconds(20)), 0);

  const std::string err = test::read_text(programs.err("mesh"));
  // The learner checks the balance of its ledger after every update and would have aborted.
  for (const std::string part :
       {"invalid=0", "overflow=0", "foreign=0", "outstanding=0", "failed=0", "audit_mismatch=0"}) {
    EXPECT_NE(err.find(part), std::string::npos) << part << "\n" << err;
  }
  const std::string csv = test::read_text(programs.run_dir("mesh") + "/metrics.csv");
  const std::vector<double> exposure = metric(csv, "charts/exposure_fraction");
  ASSERT_GE(exposure.size(), 19u);
  for (const double value : exposure) {
    EXPECT_TRUE(std::isfinite(value));
    EXPECT_GE(value, 0);
    EXPECT_LE(value, 1);
  }
  const std::string summary = programs.summary("mesh");
  EXPECT_GE(std::stod(Programs::value(summary, "steps")), 100000);
  EXPECT_TRUE(std::isfinite(std::stod(Programs::value(summary, "mean_return"))));
  EXPECT_EQ(std::stod(Programs::value(summary, "failed")), 0);
  // Tissue was grasped, in training and on the lattice.
  const std::string lattice =
      test::read_text(programs.run_dir("mesh") + "/evaluation/grasp_lattice.csv");
  EXPECT_GT(test::lines_of(lattice).size(), 20u);
  const std::vector<double> reached = metric(lattice, "reached");
  EXPECT_GT(std::count(reached.begin(), reached.end(), 1.0), 0);
  for (const double value : metric(lattice, "exposure")) {
    EXPECT_GE(value, 0);
    EXPECT_LE(value, 1);
  }
  EXPECT_EQ(programs
                .finish(Strings{OMENTUM_SIM_WORKER, "--replay",
                                programs.run_dir("mesh") + "/recordings/grid9_greedy_0.mcap"})
                .code,
            0);
}

}  // namespace
}  // namespace omentum
