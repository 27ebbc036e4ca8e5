#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "proto/scene.pb.h"
#include "sim_worker/camera/camera.h"

namespace omentum {

/// Points p_W of the tissue [m], row by row, as measured by a depth camera at the endoscope's pose:
/// one ray per pixel that sees tissue, noise along the ray, quantised depth, dropped pixels
/// (docs/formats.md 3: no correspondence between frames). Depths are off by the sensor's bias_m +
/// scale_change z + bias_per_m z^2; points by its registration, a rotation about the camera and a
/// shift. Random numbers are functions of (seed, frame, pixel). time_offset_s is the caller's.
std::vector<Eigen::Vector3f> sense_cloud(Camera& camera, const CameraFrame& frame,
                                         const pb::DepthSensor& sensor, std::uint64_t seed,
                                         std::uint32_t frame_number);

}  // namespace omentum
