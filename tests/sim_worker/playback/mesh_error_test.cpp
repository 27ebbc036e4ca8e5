#include "sim_worker/playback/mesh_error.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace omentum {
namespace {

using Eigen::Vector3d;

SimulatedRecording recording_at(const Vector3d& point, double force = 0) {
  SimulatedRecording recording;
  recording.time = {0};
  recording.points = {{point}};
  recording.force = {Vector3d(0, 0, force)};
  return recording;
}

/// The coarser meshes that an estimate asks for.
std::vector<pb::ReferenceModel> meshes_of(const pb::ReferenceModel& mesh,
                                          const std::array<int, 3>& cells) {
  std::vector<pb::ReferenceModel> asked;
  std::vector<std::string> warnings;
  const auto run = [&](const pb::ReferenceModel& other) {
    asked.push_back(other);
    return recording_at(Vector3d::Zero());
  };
  EXPECT_TRUE(find_mesh_error(recording_at(Vector3d::Zero()), mesh, cells, run, warnings));
  EXPECT_TRUE(warnings.empty());
  return asked;
}

TEST(MeshError, TheCoarserMeshKeepsTheFewLayersOfASheet) {
  // With fewer of them the estimate was 2.45 of a soft droop's error (docs/decisions/0030).
  const pb::ReferenceModel mesh;
  const pb::ReferenceModel sheet = meshes_of(mesh, {43, 77, 5})[0];
  EXPECT_EQ(sheet.elements_z(), 5U);
  EXPECT_EQ(sheet.elements_y(), 0U) << "from the tolerance";
  EXPECT_GT(sheet.tolerance_m(), mesh.tolerance_m());
  EXPECT_EQ(meshes_of(mesh, {12, 201, 11})[0].elements_z(), 7U) << "a thick body's";
  pb::ReferenceModel stated;
  stated.set_elements_y(24);
  stated.set_elements_z(3);
  EXPECT_EQ(meshes_of(stated, {24, 24, 3})[0].elements_y(), 16U);
  EXPECT_EQ(meshes_of(stated, {24, 24, 3})[0].elements_z(), 2U);
}

TEST(MeshError, WhatTheLayersLeaveIsFoundWithFewer) {
  // By the cells alone the estimate was 0.38 of a droop's error whose layers were too few.
  const pb::ReferenceModel mesh;
  const auto layers_of = [&](int layers) {
    std::vector<int> asked;
    for (const pb::ReferenceModel& other : meshes_of(mesh, {30, 50, layers}))
      asked.push_back(static_cast<int>(other.elements_z()));
    return asked;
  };
  EXPECT_THAT(layers_of(5), testing::ElementsAre(5, 3));
  EXPECT_THAT(layers_of(3), testing::ElementsAre(3, 2));
  EXPECT_THAT(layers_of(2), testing::ElementsAre(2)) << "one layer is no mesh of a bent sheet";
  EXPECT_THAT(layers_of(11), testing::ElementsAre(7)) << "the coarse mesh has fewer already";
}

TEST(MeshError, OfASquareAndACubicErrorIsThatOfTheFineMesh) {
  const double cell = 0.002, in_plane = 7, layer = 0.001, through = 4000;
  const auto with_error = [&](double a, double b) {
    const double by_cells = in_plane * a * a;
    return recording_at(Vector3d(by_cells, through * b * b * b, 0), 1 + by_cells);
  };
  const SimulatedRecording fine = with_error(cell, layer);
  std::vector<std::string> warnings;
  const auto run = [&](const pb::ReferenceModel& mesh) {
    return with_error(1.5 * cell, layer * 3 / mesh.elements_z());
  };
  const auto error = find_mesh_error(fine, {}, {30, 50, 3}, run, warnings);
  ASSERT_TRUE(error);
  const double true_error = fine.points[0][0].norm();
  EXPECT_NEAR(error->rms_m, true_error, 1e-12);
  EXPECT_NEAR(error->worst_rms_m, true_error, 1e-12);
  EXPECT_NEAR(error->force, in_plane * cell * cell / fine.force[0].norm(), 1e-12);
}

TEST(MeshError, OfACoarserMeshThatFailsIsNotGuessed) {
  const SimulatedRecording fine = recording_at(Vector3d::Zero());
  SimulatedRecording failed;
  failed.failure = "t = 0.1 s: no rest";
  const auto fails_with = [&](unsigned layers) {
    return [&failed, layers](const pb::ReferenceModel& mesh) {
      return mesh.elements_z() == layers ? failed : recording_at(Vector3d(1e-4, 0, 0));
    };
  };
  std::vector<std::string> warnings;
  EXPECT_FALSE(find_mesh_error(fine, {}, {30, 50, 3}, fails_with(3), warnings));
  EXPECT_THAT(warnings, testing::ElementsAre(testing::HasSubstr("with larger cells t = 0.1 s")));
  warnings.clear();
  const auto by_cells = find_mesh_error(fine, {}, {30, 50, 3}, fails_with(2), warnings);
  ASSERT_TRUE(by_cells);
  EXPECT_NEAR(by_cells->rms_m, 1e-4 / 1.25, 1e-12);
  EXPECT_THAT(warnings, testing::ElementsAre(testing::HasSubstr("lacks what the layers leave")));
}

}  // namespace
}  // namespace omentum
