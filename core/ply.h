#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// Point clouds as PLY files (docs/formats.md 3): x, y, z of the vertices in m, frame W.

/// Binary little-endian.
std::string encode_ply(const std::vector<Eigen::Vector3f>& points);

/// The vertices of a PLY, ascii or binary little-endian, x y z of any scalar type; further
/// properties are passed over, as are elements behind the vertices. Total over any bytes. Fails
/// with one line that begins with `name`: no PLY, big-endian, vertices that are not the first
/// element or have a list, no x, y or z, a file that ends too soon, a number that is not finite, no
/// vertex or more than 10 million.
Result<std::vector<Eigen::Vector3f>> parse_ply(const std::string& name, std::string_view bytes);

}  // namespace omentum
