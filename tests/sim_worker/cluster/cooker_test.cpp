#include "sim_worker/cluster/cooker.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "core/check.h"
#include "core/hash.h"
#include "sim_worker/scene/particles.h"

namespace omentum {
namespace {

/// FNV-1a 64 over size and ascending members of each cluster in order, as little-endian u32.
std::uint64_t hash_of(const Clusters& clusters) {
  std::uint64_t hash = kFnvOffset;
  const auto add = [&hash](std::uint32_t word) {
    hash = fnv1a64(std::as_bytes(std::span(&word, 1)), hash);
  };
  for (int c = 0; c < clusters.count(); ++c) {
    add(clusters.size(c));
    for (const int i : clusters.members(c)) add(i);
  }
  return hash;
}

using Eigen::Vector3d;

pb::ClusterModel make_model(double spacing_mm, double radius_mm,
                            pb::OrphanPolicy policy = pb::ORPHANS_FREE) {
  pb::ClusterModel model;
  model.set_cluster_spacing_m(spacing_mm * 1e-3);
  model.set_cluster_radius_m(radius_mm * 1e-3);
  model.set_orphan_policy(policy);
  return model;
}

std::vector<Vector3d> make_layer(unsigned n) {
  pb::GridMaker grid;
  grid.set_count_x(n);
  grid.set_count_y(n);
  return make_grid_particles(grid);
}

struct Vector {
  double spacing_mm, radius_mm;
  int clusters, memberships, min_size, max_size;
  std::size_t orphans;
  std::uint64_t hash;
};

TEST(Cooker, ConformanceVectors) {  // docs/tissue.md 3.3
  const auto layer = make_layer(30);
  const Vector vectors[] = {
      {12.7, 9.5, 51, 1677, 24, 37, 8, 0x1c3ababc8dbad82bULL},
      {9.5, 12.7, 80, 4145, 33, 57, 0, 0x99845624723e9e84ULL},
      {12.7, 12.7, 51, 2629, 35, 57, 1, 0xe1856cd12f1807c2ULL},
      {12.7, 16, 51, 3983, 46, 89, 0, 0x35be792d906cbef1ULL},
      {6.01, 6.01, 158, 1893, 9, 13, 0, 0x2d58a35756265b63ULL},
      {20, 20, 25, 3014, 86, 137, 0, 0x04d2ebe0da8b95aaULL},
  };
  for (const Vector& v : vectors) {
    SCOPED_TRACE(testing::Message() << v.spacing_mm << " / " << v.radius_mm);
    const Clusters clusters = cook_clusters(layer, make_model(v.spacing_mm, v.radius_mm));
    EXPECT_EQ(clusters.count(), v.clusters);
    EXPECT_EQ(clusters.member.size(), static_cast<std::size_t>(v.memberships));
    EXPECT_EQ(clusters.orphans.size(), v.orphans);
    EXPECT_EQ(hash_of(clusters), v.hash);
    int smallest = 1 << 20;
    int largest = 0;
    for (int c = 0; c < clusters.count(); ++c) {
      const int size = clusters.begin[static_cast<std::size_t>(c) + 1] -
                       clusters.begin[static_cast<std::size_t>(c)];
      smallest = std::min(smallest, size);
      largest = std::max(largest, size);
    }
    EXPECT_EQ(smallest, v.min_size);
    EXPECT_EQ(largest, v.max_size);
  }
}

TEST(Cooker, PaperOptimumLeavesTheEightPublishedOrphans) {
  const Clusters clusters = cook_clusters(make_layer(30), make_model(12.7, 9.5));
  EXPECT_THAT(clusters.orphans, testing::ElementsAre(15, 16, 17, 18, 19, 29, 48, 690));
  EXPECT_NEAR(clusters.tie_margin, 9.7e-6, 0.1e-6);
  EXPECT_NEAR(clusters.centre.front().x(), 38.763158e-3, 1e-9);
  EXPECT_NEAR(clusters.centre.back().y(), -35.678571e-3, 1e-9);
}

TEST(Cooker, OrphanPolicies) {
  const auto layer = make_layer(30);
  const auto reject = make_model(12.7, 9.5, pb::ORPHANS_REJECT);
  try {
    require_no_orphans(cook_clusters(layer, reject), reject);
    FAIL() << "orphans were accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("leaves 8 of the particles"));
    EXPECT_THAT(error.what(), testing::HasSubstr("15 16 17 18 19 29 48 690"));
  }
  const auto attach = make_model(12.7, 9.5, pb::ORPHANS_ATTACH_NEAREST);
  const Clusters attached = cook_clusters(layer, attach);
  EXPECT_NO_THROW(require_no_orphans(attached, attach));
  EXPECT_EQ(attached.member.size(), 1685U);
  EXPECT_EQ(attached.attached, 8);
  std::vector<bool> covered(layer.size(), false);
  for (const int i : attached.member) covered[static_cast<std::size_t>(i)] = true;
  EXPECT_EQ(std::count(covered.begin(), covered.end(), false), 0);
}

TEST(Cooker, TieIsReported) {
  const auto layer = make_layer(30);
  EXPECT_LT(cook_clusters(layer, make_model(6, 6)).tie_margin, 0.1e-6);
  EXPECT_EQ(cook_clusters(layer, make_model(5.99, 5.99)).count(), 225);
  EXPECT_EQ(cook_clusters(layer, make_model(6.01, 6.01)).count(), 158);
}

TEST(Cooker, RigidGroups) {
  const auto layer = make_layer(30);
  EXPECT_EQ(cook_clusters(layer, make_model(12.7, 9.5)).rigid_groups, 1);
  const Clusters partition = cook_clusters(layer, make_model(12.7, 0));
  EXPECT_EQ(partition.rigid_groups, partition.count());
}

TEST(Cooker, RadiusFromTwelveTenthsOfSpacingLeavesNoOrphanInJitteredLayers) {
  std::mt19937 generator(7);  // local and seeded
  std::uniform_real_distribution<double> jitter(-0.4e-3, 0.4e-3);
  for (int draw = 0; draw < 20; ++draw) {
    auto layer = make_layer(30);
    for (auto& p : layer) p += Vector3d(jitter(generator), jitter(generator), 0);
    std::shuffle(layer.begin(), layer.end(), generator);
    EXPECT_TRUE(cook_clusters(layer, make_model(9.5, 1.2 * 9.5)).orphans.empty()) << draw;
  }
}

TEST(Sampler, BoxVector) {  // docs/tissue.md 2; thickness along z_B here
  pb::VolumeMaker maker;
  maker.set_particle_spacing_m(0.0025);
  maker.set_volume_sampling(4);
  const Vector3d half(0.045, 0.045, 0.002);
  const auto inside = [&half](std::span<const Vector3d> points) {
    std::vector<bool> result;
    for (const Vector3d& p : points) result.push_back((p.cwiseAbs().array() < half.array()).all());
    return result;
  };
  const auto particles = make_volume_particles(maker, -half, half, inside, {});
  EXPECT_EQ(particles.size(), 2997U);
  EXPECT_EQ(std::count_if(particles.begin(), particles.end(),
                          [](const Vector3d& p) { return p.y() < -0.0401; }),
            154);
  Vector3d extent = Vector3d::Zero();
  for (const Vector3d& p : particles) extent = extent.cwiseMax(p.cwiseAbs());
  EXPECT_NEAR(extent.x(), 43.904e-3, 1e-6);
  EXPECT_NEAR(extent.y(), 43.904e-3, 1e-6);
  EXPECT_NEAR(extent.z(), 0.794e-3, 1e-6);
  EXPECT_EQ(cook_clusters(particles, make_model(6, 6)).count(), 204);
  EXPECT_EQ(cook_clusters(particles, make_model(12.7, 9.5)).orphans.size(), 46U);
}

}  // namespace
}  // namespace omentum
