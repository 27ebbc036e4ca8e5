#pragma once

#include <Eigen/Geometry>
#include <string>

#include "sim_worker/scene/scene.h"

namespace omentum {

// Parts of make_scene(). `path` is the knob that messages name; relative mesh paths start at
// `directory`; all throw Error, one line, for what cannot be meant.

Eigen::Vector3d to_vector(const pb::Vec3& v);

/// Axes orthonormalised; none is the identity.
Eigen::Isometry3d to_pose(const pb::Pose& pose, const std::string& path);

std::string mesh_path(const pb::MeshFile& file, const std::string& directory,
                      const std::string& knob);

/// A closed mesh of the size of organs and tissue patches.
TriangleMesh load_scene_mesh(const pb::MeshFile& file, const std::string& directory,
                             const std::string& path);

RigidShape make_rigid_body(const pb::RigidBody& config, const std::string& directory,
                           const std::string& path);

/// `supported`: something lies under the body, so that it need not be anchored.
SoftBody make_soft_body(const pb::DeformableBody& config, const std::string& directory,
                        bool supported);

/// Particles, surface and anchors; fills `solid` or `sheet` where the tissue has such a mesh.
TissueBody make_tissue_body(const pb::Tissue& config, const std::string& directory,
                            SolidMesh& solid, SheetGeometry& sheet);

/// Tumour, tissue, starts, target and q against each other, the other bodies, the workspace and the
/// camera: what is impossible is refused, what is odd becomes a warning with the range.
void check_places(const Scene& scene, std::vector<std::string>& warnings);

}  // namespace omentum
