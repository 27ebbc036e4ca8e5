#pragma once

#include <Eigen/Geometry>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "proto/prior.pb.h"
#include "proto/scene.pb.h"

namespace omentum {

enum class SetUp { kSheet, kSolid, kArm, kCoupon };

/// What an operator believes about a set-up, as a scene (docs/calibrate.md 2).
struct BelievedScene {
  SetUp kind = SetUp::kSheet;
  /// Of an arm without tissue, of a coupon the material alone.
  pb::Scene scene;
  pb::Priors priors;                     ///< where the belief states how sure it is
  std::vector<Eigen::Vector3d> pinch_W;  ///< stated pinch points, p_W [m]
  std::string rest_cloud_file;           ///< relative to the text; empty: none
  std::vector<std::string> warnings;     ///< what was not used or had to be assumed, a line each
};

/// scene_believed.txt: a line "key: value" each, `#` begins a comment, units at the end of the key.
/// Total over any bytes; fails with one line, `name`:line and what was expected: a line without
/// colon, a key twice, a number that is none, a value outside its range.
Result<BelievedScene> parse_believed_scene(const std::string& name, std::string_view text);

/// A sheet around the origin of its frame B, flat on a board below it, with camera, tool and
/// workspace around it: what a scene needs and no belief states.
struct SheetPlace {
  double size_x = 0.09, size_y = 0.09, thickness = 0.003;  ///< along x_B, y_B, z_B [m]
  double clamp = 0.003;  ///< width of the strip at -y_B that is held [m]
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
};
/// Fills in tissue (grid and clamp), arm and workspace. How far the grid is from the stated size is
/// appended to `warnings`.
void place_sheet(const SheetPlace& place, pb::Scene& scene, std::vector<std::string>& warnings);

}  // namespace omentum
