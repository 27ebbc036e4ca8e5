#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <vector>

#include "mismatch/recording/recording.h"
#include "proto/import_map.pb.h"

namespace omentum {

struct ArrayShape {
  std::size_t times = 0;
};

/// Of the array of a source (.npy, or one of an .npz). Throws Error: no array, axes that are not
/// its.
ArrayShape array_shape(const pb::SourceMap& source, const std::string& path);

/// Adds the array to a recording: columns by `source.column` (axes time column), clouds or markers
/// (axes time point xyz), turned into W. Points that are not finite are left out of clouds. Throws
/// Error.
void add_array(const pb::SourceMap& source, const std::string& path,
               const std::vector<std::int64_t>& times, const Eigen::Isometry3d& X_WF,
               Recording& recording);

}  // namespace omentum
