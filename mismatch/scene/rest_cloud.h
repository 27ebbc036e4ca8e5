#pragma once

#include <string>
#include <vector>

#include "mismatch/recording/recording.h"
#include "proto/prior.pb.h"
#include "proto/scene.pb.h"

namespace omentum {

/// What is known of a body at rest beside its cloud.
struct RestCloudSettings {
  double board_z = 0;    ///< height of the board it lies on, in W [m]
  double thickness = 0;  ///< stated [m]; 0: the height of the cloud above the board
  double clamp = 0.003;  ///< width of the strip that is fixed [m]
  /// Towards the fixed edge from the middle of the body, in W; along one of its edges.
  Eigen::Vector2d fixed = Eigen::Vector2d(0, -1);
};

/// A scene of a sheet from its cloud at rest, and how sure its numbers are.
struct RestScene {
  pb::Scene scene;
  pb::Priors priors;
  std::vector<std::string> warnings;
};

/// Outline: the rectangle of the least area around the points seen from above, half a percent of
/// them outside on each side. Thickness, and the curvatures of the rest shape, by least squares
/// over the points. Throws Error, beginning with `name`, for a cloud of fewer than 100 points, one
/// that is not in metres, and one that lies below the board.
RestScene scene_of_cloud(const std::string& name, const Cloud& cloud,
                         const RestCloudSettings& settings);

}  // namespace omentum
