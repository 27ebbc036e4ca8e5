#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// The points of a PCD file (pointclouds.org, version 0.7), ascii, binary or binary_compressed, x y
/// z of any type; further fields are passed over, points that are not finite left out. Total over
/// any bytes. Fails with one line that begins with `name`: no PCD, damaged data, no x, y or z, a
/// file that ends too soon, more than 10 million points.
Result<std::vector<Eigen::Vector3f>> parse_pcd(const std::string& name, std::string_view bytes);

/// Whether the header states a pose of the sensor (VIEWPOINT) other than the identity; it is not
/// applied, since programs differ in what they mean by it.
bool has_viewpoint(std::string_view pcd);

}  // namespace omentum
