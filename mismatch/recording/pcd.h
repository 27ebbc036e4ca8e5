#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// The points of a PCD file (pointclouds.org, version 0.7), ascii or binary, x y z of any type;
/// further fields are passed over, points that are not finite left out. Total over any bytes. Fails
/// with one line that begins with `name`: no PCD, compressed data, no x, y or z, a file that ends
/// too soon, no point or more than 10 million.
Result<std::vector<Eigen::Vector3f>> parse_pcd(const std::string& name, std::string_view bytes);

}  // namespace omentum
