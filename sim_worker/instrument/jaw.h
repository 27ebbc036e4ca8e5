#pragma once

#include <algorithm>

#include "core/constants.h"
#include "core/trig.h"
#include "proto/config.pb.h"

namespace omentum {

// The grasp that can fail (docs/grasp.md): pure functions of its parameters and the contact; with
// every extra parameter zero it is the grasp of the paper.

/// Outcome of a pinch, in the order of the checks.
enum class PinchResult { kHeld, kTooFar, kJawNotOpen, kBadApproach, kTooThin };

/// Contact of jaw and tissue when the jaw is commanded to close.
struct PinchContact {
  double distance = 0;      ///< of the tip to the sheet (plain grasp: to a particle) [m]
  double jaw_deg = 0;       ///< angle of the jaw now
  double approach_deg = 0;  ///< between the jaw and the sheet's normal there, 0 ... 90
  double thickness = 0;     ///< of the tissue [m]
};

/// Angle at which both jaw faces touch tissue of this thickness [m]: 2 atan(thickness / 2 / length)
/// [deg].
inline double jaw_contact_deg(const pb::Grasp& grasp, double thickness) {
  constexpr double kDegreesPerRadian = 180 / kPi;
  return 2 * trig::atan2(0.5 * thickness, grasp.jaw_length_m()) * kDegreesPerRadian;
}

/// Whether a pinch takes hold.
inline PinchResult judge_pinch(const pb::Grasp& grasp, const PinchContact& contact) {
  if (!(contact.distance < grasp.radius_m())) return PinchResult::kTooFar;
  if (grasp.jaw_open_deg() > 0 && !(contact.jaw_deg >= jaw_contact_deg(grasp, contact.thickness)))
    return PinchResult::kJawNotOpen;
  if (grasp.max_approach_deg() > 0 && !(contact.approach_deg <= grasp.max_approach_deg()))
    return PinchResult::kBadApproach;
  if (grasp.min_pinch_m() > 0 && !(grasp.radius_m() - contact.distance >= grasp.min_pinch_m()))
    return PinchResult::kTooThin;
  return PinchResult::kHeld;
}

/// Jaw angle after `dt` seconds of moving towards open or closed.
inline double move_jaw(const pb::Grasp& grasp, double jaw_deg, bool closed, double dt) {
  const double step = grasp.jaw_rate_deg_per_s() * dt;
  return closed ? std::max(0.0, jaw_deg - step) : std::min(grasp.jaw_open_deg(), jaw_deg + step);
}

/// Slip speed of tissue in the jaw along a load [N]: 0 up to slip_force_n, then linear [m/s].
inline double slip_speed(const pb::Grasp& grasp, double load) {
  if (!(grasp.slip_force_n() > 0)) return 0;
  return grasp.slip_rate_m_per_s_n() * std::max(0.0, load - grasp.slip_force_n());
}

/// Whether tissue is lost after this much slip in all [m].
inline bool slipped_out(const pb::Grasp& grasp, double slip) {
  return grasp.loss_slip_m() > 0 && slip >= grasp.loss_slip_m();
}

}  // namespace omentum
