#pragma once

#include <Eigen/Geometry>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "mismatch/import/file_pattern.h"
#include "proto/import_map.pb.h"

namespace omentum {

/// How many numbers a form of rotation has.
std::size_t numbers_of(pb::RotationForm form);

/// Rotation of numbers in a form [rad, or degrees]; `axes` as "zyx" for Euler angles. Fails with
/// one line: no unit quaternion (1e-3), no rotation matrix (mirrored axes too), axes that are none.
Result<Eigen::Quaterniond> make_rotation(std::span<const double> numbers, pb::RotationForm form,
                                         const std::string& axes, bool degrees);

/// A rigid transform that carries points to others, and how far they are apart then.
struct RigidFit {
  Eigen::Isometry3d X_TF;
  double rms_m = 0, largest_m = 0;
};
/// Least squares. Fails where there are fewer than three points or all lie on one line.
Result<RigidFit> fit_rigid(const std::vector<Eigen::Vector3d>& from,
                           const std::vector<Eigen::Vector3d>& to);

/// The transforms of a source one after the other; files lie in `folder`. What a fit gave is
/// appended to `notes`. Throws Error.
Eigen::Isometry3d make_transform(const google::protobuf::RepeatedPtrField<pb::TransformMap>& maps,
                                 const std::string& folder, const Values& values,
                                 std::vector<std::string>& notes);

}  // namespace omentum
