#include "sim_worker/backend/seed_defects.h"

#include <algorithm>
#include <cmath>

namespace omentum {

using Eigen::Vector3d;

std::vector<Vector3d> SeedDefects::reset_positions_only(const Tissue<float>& tissue, int lane,
                                                        const TissueBody& body) const {
  std::vector<Vector3d> velocities;
  if (!on_.reset_positions_only()) return velocities;
  const auto count = static_cast<int>(body.particles.size());
  for (int i = 0; i < count; ++i) velocities.push_back(tissue.velocity(lane, i));
  return velocities;
}

std::vector<std::int32_t> SeedDefects::reset_patch_at_tool(const Tissue<float>& tissue,
                                                           int lane) const {
  if (!on_.reset_patch_at_tool()) return {};
  const auto held = tissue.held(lane);
  return {held.begin(), held.end()};
}

bool SeedDefects::grasp_any_body(const Scene& scene, const Vector3d& tip, double radius) const {
  if (!on_.grasp_any_body()) return false;
  return std::any_of(scene.bodies.begin(), scene.bodies.end(), [&](const RigidShape& body) {
    if (body.kind != RigidShape::Kind::kSphere && body.kind != RigidShape::Kind::kEllipsoid)
      return false;
    const Vector3d p = body.X_WS.inverse() * tip;
    const double scaled = p.cwiseQuotient(body.size).norm();
    return std::fabs(scaled - 1) * p.norm() / std::max(scaled, 1e-9) < radius;
  });
}

}  // namespace omentum
