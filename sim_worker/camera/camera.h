#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "sim_worker/camera/image.h"
#include "sim_worker/scene/scene.h"

// camera/ makes pictures off screen (OSMesa): the endoscope, shaded or as object ids, and what a
// depth sensor would measure of it. For observations, recordings and reports; its numbers are
// compared with tolerances, not bit for bit.

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
/// scene.soft_body; empty = no sheet, and the soft body at rest. The span must stay valid during
/// the call only.
struct CameraFrame {
  std::span<const float> tissue_vertices_W;
  std::optional<ToolPose> tool;
};

/// Exposure of the tumour by counting pixels of id images (docs/task.md 9).
struct Exposure {
  int unoccluded = 0;      ///< tumour pixels without sheet and tool; organs and obstacles stay
  int visible = 0;         ///< tumour pixels with everything
  int hidden_by_tool = 0;  ///< tumour pixels that only the tool covers
  /// Share of the tumour that can be seen, 0 if it is out of view.
  double fraction() const { return unoccluded > 0 ? double(visible) / unoccluded : 0; }
};

/// What a depth camera would measure without any error: per pixel, top row first, the distance
/// along the optical axis to the drawn surface [m], 0 where there is none, and what was hit.
struct DepthImage {
  Image ids;
  std::vector<float> depth_m;
};

/// The simulated endoscope: an off-screen OpenGL renderer in software (OSMesa, llvmpipe), so
/// pictures need neither a display nor a GPU. Two kinds of picture: `shaded` for people, `object
/// ids` for counting and as an observation (no light, no antialiasing; equal between machines that
/// run the same rasteriser).
///
/// One Camera owns one OpenGL context. Thread rule: one thread at a time per Camera, and different
/// Cameras may run in different threads; every call binds the context to the calling thread and
/// releases it before returning. Copies what it needs from the scene, which may go away.
/// Construction compiles shaders (about 0.1 s): keep the object.
class Camera {
 public:
  /// Pictures of width x height pixels, averaged over supersample^2 samples when shaded. Throws
  /// Error where OSMesa offers no OpenGL 3.3 core context.
  Camera(const Scene& scene, int width, int height, int supersample = 3);
  ~Camera();
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;

  /// The endoscope of the scene. Its aspect ratio is that of the image.
  const CameraPose& endoscope() const;

  /// RGB picture from the endoscope or from another pose (near and far plane are widened as
  /// needed).
  Image draw_shaded(const CameraFrame& frame);
  Image draw_shaded(const CameraFrame& frame, const CameraPose& pose);

  /// One byte per pixel, an ObjectId.
  Image draw_ids(const CameraFrame& frame);
  Image draw_ids(const CameraFrame& frame, const CameraPose& pose, int width, int height);

  /// Depth and ids from a pose. A sheet has its thickness here.
  DepthImage draw_depth(const CameraFrame& frame, const CameraPose& pose, int width, int height);

  /// Exposure in the zoom view: endoscope position, field of view scene.exposure_fov_rad, square of
  /// scene.exposure_pixels, aimed at the tumour's centre. A pure function of the frame.
  Exposure exposure_from_image(const CameraFrame& frame);
  /// The same share counted as the seed does: 60 deg, 64 x 64 pixels (the whole tumour is about 28
  /// pixels).
  Exposure exposure_seed_64px(const CameraFrame& frame);

 private:
  class Renderer;
  std::unique_ptr<Renderer> renderer_;
};

/// Camera pose at `eye` looking at `target`, with `up` as far up as possible [m, in W].
CameraPose look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target,
                   const Eigen::Vector3d& up, double vertical_fov_rad);

}  // namespace omentum
