#pragma once

#include <Eigen/Geometry>

#include "core/result.h"
#include "mismatch/scene/belief.h"
#include "mismatch/scene/believed_scene.h"

namespace omentum {

/// Gravity as a vector in W, or as its size along -z_W. A direction beside -z_W becomes the tilt of
/// the scene's effects, about x_W, then y_W. It fails with one line where the size is out of range.
Result<void> set_believed_gravity(const Belief& belief, BelievedScene& made);

/// The scene can hang one weight: the first that says how heavy it is and where. Others are told.
void set_believed_mass(const Belief& belief, BelievedScene& made);

/// The shaft's direction may be stated up or down; the instrument comes from above, and the arm is
/// placed up the shaft. A patch becomes
/// a pad along x and y of the sheet, which holds every point of both faces under it; a mesh of its
/// own cannot be held so (docs/tissue.md 13) and is held by a disc of the same area. `X_WB`: pose
/// of the body, y_B along x of the sheet.
void set_believed_tool(const Belief& belief, const Eigen::Isometry3d& X_WB, BelievedScene& made);

}  // namespace omentum
