// The scenes of the shipped presets to the letter (docs/task.md), and what a configuration is
// refused for.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "core/check.h"
#include "sim_worker/cluster/cluster_tissue.h"
#include "support/preset_task.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::setup_of;

const Clusters& clusters_of(const SimSetup& setup) {
  return dynamic_cast<const ClusterTissueModel&>(*setup.tissue).clusters;
}

TEST(Scene, PaperHas900Particles) {
  const auto setup = setup_of("paper_literal");
  const TissueBody& body = setup->scene.tissue;
  EXPECT_EQ(body.particles.size(), 900U);
  EXPECT_EQ(std::count(body.fixed.begin(), body.fixed.end(), 1), 60);
  EXPECT_NEAR(body.particles.front().x(), -0.0435, 1e-12);
  EXPECT_NEAR(body.particles.back().y(), 0.0435, 1e-12);
  EXPECT_EQ(clusters_of(*setup).attached, 8);
}

TEST(Scene, OmentumHas961ParticlesAndNoOrphans) {
  const auto setup = setup_of("omentum");
  EXPECT_EQ(setup->scene.tissue.particles.size(), 961U);
  EXPECT_EQ(std::count(setup->scene.tissue.fixed.begin(), setup->scene.tissue.fixed.end(), 1), 62);
  EXPECT_TRUE(clusters_of(*setup).orphans.empty());
}

TEST(Scene, DerivedSampling) {
  const auto setup = setup_of("derived");
  const auto& particles = setup->scene.tissue.particles;
  EXPECT_EQ(particles.size(), 2997U);
  Vector3d extent = Vector3d::Zero();
  for (const Vector3d& p : particles) extent = extent.cwiseMax(p.cwiseAbs());
  EXPECT_NEAR(extent.x(), 0.0439, 1e-5);
  EXPECT_NEAR(extent.z(), 0.00079, 1e-5);
}

TEST(Scene, OrphansOfPaperOptimumAreRefusedByNumber) {
  try {
    setup_of("paper_literal", {"scene.tissue.cluster.orphan_policy=ORPHANS_REJECT"});
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("leaves 8 of the particles"));
  }
}

TEST(Units, GravityGuard) {
  EXPECT_THAT(setup_of("paper_literal")->warnings,
              testing::Not(testing::Contains(testing::HasSubstr("gravity"))));
  EXPECT_THAT(setup_of("paper_literal", {"scene.gravity_m_per_s2=0.981"})->warnings,
              testing::Contains(testing::HasSubstr("gravity_m_per_s2: 0.981")));
  const auto derived = setup_of("derived");
  EXPECT_THAT(derived->warnings, testing::Not(testing::Contains(testing::HasSubstr("gravity"))));
  EXPECT_NEAR(derived->scene.gravity.z(), -0.980665, 1e-12);
}

TEST(Units, SpeedGuardWarnsAboveFiftyMillimetresPerSecond) {
  EXPECT_THAT(setup_of("derived")->warnings,
              testing::Contains(testing::HasSubstr("0.1 m/s per axis")));
  EXPECT_THAT(setup_of("paper_literal")->warnings,
              testing::Not(testing::Contains(testing::HasSubstr("m/s per axis"))));
}

TEST(BadInput, EffectsAreRefusedWithTheirPlace) {
  const auto message = [](const auto& make) -> std::string {
    try {
      make();
    } catch (const Error& error) {
      return error.what();
    }
    return "accepted";
  };
  using testing::AllOf;
  using testing::HasSubstr;
  using testing::StartsWith;
  EXPECT_THAT(message([] {
                parse_config("given.txtpb",
                             "scene {\n  tissue {\n    effects { strain_stiffening: 400 }\n  }\n}");
              }),
              AllOf(StartsWith("given.txtpb:3:15: scene.tissue.effects.strain_stiffening: 400"),
                    HasSubstr("allowed -0.5 ... 50")));
  EXPECT_THAT(message([] {
                parse_config("given.txtpb",
                             "scene {\n  tissue {\n    effects { wobble: 1 }\n  }\n}");
              }),
              AllOf(StartsWith("given.txtpb:3:"), HasSubstr("wobble")));
  const auto drawn = [&](const std::string& parameter, const std::string& model) {
    return message([&] {
      setup_of("omentum", {"scene.tissue.model=" + model,
                           "randomise={ parameter: \"" + parameter + "\" min: 0.1 max: 0.4 }"});
    });
  };
  EXPECT_THAT(drawn("tissue.effects.wobble", "TISSUE_ELASTIC"), HasSubstr("wobble"));
  EXPECT_THAT(drawn("tissue.effects.poisson_change", "TISSUE_ELASTIC"), HasSubstr("0.49"));
  EXPECT_THAT(drawn("tissue.effects.strain_stiffening", "TISSUE_CLUSTER"),
              HasSubstr("not possible with TISSUE_CLUSTER"));
  EXPECT_THAT(drawn("tissue.effects.obstacle.radius_m", "TISSUE_ELASTIC"),
              HasSubstr("part of the scene"));
  EXPECT_THAT(drawn("tissue.effects.anchor.compliance_m2_per_n", "TISSUE_ELASTIC"),
              HasSubstr("above 0"));
}

TEST(Obstacle, IsOneMoreBodyOfTheScene) {
  const auto plain = setup_of("omentum", {});
  const auto with = setup_of("omentum", {"scene.tissue.effects.obstacle={ x_m: 0.01 z_m: 0.09 "
                                         "radius_m: 0.008 }"});
  ASSERT_EQ(with->scene.bodies.size(), plain->scene.bodies.size() + 1);
  const RigidShape& body = with->scene.bodies.back();
  EXPECT_EQ(body.role, pb::ROLE_OBSTACLE);
  EXPECT_EQ(body.size.x(), 0.008);
  EXPECT_EQ(body.X_WS.translation().z(), 0.09);
}

TEST(BadInput, OneLineNamesKnobValueAndRange) {
  const auto message = [](const std::string& preset,
                          const std::vector<std::string>& overrides) -> std::string {
    try {
      setup_of(preset, overrides);
    } catch (const Error& error) {
      return error.what();
    }
    return "accepted";
  };
  using testing::HasSubstr;
  EXPECT_THAT(message("omentum", {"task.increment_m=5"}),
              testing::AllOf(HasSubstr("task.increment_m: 5 m"), HasSubstr("0.01")));
  EXPECT_THAT(message("omentum", {"task.increment_m=nan"}), HasSubstr("task.increment_m: nan"));
  EXPECT_THAT(message("omentum", {"task.incremnt_m=0.001"}),
              HasSubstr("no field named \"incremnt_m\""));
  EXPECT_THAT(message("omentum", {"task.increment_m=fast"}),
              HasSubstr("--set task.increment_m=fast"));
  EXPECT_THAT(message("nothing", {}), HasSubstr("allowed: derived, derived_head, omentum"));
  EXPECT_THAT(message("omentum", {"scene.target_m={ x: 3 y: 0 z: 0 }"}),
              HasSubstr("scene.target_m"));
  EXPECT_THAT(message("omentum", {"scene.target_m={ x: 300 y: 0 z: 0 }"}),
              HasSubstr("-100 ... 100"));
  EXPECT_THAT(message("omentum", {"scene.tissue.grid.pitch_m=0.09"}),
              HasSubstr("are the lengths in metres"));
  EXPECT_THAT(message("omentum", {"scene.rigid_body={ mesh { path: \"none.obj\" } }"}),
              HasSubstr("none.obj"));
  EXPECT_THAT(message("omentum", {"scene.tissue.anchor_max_y_m=-1"}), HasSubstr("anchor_max_y_m"));
}

}  // namespace
}  // namespace omentum
