#include "sim_worker/instrument/jaw.h"

#include <algorithm>

#include "core/constants.h"
#include "core/trig.h"

namespace omentum {

double jaw_contact_deg(const pb::Grasp& grasp, double thickness) {
  constexpr double kDegreesPerRadian = 180 / kPi;
  return 2 * trig::atan2(0.5 * thickness, grasp.jaw_length_m()) * kDegreesPerRadian;
}

PinchResult judge_pinch(const pb::Grasp& grasp, const PinchContact& contact) {
  if (!(contact.distance < grasp.radius_m())) return PinchResult::kTooFar;
  if (grasp.jaw_open_deg() > 0 && !(contact.jaw_deg >= jaw_contact_deg(grasp, contact.thickness))) {
    return PinchResult::kJawNotOpen;
  }
  if (grasp.max_approach_deg() > 0 && !(contact.approach_deg <= grasp.max_approach_deg())) {
    return PinchResult::kBadApproach;
  }
  if (grasp.min_pinch_m() > 0 && !(grasp.radius_m() - contact.distance >= grasp.min_pinch_m())) {
    return PinchResult::kTooThin;
  }
  return PinchResult::kHeld;
}

double move_jaw(const pb::Grasp& grasp, double jaw_deg, bool closed, double dt) {
  const double step = grasp.jaw_rate_deg_per_s() * dt;
  return closed ? std::max(0.0, jaw_deg - step) : std::min(grasp.jaw_open_deg(), jaw_deg + step);
}

double slip_speed(const pb::Grasp& grasp, double load) {
  if (!(grasp.slip_force_n() > 0)) return 0;
  return grasp.slip_rate_m_per_s_n() * std::max(0.0, load - grasp.slip_force_n());
}

bool slipped_out(const pb::Grasp& grasp, double slip) {
  return grasp.loss_slip_m() > 0 && slip >= grasp.loss_slip_m();
}

}  // namespace omentum
