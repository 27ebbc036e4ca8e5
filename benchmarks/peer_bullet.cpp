// Peer of bench_elastic: the same lift (31 x 31 nodes, 90 x 90 x 3 mm, 1000 kg/m^3, E 100 kPa,
// pinned edge, a corner patch on an arc) by Bullet's soft body: position-based links along the
// edges, across the cells and over two edges (5458), ten substeps of one iteration per environment
// step of 20 ms. A link has a stiffness between 0 and 1, no modulus, so its error is that of the
// model too. `peer_bullet SURFACE` with the converged surface that `bench_elastic 0 SURFACE` wrote.
// Thread CPU time, physics only.
#include <BulletSoftBody/btSoftBody.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>
#include <btBulletDynamicsCommon.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>
#include <vector>

#include "core/clock.h"

namespace {

using omentum::thread_seconds;

constexpr int kSide = 31;
constexpr int kNodes = kSide * kSide;
constexpr double kPitch = 0.003;    // [m]
constexpr double kPinned = -0.045;  // y of the pinned edge [m]
constexpr double kStep = 0.02;      // [s]
constexpr int kSubsteps = 10;
constexpr double kDamping = 3;  // [1/s]
constexpr int kSteps = 220;     // 2.4 s of lift and 2 s of hold

/// Way of the patch at a time: as tip_at in bench_elastic.cpp.
btVector3 way_at(double time) {
  const double radius = 0.042 - kPinned;
  const double angle = std::min(0.025 * time, 0.060) / radius;
  return {0, static_cast<btScalar>(radius * (std::cos(angle) - 1)),
          static_cast<btScalar>(radius * std::sin(angle))};
}

struct World {
  btSoftBodyRigidBodyCollisionConfiguration configuration;
  btCollisionDispatcher dispatcher{&configuration};
  btDbvtBroadphase broadphase;
  btSequentialImpulseConstraintSolver solver;
  btSoftRigidDynamicsWorld world{&dispatcher, &broadphase, &solver, &configuration};
};

/// The sheet; the world owns it.
btSoftBody* add_sheet(btSoftRigidDynamicsWorld& world) {
  world.setGravity({0, 0, -9.81F});
  world.getWorldInfo().m_gravity = world.getGravity();
  std::vector<btVector3> x;
  for (int ix = 0; ix < kSide; ++ix) {
    for (int iy = 0; iy < kSide; ++iy) {
      x.emplace_back(static_cast<btScalar>((ix - 15) * kPitch),
                     static_cast<btScalar>((iy - 15) * kPitch), 0.0F);
    }
  }
  auto* sheet = new btSoftBody(&world.getWorldInfo(), kNodes, x.data(), nullptr);
  const double mass = 1000 * 0.003 * 0.09 * 0.09 / kNodes;
  for (int i = 0; i < kNodes; ++i) {
    const int ix = i / kSide;
    const int iy = i % kSide;
    const bool driven = iy == 0 || (ix <= 2 && iy >= kSide - 3);
    sheet->setMass(i, driven ? 0.0F : static_cast<btScalar>(mass));
    constexpr std::array<std::array<int, 2>, 6> kWays = {
        {{1, 0}, {0, 1}, {1, 1}, {1, -1}, {2, 0}, {0, 2}}};
    for (const auto& [dx, dy] : kWays) {
      if (ix + dx >= kSide || iy + dy >= kSide || iy + dy < 0) continue;
      sheet->appendLink(i, i + dx * kSide + dy, nullptr, false);
    }
  }
  sheet->m_materials[0]->m_kLST = 1;
  sheet->m_cfg.piterations = 1;
  sheet->m_cfg.kDP = static_cast<btScalar>(kDamping * kStep / kSubsteps);
  sheet->m_cfg.collisions = 0;
  world.addSoftBody(sheet);
  return sheet;
}

void step(btSoftRigidDynamicsWorld& world, btSoftBody& sheet, const std::vector<btVector3>& rest,
          int number) {
  for (int k = 0; k < kSubsteps; ++k) {
    const btVector3 way = way_at(kStep * (number + (k + 1.0) / kSubsteps));
    for (int ix = 0; ix <= 2; ++ix) {
      for (int iy = kSide - 3; iy < kSide; ++iy) {
        const int i = kSide * ix + iy;
        sheet.m_nodes[i].m_x = sheet.m_nodes[i].m_q = rest[static_cast<std::size_t>(i)] + way;
        sheet.m_nodes[i].m_v.setZero();
      }
    }
    world.stepSimulation(static_cast<btScalar>(kStep / kSubsteps), 0);
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: peer_bullet SURFACE\n");
    return 2;
  }
  std::ifstream file(argv[1]);
  std::vector<std::array<double, 3>> converged(kNodes);
  for (auto& p : converged) file >> p[0] >> p[1] >> p[2];
  if (!file) {
    std::fprintf(stderr, "peer_bullet: %s: not %d places\n", argv[1], kNodes);
    return 2;
  }
  World world;
  btSoftBody* const sheet = add_sheet(world.world);
  std::vector<btVector3> rest;
  for (int i = 0; i < kNodes; ++i) rest.push_back(sheet->m_nodes[i].m_x);
  double best = 1e9;
  double begin = thread_seconds();
  for (int number = 0; number < kSteps; ++number) {
    if (number % 20 == 0) begin = thread_seconds();
    step(world.world, *sheet, rest, number);
    if (number % 20 == 19 && number > 25) best = std::min(best, (thread_seconds() - begin) / 20);
  }
  double sum = 0;
  for (int i = 0; i < kNodes; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const double off = static_cast<double>(sheet->m_nodes[i].m_x[axis]) -
                         converged[static_cast<std::size_t>(i)][static_cast<std::size_t>(axis)];
      sum += off * off;
    }
  }
  std::printf("peer.bullet.env_steps_per_s %.0f steps/s\n", 1 / best);
  std::printf(
      "peer.bullet.static_error_mm %.2f mm # %d links, centre z %.2f mm, free corner z %.2f mm\n",
      1e3 * std::sqrt(sum / kNodes), sheet->m_links.size(),
      1e3 * static_cast<double>(sheet->m_nodes[480].m_x.z()),
      1e3 * static_cast<double>(sheet->m_nodes[960].m_x.z()));
  world.world.removeSoftBody(sheet);
  delete sheet;
  return 0;
}
