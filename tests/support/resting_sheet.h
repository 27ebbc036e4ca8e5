#pragma once

#include <Eigen/Core>
#include <cmath>
#include <vector>

#include "sim_worker/backend/sim_setup.h"
#include "sim_worker/models.h"

namespace omentum::test {

/// The sheet of a scene at rest on what lies under it, the tool at p_0: by particle its place in W
/// [m] and the normal out of the upper face.
struct RestingSheet {
  std::vector<Eigen::Vector3d> position, normal;
};

inline RestingSheet resting_sheet(const SimSetup& setup) {
  constexpr double kSettleTime = 3;  // [s]
  const auto tissue = setup.tissue->make_tissue(choose_kernel(0));
  const std::vector<ToolMotion> still(static_cast<std::size_t>(tissue->lanes()),
                                      ToolMotion{setup.scene.tool_start, setup.scene.tool_start});
  const auto steps = static_cast<int>(std::ceil(kSettleTime / setup.tissue->control_period));
  for (int i = 0; i < steps; ++i) tissue->step(still);
  RestingSheet sheet;
  for (int i = 0; i < tissue->particles(); ++i) sheet.position.push_back(tissue->position(0, i));
  sheet.normal.assign(sheet.position.size(), Eigen::Vector3d::Zero());
  for (const Eigen::Vector3i& t : setup.scene.tissue.surface_triangles) {
    const auto at = [&](int k) -> const Eigen::Vector3d& {
      return sheet.position[static_cast<std::size_t>(t[k])];
    };
    const Eigen::Vector3d area = (at(1) - at(0)).cross(at(2) - at(0));
    for (const int i : t) sheet.normal[static_cast<std::size_t>(i)] += area;
  }
  for (Eigen::Vector3d& n : sheet.normal) n = n.normalized() * (n.z() < 0 ? -1 : 1);
  return sheet;
}

}  // namespace omentum::test
