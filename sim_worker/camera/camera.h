#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "sim_worker/camera/image.h"
#include "sim_worker/scene/scene.h"

// camera/ makes pictures off screen: the endoscope, shaded or as object ids, and a depth sensor.
// For observations, recordings and reports; its numbers are compared with tolerances, not bit for
// bit.

namespace omentum {

/// What a pixel of an id image shows. Values reach recordings of image observations: do not change.
enum class ObjectId : std::uint8_t {
  kBackground = 0,
  kBoard = 1,
  kOrgan = 2,
  kTumour = 3,
  kTissue = 4,
  kTool = 5,
  kObstacle = 6,
};

/// The tool as drawn: two jaws that meet in T and a shaft behind them.
struct ToolPose {
  Eigen::Vector3d p_WT = Eigen::Vector3d::Zero();            ///< jaw tip [m]
  Eigen::Vector3d shaft_axis_W = -Eigen::Vector3d::UnitZ();  ///< unit, from the shaft to the tip
  double roll_rad = 0;                                       ///< about the shaft axis
  double jaw_rad = 0;  ///< full opening angle between the jaws
};

/// The moving things of one picture. `tissue_vertices_W` holds x y z [m] of every vertex that
/// scene.tissue.surface_triangles refers to (the particles of a sheet), then of every node of
/// scene.soft_body; empty = no sheet, and the soft body at rest. With `lower_face_W` these are the
/// two faces of a sheet as they are; else its mid-surface, half the thickness from both. Read
/// during the call only.
struct CameraFrame {
  std::span<const float> tissue_vertices_W;
  std::optional<ToolPose> tool = {};
  std::span<const float> lower_face_W = {};
};

/// What a depth camera without error would measure, per pixel, top row first.
struct DepthImage {
  Image ids;
  std::vector<float> depth_m;  ///< along the optical axis to the drawn surface, 0 where none is
};

/// The simulated endoscope: off-screen OpenGL in software (OSMesa, llvmpipe), without display or
/// GPU. Two kinds of picture: `shaded` for people, `object ids` for counting and as an observation
/// (no light, no antialiasing; equal between machines that run the same rasteriser).
///
/// One thread at a time per Camera; different Cameras may run in different threads. Copies what it
/// needs from the scene. Construction compiles shaders (about 0.1 s): keep the object.
class Camera {
 public:
  /// Pictures of width x height pixels, averaged over supersample^2 samples when shaded. Throws
  /// Error where OSMesa offers no OpenGL 3.3 core context.
  Camera(const Scene& scene, int width, int height, int supersample = 3);
  ~Camera();
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;

  /// The endoscope of the scene; its aspect ratio is that of the image.
  const CameraPose& endoscope() const;

  /// RGB picture from the endoscope or from another pose (near and far plane are widened as
  /// needed).
  Image draw_shaded(const CameraFrame& frame) { return draw_shaded(frame, endoscope()); }
  Image draw_shaded(const CameraFrame& frame, const CameraPose& pose);

  /// One byte per pixel, an ObjectId.
  Image draw_ids(const CameraFrame& frame);
  Image draw_ids(const CameraFrame& frame, const CameraPose& pose, int width, int height);

  /// Depth and ids from a pose. A sheet has its thickness here.
  DepthImage draw_depth(const CameraFrame& frame, const CameraPose& pose, int width, int height);

 private:
  class Renderer;
  std::unique_ptr<Renderer> renderer_;
};

/// Camera pose at `eye` looking at `target`, with `up` as far up as possible [m, in W].
CameraPose look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target,
                   const Eigen::Vector3d& up, double vertical_fov_rad);

}  // namespace omentum
