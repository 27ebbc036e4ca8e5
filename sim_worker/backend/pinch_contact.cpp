#include "sim_worker/backend/pinch_contact.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// Between the jaw and the sheet's normal at a particle, the sum of the normals of its triangles.
double approach_deg(const SimSetup& setup, const Tissue<float>& tissue, int lane,
                    const Vector3d& jaw, int particle) {
  const TissueBody& body = setup.scene.tissue;
  // A volume has no sheet normal: its jaws take a fold from any side.
  if (!body.surface_is_particles) return 0;
  Vector3d normal = Vector3d::Zero();
  for (const Eigen::Vector3i& t : body.surface_triangles) {
    if (t[0] != particle && t[1] != particle && t[2] != particle) continue;
    const Vector3d a = tissue.position(lane, t[0]);
    normal += (tissue.position(lane, t[1]) - a).cross(tissue.position(lane, t[2]) - a);
  }
  const double length = normal.norm();
  if (!(length > 0)) return 90;
  const double cosine = std::min(1.0, std::fabs(normal.dot(jaw)) / length);
  return trig::atan2(std::sqrt(1 - cosine * cosine), cosine) * 180 / kPi;
}

/// Tip to the sheet: the triangles around the nearest particle [m].
double sheet_distance(const SimSetup& setup, const Tissue<float>& tissue, int lane,
                      const Vector3d& tip, const Nearest& nearest) {
  double squared = nearest.distance * nearest.distance;
  for (const Eigen::Vector3i& t : setup.scene.tissue.surface_triangles) {
    if (t[0] != nearest.particle && t[1] != nearest.particle && t[2] != nearest.particle) continue;
    squared = std::min(squared, squared_distance_to_triangle(tip, tissue.position(lane, t[0]),
                                                             tissue.position(lane, t[1]),
                                                             tissue.position(lane, t[2])));
  }
  return std::sqrt(squared);
}

}  // namespace

PinchContact pinch_contact(const SimSetup& setup, const Tissue<float>& tissue, int lane,
                           const Jaw& jaw, const Nearest& nearest) {
  const pb::Grasp& grasp = setup.config.grasp();
  PinchContact contact;
  // A pinch takes the sheet between its particles as well; the plain grasp knows particles only.
  contact.distance = grasp.min_pinch_m() > 0 && setup.scene.tissue.surface_is_particles
                         ? sheet_distance(setup, tissue, lane, jaw.tip, nearest)
                         : nearest.distance;
  contact.jaw_deg = jaw.angle_deg;
  contact.thickness = setup.scene.tissue.thickness * tissue.thickness_scale(lane);
  // The normal costs a walk over the triangles: only where tissue is in reach and the angle
  // matters.
  if (grasp.max_approach_deg() > 0 && contact.distance < grasp.radius_m())
    contact.approach_deg = approach_deg(setup, tissue, lane, jaw.direction, nearest.particle);
  return contact;
}

}  // namespace omentum
