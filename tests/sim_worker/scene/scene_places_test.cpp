// Scenes that cannot be meant: refused where nothing could come of them, else warned of, with the
// range.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "core/check.h"
#include "core/config.h"
#include "sim_worker/backend/sim_setup.h"
#include "support/temp_dir.h"
#include "tests/support/fixtures.h"

namespace omentum {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

class ScenePlaces : public testing::Test {
 protected:
  void load(const std::vector<std::string>& sets) { config_ = load_config("omentum", sets); }
  pb::Scene& scene() { return *config_.mutable_scene(); }
  pb::RigidBody& tumour() { return *scene().mutable_rigid_body(1); }
  void put_tumour(double x, double y, double z) {
    pb::Vec3& place = *tumour().mutable_pose()->mutable_translation_m();
    place.set_x(x);
    place.set_y(y);
    place.set_z(z);
  }
  std::string refusal() const {
    try {
      make_sim_setup(config_);
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  }
  std::vector<std::string> warnings() const { return make_sim_setup(config_)->warnings; }

  pb::Config config_ = load_config("omentum", {});
};

TEST_F(ScenePlaces, EveryPresetIsMeant) {
  for (const std::string& preset : preset_names()) {
    config_ = load_config(preset, {});
    EXPECT_THAT(warnings(), Not(Contains(HasSubstr("allowed")))) << preset;
  }
}

TEST_F(ScenePlaces, WhatATaskAloneNeedsASimulationDoesNot) {
  pb::Scene bare = scene();
  bare.clear_camera();
  bare.clear_workspace_min_m();
  bare.clear_workspace_max_m();
  bare.clear_tool_start_m();
  bare.clear_target_m();
  bare.clear_tumour_point_m();
  bare.clear_start_grid();
  bare.clear_robot_grid();
  const Scene made = make_scene(bare, scene_directory(config_));
  EXPECT_EQ(made.tissue.particles.size(), make_sim_setup(config_)->scene.tissue.particles.size());
  EXPECT_THAT(made.warnings, IsEmpty());
  bare.clear_tissue();
  bare.clear_rigid_body();
  EXPECT_TRUE(make_scene(bare, ".").tissue.particles.empty()) << "an arm alone";

  const std::pair<void (pb::Scene::*)(), const char*> parts[] = {
      {&pb::Scene::clear_camera, "scene.camera: missing"},
      {&pb::Scene::clear_workspace_max_m, "scene.workspace_m"},
      {&pb::Scene::clear_tool_start_m, "scene.tool_start_m: missing"},
      {&pb::Scene::clear_target_m, "scene.target_m: missing"},
      {&pb::Scene::clear_tissue, "scene.tissue: missing"}};
  const pb::Scene whole = scene();
  for (const auto& [clear, said] : parts) {
    scene() = whole;
    (scene().*clear)();
    EXPECT_THAT(refusal(), HasSubstr(said));
  }
}

TEST_F(ScenePlaces, TheShaftPointsWhereTheSceneSays) {
  const auto direction = [&](double x, double y, double z) -> Eigen::Vector3d {
    pb::Vec3& to = *scene().mutable_tool()->mutable_shaft_direction();
    to.set_x(x);
    to.set_y(y);
    to.set_z(z);
    Scene made;
    made.config = scene();
    return scene_tool_mount(made).jaw_direction();
  };
  EXPECT_NEAR((direction(0, 0, -2) - Eigen::Vector3d(0, 0, -1)).norm(), 0, 1e-15);
  EXPECT_NEAR((direction(0.3, -0.4, -1.2) - Eigen::Vector3d(0.3, -0.4, -1.2) / 1.3).norm(), 0,
              1e-15);
  EXPECT_THROW(direction(0, 0, 1), Error);
  EXPECT_THROW(direction(0, 0, 0), Error);
}

TEST_F(ScenePlaces, ATumourThatNothingCanExposeIsRefused) {
  const std::string place = "scene.rigid_body[1].pose: ";
  put_tumour(36, 0.0361, 0.0192);
  EXPECT_THAT(refusal(), HasSubstr(place + "the tumour is 36 m from the tissue at rest, allowed"));
  put_tumour(0.0109, 0.0361, -0.0192);  // under the board
  EXPECT_THAT(refusal(), HasSubstr(place + "all of the tumour lies inside or behind"));
  put_tumour(0.014, -0.026, 0.0285);  // inside the kidney
  EXPECT_THAT(refusal(), HasSubstr(place + "all of the tumour lies inside or behind"));
  put_tumour(0.0109, 0.0361, 0.0192);
  EXPECT_EQ(refusal(), "");
  scene().mutable_camera()->mutable_axis()->set_y(0.7544);
  EXPECT_THAT(refusal(), HasSubstr(place + "all of the tumour is behind the camera"));
}

TEST_F(ScenePlaces, ATumourInsideAMeshIsRefused) {
  scene().clear_rigid_body();
  pb::RigidBody& organ = *scene().add_rigid_body();
  organ.set_name("organ");
  organ.mutable_mesh()->set_path(std::string(OMENTUM_TESTS_DIR) + "/fixtures/organ.stl");
  organ.mutable_mesh()->set_unit_m(0.001);
  pb::RigidBody& inside = *scene().add_rigid_body();
  inside.set_role(pb::ROLE_TUMOUR);
  inside.set_sphere_radius_m(0.002);
  const TriangleMesh mesh = load_closed_mesh(organ.mesh().path(), 0.001);
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& v : mesh.vertices)
    middle += v / static_cast<double>(mesh.vertices.size());
  ASSERT_GT(winding_number(mesh, middle), 0.5);
  for (pb::RigidBody* body : {&organ, &inside}) {  // below the start of the tool
    const Eigen::Vector3d p = Eigen::Vector3d(-0.0172, 0.0536, 0.03) -
                              (body == &organ ? middle : Eigen::Vector3d::Zero());
    body->mutable_pose()->mutable_translation_m()->set_x(p.x());
    body->mutable_pose()->mutable_translation_m()->set_y(p.y());
    body->mutable_pose()->mutable_translation_m()->set_z(p.z());
  }
  EXPECT_THAT(refusal(), HasSubstr("all of the tumour lies inside or behind"));
}

TEST_F(ScenePlaces, AnOddTumourIsToldWithTheRange) {
  put_tumour(0.055, 0.0361, 0.0192);
  EXPECT_THAT(warnings(), Contains(HasSubstr("the tumour lies beside the tissue at rest, x 0.04131 "
                                             "... 0.06869 m, allowed where it meets the tissue, "
                                             "-0.06391 ... 0.02951 m")));
  put_tumour(0.1, 0.0361, 0.0192);
  EXPECT_THAT(warnings(), Contains(HasSubstr("the tumour lies outside the workspace, x")));
  tumour().set_role(pb::ROLE_ORGAN);
  EXPECT_THAT(warnings(), Contains(HasSubstr("scene.rigid_body: 0 tumours (ROLE_TUMOUR)")));
}

TEST_F(ScenePlaces, PointsOfTheTaskLieInTheWorkspaceAndOutsideBodies) {
  scene().mutable_tumour_point_m()->set_z(50);
  EXPECT_THAT(refusal(), HasSubstr("scene.tumour_point_m: coordinate z is 50 m, allowed 0.001"));
  scene().mutable_tumour_point_m()->set_z(0.09);
  EXPECT_THAT(warnings(), Contains(HasSubstr("scene.tumour_point_m: 0.0")));
  scene().clear_tumour_point_m();
  EXPECT_THAT(refusal(), HasSubstr("scene.tumour_point_m: missing"));
  load({"scene.tool_start_m={ x: 0.014 y: -0.026 z: 0.0285 }"});
  EXPECT_THAT(warnings(), Contains(HasSubstr("scene.tool_start_m: 1 of 1 places lie inside a body "
                                             "(\"kidney\"), allowed outside every body")));
  load({"scene.start_grid.centre_m={ x: 0.005 y: 0.04 z: 0.05 }"});
  EXPECT_THAT(warnings(), Contains(HasSubstr("places lie inside a body (\"kidney\")")));
  load(
      {"scene.start_grid={ rows: 2 columns: 2 centre_m { x: 0.014 y: -0.026 z: 0.0285 } "
       "row_pitch_m: 0.001 column_pitch_m: 0.001 }"});
  EXPECT_THAT(refusal(), HasSubstr("scene.start_grid: 4 of 4 places lie inside a body"));
  config_ = load_config("omentum", {});
  scene().clear_start_grid();
  EXPECT_THAT(warnings(), Contains(HasSubstr("scene.start_grid: missing")));
}

TEST_F(ScenePlaces, TissueAndCameraAreWhereTheTaskIs) {
  pb::Vec3& place = *scene().mutable_tissue()->mutable_pose()->mutable_translation_m();
  place.set_z(-0.074);
  EXPECT_THAT(refusal(), HasSubstr("961 of 961 particles lie inside the body \"board\""));
  place.set_z(3);
  EXPECT_THAT(refusal(), HasSubstr("scene.tissue.pose: the tissue at rest is 2.8"));
  load({"scene.camera.position_m={ x: 0.014 y: -0.026 z: 0.0285 }"});
  EXPECT_THAT(refusal(), HasSubstr("scene.camera.position_m: "));
  load({"scene.camera.far_m=0.1"});
  EXPECT_THAT(warnings(), Contains(HasSubstr("allowed 0.03 ... 0.1 m (near_m ... far_m)")));
  load({"scene.camera.axis={ x: 0.8 y: -0.3 z: -0.3 }"});
  EXPECT_THAT(warnings(), Contains(HasSubstr("scene.camera.axis: the picture shows nothing of")));
}

TEST(SceneDirectory, MeshesStartBesideTheSceneFile) {
  const test::TempDir folder;
  const std::string fixtures = std::string(OMENTUM_TESTS_DIR) + "/fixtures/";
  std::filesystem::copy(fixtures + "organ.stl", folder / "beside.stl");
  pb::Config config = load_config("omentum", {});
  config.set_scene_file(folder / "scene.txtpb");
  EXPECT_EQ(scene_directory(config), folder.path());
  pb::RigidBody& organ = *config.mutable_scene()->add_rigid_body();
  organ.mutable_mesh()->set_path("beside.stl");
  organ.mutable_mesh()->set_unit_m(0.0005);
  organ.mutable_pose()->mutable_translation_m()->set_x(-0.05);
  EXPECT_EQ(make_sim_setup(config)->scene.bodies.size(), 4u);
  config.clear_scene_file();
  EXPECT_EQ(scene_directory(config), deploy_dir() + "/scenes");
  EXPECT_THROW(make_sim_setup(config), Error);
}

TEST(SceneMesh, InsideOutIsRefused) {
  const std::string path = testing::TempDir() + "/inside_out.obj";
  TriangleMesh box = make_box_mesh({0.01, 0.01, 0.01});
  std::string text;
  for (const Eigen::Vector3d& v : box.vertices)
    text += fmt::format("v {} {} {}\n", v.x(), v.y(), v.z());
  for (const Eigen::Vector3i& t : box.triangles)
    text += fmt::format("f {} {} {}\n", t[0] + 1, t[2] + 1, t[1] + 1);
  test::write_bytes(path, text);
  pb::Config config = load_config("omentum", {});
  pb::RigidBody& body = *config.mutable_scene()->add_rigid_body();
  body.mutable_mesh()->set_path(path);
  body.mutable_pose()->mutable_translation_m()->set_x(-0.07);
  EXPECT_THROW(
      {
        try {
          make_sim_setup(config);
        } catch (const Error& error) {
          EXPECT_EQ(std::string(error.what()),
                    path +
                        ": the mesh is inside out, volume -8e-06 m^3, allowed faces that look "
                        "outside");
          throw;
        }
      },
      Error);
}

}  // namespace
}  // namespace omentum
