#include "sim_worker/geometry/box_tree.h"

#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "sim_worker/geometry/mesh.h"
#include "sim_worker/geometry/surface_search.h"
#include "tests/support/fixtures.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr double kFar = std::numeric_limits<double>::infinity();

std::vector<Vector3d> random_points(int count) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-60, 60);  // mm: in and around the meshes
  std::vector<Vector3d> points;
  for (int k = 0; k < count; ++k)
    points.emplace_back(uniform(random), uniform(random), uniform(random));
  return points;
}

double squared_distance(const TriangleMesh& mesh, const Vector3d& p, int t) {
  const Vector3i& c = mesh.triangles[t];
  return squared_distance_to_triangle(p, mesh.vertices[c[0]], mesh.vertices[c[1]],
                                      mesh.vertices[c[2]]);
}

/// Least squared distance by the tree; counts the triangles it looked at.
double search(const BoxTree& tree, const TriangleMesh& mesh, const Vector3d& p, int& visits) {
  double squared = kFar;
  tree.for_each_near(p, squared, [&](int t) {
    ++visits;
    squared = std::min(squared, squared_distance(mesh, p, t));
  });
  return squared;
}

double search_all(const TriangleMesh& mesh, const Vector3d& p) {
  double squared = kFar;
  for (int t = 0; t < static_cast<int>(mesh.triangles.size()); ++t)
    squared = std::min(squared, squared_distance(mesh, p, t));
  return squared;
}

TEST(BoxTree, FindsTheLeastDistanceAtRestAndAfterMotion) {
  TriangleMesh mesh = test::make_fat_pad_mm();
  BoxTree tree(mesh.triangles, mesh.vertices);
  int visits = 0;
  for (const Vector3d& p : random_points(300))
    EXPECT_EQ(search(tree, mesh, p, visits), search_all(mesh, p)) << p.transpose();
  EXPECT_LT(visits, 300 * 100) << "of " << mesh.triangles.size() << " triangles each";
  for (Vector3d& v : mesh.vertices) v = {1.5 * v.x() - v.z(), 0.5 * v.y(), v.z() + 0.1 * v.x()};
  tree.fit(mesh.vertices);
  for (const Vector3d& p : random_points(300))
    EXPECT_EQ(search(tree, mesh, p, visits), search_all(mesh, p)) << p.transpose();
}

TEST(BoxTree, VisitsEveryTriangleOnceWhereNothingLowersTheReach) {
  const TriangleMesh mesh = test::make_organ_mm();
  const BoxTree tree(mesh.triangles, mesh.vertices);
  std::vector<int> visits(mesh.triangles.size(), 0);
  tree.for_each_near({1, 2, 3}, kFar, [&](int t) { ++visits[t]; });
  EXPECT_EQ(visits, std::vector<int>(mesh.triangles.size(), 1));
}

TEST(BoxTree, VisitsNothingOutOfReach) {
  const TriangleMesh mesh = make_box_mesh({1, 1, 1});
  const BoxTree tree(mesh.triangles, mesh.vertices);
  int visits = 0;
  tree.for_each_near({3, 0, 0}, 4.0, [&](int) { ++visits; });  // 2 away: nothing is nearer
  EXPECT_EQ(visits, 0);
  tree.for_each_near({3, 0, 0}, 4.1, [&](int) { ++visits; });
  EXPECT_GT(visits, 0);
}

TEST(BoxTree, OfTrianglesOnEachOtherASearchFindsAlwaysTheSame) {
  TriangleMesh mesh = make_box_mesh({1, 2, 3});
  const std::vector<Vector3i> once = mesh.triangles;
  for (int copy = 0; copy < 3; ++copy)
    mesh.triangles.insert(mesh.triangles.end(), once.begin(), once.end());
  const SurfaceSearch first(mesh.triangles, mesh.vertices);
  const SurfaceSearch second(mesh.triangles, mesh.vertices);
  for (const Vector3d& p : random_points(50)) {
    const TrianglePoint found = first.find(p, mesh.vertices, 1000);
    EXPECT_EQ(second.find(p, mesh.vertices, 1000).triangle, found.triangle);
    EXPECT_NEAR(found.squared / search_all(mesh, p), 1, 1e-12);  // another formula's rounding
  }
}

}  // namespace
}  // namespace omentum
