// Any closed mesh may be tissue, organ, obstacle or tumour: the fixtures in each role.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "core/config.h"
#include "core/hash.h"
#include "sim_worker/backend/sim_backend.h"
#include "tests/support/fixtures.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

const std::string kFixtures = std::string(OMENTUM_TESTS_DIR) + "/fixtures/";

/// Preset omentum without its rigid bodies.
pb::Config bare_config() {
  pb::Config config = load_config("omentum", {});
  config.mutable_scene()->clear_rigid_body();
  return config;
}

void add_organ(pb::Config& config, pb::BodyRole role, double unit, const Vector3d& p) {
  pb::RigidBody& body = *config.mutable_scene()->add_rigid_body();
  body.set_name("mesh");
  body.set_role(role);
  body.mutable_mesh()->set_path(kFixtures + "organ.stl");
  body.mutable_mesh()->set_unit_m(unit);
  pb::Vec3& place = *body.mutable_pose()->mutable_translation_m();
  place.set_x(p.x());
  place.set_y(p.y());
  place.set_z(p.z());
}

std::shared_ptr<const SimSetup> setup_of(const pb::Config& config) {
  return make_sim_setup(config, deploy_dir() + "/scenes");
}

/// A parameter that every episode draws.
void draw(pb::Config& config, const char* parameter, double min, double max) {
  pb::Randomise& drawn = *config.add_randomise();
  drawn.set_parameter(parameter);
  drawn.set_min(min);
  drawn.set_max(max);
}

/// Why a configuration is refused.
std::string message(const pb::Config& config) {
  try {
    setup_of(config);
  } catch (const Error& error) {
    return error.what();
  }
  return "accepted";
}

/// Steps the scene with the tool at rest above; `visit` gets the free particles after every step.
template <typename Visit>
void fall(const std::shared_ptr<const SimSetup>& setup, int steps, Visit&& visit) {
  SimBackend backend(setup, 1, 1);
  EpisodeStart start;
  start.start_set = StartSet::kGrid;
  start.episode_limit = 1U << 30;
  backend.reset(0, start);
  std::vector<Action> actions(1);
  actions[0].branch = {1, 1, 1, 0};
  std::vector<StepOutcome> outcomes(1);
  std::vector<Vector3d> positions;
  for (int step = 0; step < steps; ++step) {
    backend.step(actions, outcomes);
    positions.clear();
    for (int i = 0; i < backend.tissue_of(0).particles(); ++i) {
      if (setup->scene.tissue.fixed[static_cast<std::size_t>(i)] == 0) {
        positions.push_back(backend.tissue_of(0).position(0, i));
      }
    }
    visit(positions);
  }
  EXPECT_TRUE(backend.healthy(0));
}

/// Most particles that are inside the organ at once while the sheet falls past it.
std::ptrdiff_t most_inside(const pb::Config& config, const TriangleMesh& organ,
                           const Vector3d& place) {
  std::ptrdiff_t most = 0;
  fall(setup_of(config), 60, [&](std::vector<Vector3d> positions) {
    for (Vector3d& p : positions) p -= place;
    const std::vector<bool> inside = points_inside(organ, positions);
    most = std::max(most, std::count(inside.begin(), inside.end(), true));
  });
  return most;
}

TEST(MeshScene, AFatPadIsTissue) {
  pb::Config config = bare_config();
  pb::Tissue& tissue = *config.mutable_scene()->mutable_tissue();
  pb::VolumeMaker& volume = *tissue.mutable_volume();
  volume.mutable_mesh()->set_path(kFixtures + "fat_pad.obj");
  volume.mutable_mesh()->set_unit_m(0.001);
  volume.set_particle_spacing_m(0.004);
  volume.set_volume_sampling(4);
  tissue.set_anchor_max_y_m(-0.028);
  const auto setup = setup_of(config);
  const TissueBody& body = setup->scene.tissue;
  const TriangleMesh pad = load_closed_mesh(kFixtures + "fat_pad.obj", 0.001);
  EXPECT_GT(body.particles.size(), 100u);
  EXPECT_LT(body.particles.size(), 1500u);
  for (const Vector3d& p : body.particles) {
    // Merged voxel centres: within a voxel of 1 mm of the inside.
    EXPECT_GT(winding_number(pad, p - 0.001 * (p - Vector3d(0.012, -0.007, 0.003)).normalized()),
              0.5)
        << p.transpose();
  }
  const double mass = body.particle_mass * static_cast<double>(body.particles.size());
  EXPECT_NEAR(mass, 1000 * signed_volume(pad), 1e-9 * mass);  // density x volume
  EXPECT_EQ(body.surface_vertices.size(), pad.vertices.size());
  // It sags on its anchor, stays finite and in one piece.
  fall(setup, 100, [&](const std::vector<Vector3d>& positions) {
    for (const Vector3d& p : positions) {
      ASSERT_TRUE(p.allFinite());
      EXPECT_LT((p - body.X_WB * Vector3d(0.012, -0.007, 0.003)).norm(), 0.15);
    }
  });
}

/// The pad as an elastic solid that hangs on its rear end over an organ.
pb::Config elastic_pad() {
  pb::Config config = bare_config();
  pb::Tissue& tissue = *config.mutable_scene()->mutable_tissue();
  tissue.set_model(pb::TISSUE_ELASTIC);
  tissue.mutable_material()->set_law(pb::LAW_STABLE_NEO_HOOKE);
  tissue.mutable_material()->set_young_modulus_pa(5000);
  tissue.mutable_volume()->mutable_mesh()->set_path(kFixtures + "fat_pad.obj");
  tissue.mutable_volume()->mutable_mesh()->set_unit_m(0.001);
  tissue.mutable_volume()->set_edge_length_m(0.012);
  tissue.set_anchor_max_y_m(-0.028);
  return config;
}

TEST(MeshScene, AFatPadIsAnElasticSolid) {
  pb::Config config = elastic_pad();
  add_organ(config, pb::ROLE_ORGAN, 0.0005, {-0.0172, 0.045, 0.005});
  const auto setup = setup_of(config);
  const TissueBody& body = setup->scene.tissue;
  const TriangleMesh pad = load_closed_mesh(kFixtures + "fat_pad.obj", 0.001);
  const double mass = body.particle_mass * static_cast<double>(body.particles.size());
  EXPECT_NEAR(mass, 1000 * signed_volume(pad), 1e-9 * mass);
  EXPECT_EQ(setup->scene.solid.nodes.size(), body.particles.size());
  fall(setup, 25, [&](const std::vector<Vector3d>& positions) {
    for (const Vector3d& p : positions) {
      ASSERT_TRUE(p.allFinite());
      EXPECT_LT((p - body.X_WB * Vector3d(0.012, -0.007, 0.003)).norm(), 0.1);
    }
  });
}

TEST(MeshScene, AnElasticSolidThatDoesNotFitIsRefusedInOneLine) {
  pb::Config config = elastic_pad();
  config.mutable_scene()->mutable_tissue()->mutable_material()->set_law(pb::LAW_COROTATED);
  EXPECT_THAT(message(config), testing::HasSubstr("LAW_STABLE_NEO_HOOKE"));
  config = elastic_pad();
  config.mutable_scene()->mutable_tissue()->set_model(pb::TISSUE_REFERENCE);
  EXPECT_THAT(message(config), testing::HasSubstr("give grid"));
  config = elastic_pad();
  config.mutable_scene()->mutable_tissue()->set_anchor_max_y_m(-1);
  EXPECT_THAT(message(config), testing::HasSubstr("anchor_max_y_m"));
  config = elastic_pad();
  config.mutable_scene()->mutable_tissue()->mutable_effects()->set_bending_change(1);
  EXPECT_THAT(message(config), testing::HasSubstr("bending_change"));
  config = elastic_pad();
  draw(config, "tissue.effects.thickness.x_per_m", 0, 1);
  EXPECT_THAT(message(config), testing::HasSubstr("thickness"));
}

TEST(MeshScene, EffectsOfAnElasticSolidAreDrawnPerSlotAndEpisode) {
  pb::Config config = elastic_pad();
  config.mutable_scene()
      ->mutable_tissue()
      ->mutable_effects()
      ->mutable_anchor()
      ->set_compliance_m2_per_n(1e-4);
  draw(config, "tissue.effects.inclusion.stiffness_change", 0, 3);
  draw(config, "tissue.effects.viscoelastic[0].share", 0.1, 0.5);
  draw(config, "tissue.effects.anchor.compliance_m2_per_n", 5e-5, 2e-4);
  const auto setup = setup_of(config);
  SimBackend alone(setup, 1, 1);
  SimBackend batch(setup, 8, 8);
  std::vector<Action> actions(8);
  for (Action& action : actions) action.branch = {1, 1, 1, 0};
  std::vector<StepOutcome> outcomes(8);
  std::set<std::uint64_t> seen;
  for (std::uint64_t episode = 0; episode < 3; ++episode) {
    EpisodeStart start;
    start.run_seed = 9;
    start.slot = 3;
    start.episode = episode;
    alone.reset(0, start);
    batch.reset(5, start);
    alone.step(std::span(actions).first(1), std::span(outcomes).first(1));
    batch.step(actions, outcomes);
    const Bytes state = alone.save(0);
    EXPECT_EQ(state, batch.save(5)) << episode;
    EXPECT_TRUE(batch.load(2, state)) << episode;
    EXPECT_EQ(state, batch.save(2)) << episode;
    seen.insert(fnv1a64(state));
  }
  EXPECT_EQ(seen.size(), 3U);
}

/// The leaf as an elastic sheet that hangs on its rear end.
pb::Config elastic_leaf() {
  pb::Config config = bare_config();
  pb::Tissue& tissue = *config.mutable_scene()->mutable_tissue();
  tissue.set_model(pb::TISSUE_ELASTIC);
  tissue.mutable_material()->set_young_modulus_pa(30000);
  tissue.mutable_sheet()->mutable_mesh()->set_path(kFixtures + "leaf.obj");
  tissue.mutable_sheet()->mutable_mesh()->set_unit_m(0.001);
  tissue.set_anchor_max_y_m(-0.028);
  return config;
}

TEST(MeshScene, ALeafIsAnElasticSheet) {
  pb::Config config = elastic_leaf();
  pb::ThicknessMap& map = *config.mutable_scene()->mutable_tissue()->mutable_thickness_map();
  for (const double ratio : {0.8, 1.2, 1.0, 1.0}) map.add_ratio(ratio);
  add_organ(config, pb::ROLE_ORGAN, 0.0005, {-0.0172, 0.045, 0.005});
  const auto setup = setup_of(config);
  const TissueBody& body = setup->scene.tissue;
  double area = 0;
  for (const double a : setup->scene.sheet.node_area) area += a;
  EXPECT_NEAR(area / (1e-6 * 3.14159 * (42 * 35 - 36)), 0.9, 0.05);  // a ragged rim inside the oval
  EXPECT_NEAR(body.particle_mass * static_cast<double>(body.particles.size()),
              1000 * config.scene().tissue().thickness_m() * area, 1e-9);
  fall(setup, 25, [&](const std::vector<Vector3d>& positions) {
    for (const Vector3d& p : positions) {
      ASSERT_TRUE(p.allFinite());
      EXPECT_LT((p - body.X_WB * Vector3d(0.005, -0.003, 0)).norm(), 0.1);
    }
  });
}

TEST(MeshScene, ASheetThatDoesNotFitIsRefusedInOneLine) {
  const auto with_mesh = [&](const std::string& obj) {
    const std::string path = testing::TempDir() + "/bad_sheet.obj";
    test::write_bytes(path, obj);
    pb::Config config = elastic_leaf();
    config.mutable_scene()->mutable_tissue()->mutable_sheet()->mutable_mesh()->set_path(path);
    config.mutable_scene()->mutable_tissue()->mutable_sheet()->mutable_mesh()->set_unit_m(1);
    return message(config);
  };
  EXPECT_EQ(message(elastic_leaf()), "accepted");
  EXPECT_THAT(with_mesh("v 0 0 0\nv .05 0 0\nv .05 .05 0\nv 0 .05 0\nf 1 2 3\nf 1 3 4\n"),
              testing::HasSubstr("do not determine a curvature"));
  EXPECT_THAT(with_mesh("v 0 0 0\nv .05 0 0\nv .05 .05 0\nv 0 .05 0\nf 1 2 3\nf 1 4 3\n"),
              testing::HasSubstr("used twice in the same direction"));
  // A strip that lies on itself, with vertices of its own and with shared ones.
  const std::string strip = "v 0 0 0\nv .05 0 0\nv 0 .05 0\nv .05 .05 0\n";
  EXPECT_THAT(with_mesh(strip + "v 0 .001 0\nv .05 .001 0\nf 1 2 4\nf 1 4 3\nf 3 4 6\nf 3 6 5\n"),
              testing::HasSubstr("folded by more than 90 deg along the edge from"));
  EXPECT_THAT(with_mesh(strip + "f 1 2 4\nf 1 4 3\nf 3 4 2\nf 3 2 1\nf 1 2 4\n"),
              testing::HasSubstr("folded onto itself or given twice"));
  EXPECT_THAT(with_mesh("v 0 0 0\nv .05 0 0\nv .02 .0001 0\nf 1 2 3\n"),
              testing::HasSubstr("sliver"));
  EXPECT_THAT(
      with_mesh("v 0 0 0\nv .05 0 0\nv 0 .05 0\nv .2 0 0\nv .3 0 0\nv .2 .1 0\nf 1 2 3\nf 4 5 6\n"),
      testing::HasSubstr("allowed one piece"));
  EXPECT_THAT(
      with_mesh("v 0 0 0\nv .05 0 0\nv 0 .05 0\nv -.05 0 0\nv 0 -.05 0\nf 1 2 3\nf 1 4 5\n"),
      testing::HasSubstr("single vertex"));
  pb::Config config = elastic_leaf();
  pb::Tissue& tissue = *config.mutable_scene()->mutable_tissue();
  tissue.set_model(pb::TISSUE_REFERENCE);
  EXPECT_THAT(message(config), testing::HasSubstr("give grid"));
  tissue.set_model(pb::TISSUE_ELASTIC);
  tissue.mutable_thickness_map()->add_ratio(1);
  EXPECT_THAT(message(config), testing::HasSubstr("count_x count_y = 4"));
  for (const double ratio : {1.0, 1.0, 0.0}) tissue.mutable_thickness_map()->add_ratio(ratio);
  EXPECT_THAT(message(config), testing::HasSubstr("ratio[3]: 0, allowed 0.2 ... 5"));
  tissue.mutable_thickness_map()->set_ratio(3, 1);
  EXPECT_EQ(message(config), "accepted");
  tissue.set_model(pb::TISSUE_CLUSTER);
  EXPECT_THAT(message(config), testing::HasSubstr("thickness_map"));
}

class SolidRole : public testing::TestWithParam<pb::BodyRole> {};

TEST_P(SolidRole, ParticlesStayOutOfTheMesh) {
  const TriangleMesh organ = load_closed_mesh(kFixtures + "organ.stl", 0.0005);
  // Under the middle of the sheet, which falls onto it.
  const Vector3d place(-0.0172, 0.045, 0.005);
  pb::Config config = bare_config();
  EXPECT_GT(most_inside(config, organ, place), 10) << "the sheet would not meet the organ";
  add_organ(config, GetParam(), 0.0005, place);
  EXPECT_EQ(most_inside(config, organ, place), 0);
}

INSTANTIATE_TEST_SUITE_P(MeshScene, SolidRole,
                         testing::Values(pb::ROLE_ORGAN, pb::ROLE_OBSTACLE, pb::ROLE_TUMOUR),
                         [](const auto& role) { return pb::BodyRole_Name(role.param); });

TEST(MeshScene, ATumourMeshGivesExposureSamples) {
  pb::Config config = bare_config();
  add_organ(config, pb::ROLE_TUMOUR, 0.00025, {0.0109, 0.0361, 0.0192});
  const auto setup = setup_of(config);
  const ExposureEstimator& exposure = *setup->exposure;
  EXPECT_GE(exposure.full_samples().size(), 10'000);
  EXPECT_EQ(exposure.subset_samples().size(), 256);
  std::vector<float> sheet;
  for (const Vector3d& p : setup->scene.tissue.particles) {
    for (const double value : Vector3d(setup->scene.tissue.X_WB * p)) {
      sheet.push_back(static_cast<float>(value));
    }
  }
  EXPECT_LT(exposure.full(sheet), 0.2);                                // under the sheet
  for (std::size_t i = 2; i < sheet.size(); i += 3) sheet[i] += 0.5F;  // behind the camera
  EXPECT_EQ(exposure.full(sheet), 1);
  EXPECT_EQ(exposure.subset(sheet), 1);
}

}  // namespace
}  // namespace omentum
