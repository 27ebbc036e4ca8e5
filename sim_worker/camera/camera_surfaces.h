#pragma once

#include <Eigen/Geometry>
#include <array>
#include <span>
#include <vector>

#include "sim_worker/camera/camera.h"

namespace omentum {

/// Triangles ready for drawing.
struct DrawSurface {
  struct Vertex {
    Eigen::Vector3f position;  ///< in W [m]
    Eigen::Vector3f normal;    ///< in W, unit
    Eigen::Vector3f texture;   ///< material point [m], for the mottling of shaded pictures
  };
  std::vector<Vertex> vertices;
  std::vector<std::uint32_t> indices;
};

/// The surface of a rigid body in W: analytic shapes finely tessellated (a sphere covers 0.04 %
/// less than the true disc), meshes with normals smoothed below 40 deg, a half-space over the
/// workspace.
DrawSurface make_body_surface(const RigidShape& body, const Eigen::AlignedBox3d& workspace);

/// Vertices of an edge, in the order of its triangle.
using Edge = std::array<int, 2>;
/// The edges that only one triangle uses.
std::vector<Edge> find_rim(const std::vector<Eigen::Vector3i>& triangles);

/// The sheet: with thickness 0 [m] its middle surface (for object ids), else both faces, offset by
/// half the thickness along the vertex normals, joined along the rim. `rest`: the vertices at rest
/// in B. With `lower` the vertices are those of the upper face and these of the lower one.
DrawSurface make_tissue_surface(std::span<const float> vertices_W,
                                const std::vector<Eigen::Vector3d>& rest,
                                const std::vector<Eigen::Vector3i>& triangles,
                                const std::vector<Edge>& rim, double thickness,
                                std::span<const float> lower = {});

/// Shaft, wrist and two tapered jaws [m].
DrawSurface make_tool_surface(const ToolPose& pose, double shaft_radius, double shaft_start,
                              double shaft_length);

}  // namespace omentum
