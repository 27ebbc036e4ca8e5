#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "sim_worker/camera/camera.h"

namespace omentum {

/// Triangles ready for drawing.
struct DrawSurface {
  struct Vertex {
    Eigen::Vector3f position;  ///< in W [m]
    Eigen::Vector3f normal;    ///< in W, unit
    Eigen::Vector3f
        texture;  ///< point fixed to the material [m]; carries the mottling of shaded pictures
  };
  std::vector<Vertex> vertices;
  std::vector<std::uint32_t> indices;
};

/// The surface of a rigid body in W: analytic shapes are tessellated finely (a sphere of 128
/// sectors covers 0.04 % less area than the true disc), meshes are drawn as they are with normals
/// smoothed below 40 deg.
DrawSurface make_body_surface(const RigidShape& body, const Eigen::Vector3d& workspace_min,
                              const Eigen::Vector3d& workspace_max);

/// The sheet. With thickness 0 its middle surface (what exposure counts); otherwise both faces,
/// offset by half the thickness along the vertex normals, and the rim between them (for pictures).
/// `rest` holds the same vertices at rest in B.
DrawSurface make_tissue_surface(std::span<const float> vertices_W,
                                const std::vector<Eigen::Vector3d>& rest,
                                const std::vector<Eigen::Vector3i>& triangles, double thickness);

/// Shaft, wrist and two tapered jaws [m].
DrawSurface make_tool_surface(const ToolPose& pose, double shaft_radius, double shaft_start,
                              double shaft_length);

}  // namespace omentum
