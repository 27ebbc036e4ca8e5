#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "proto/scene.pb.h"
#include "sim_worker/camera/camera.h"

namespace omentum {

/// Points of the tissue as a depth camera at the endoscope's pose gives them: one ray per pixel,
/// nothing where tool or organ cover it, noise along the ray, quantised depth, dropped pixels
/// (docs/formats.md 3: no correspondence between frames). Order: row by row. Every draw is a
/// function of (seed, frame, pixel). Depths are off by the sensor's bias_m + scale_change z +
/// bias_per_m z^2; points by its registration, a turn about the camera and a shift. The caller sees
/// to time_offset_s.
///
/// p_W in metres.
std::vector<Eigen::Vector3f> sense_cloud(Camera& camera, const CameraFrame& frame,
                                         const pb::DepthSensor& sensor, std::uint64_t seed,
                                         std::uint32_t frame_number);

}  // namespace omentum
