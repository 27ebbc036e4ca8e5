#pragma once

#include "proto/config.pb.h"

namespace omentum {

/// The grasp that can fail (docs/grasp.md). Pure functions of the parameters and what the jaw
/// meets; the plain grasp of the paper is the case with every extra parameter zero.
enum class PinchResult { kHeld, kTooFar, kJawNotOpen, kBadApproach, kTooThin };

/// What the jaw meets at the moment it is commanded to close on tissue.
struct PinchContact {
  double distance = 0;      ///< tip to the sheet; for the plain grasp to its nearest particle [m]
  double jaw_deg = 0;       ///< present angle of the jaw
  double approach_deg = 0;  ///< between the jaw and the sheet's normal at that particle, 0 ... 90
  double thickness = 0;     ///< of the tissue [m]
};

/// Angle at which both jaw faces touch tissue of the given thickness: 2 atan(thickness / 2 /
/// jaw_length) [deg].
double jaw_contact_deg(const pb::Grasp& grasp, double thickness);

/// Does a pinch take hold? Checks in the order of PinchResult.
PinchResult judge_pinch(const pb::Grasp& grasp, const PinchContact& contact);

/// Jaw angle after `dt` seconds of moving towards open or closed.
double move_jaw(const pb::Grasp& grasp, double jaw_deg, bool closed, double dt);

/// Slip speed [m/s] along the load [N].
double slip_speed(const pb::Grasp& grasp, double load);

/// Is tissue lost after this much accumulated slip [m]?
bool slipped_out(const pb::Grasp& grasp, double slip);

}  // namespace omentum
