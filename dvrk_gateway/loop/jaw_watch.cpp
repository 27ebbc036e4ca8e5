#include "dvrk_gateway/loop/jaw_watch.h"

#include <algorithm>

namespace omentum {

void JawWatch::on_period(const Period& period) {
  const double goal = period.judgement.memory.jaw;
  const JointState& jaw = period.robot.jaw_measured_js.payload;
  const JointState& sent = period.robot.jaw_setpoint_js.payload;
  const bool told = sent.valid && sent.count == 1;
  const bool shut = goal < closed_below_rad_ && jaw.valid && jaw.count == 1;
  still_ = shut && goal == goal_ ? still_ + 1 : 0;
  goal_ = goal;
  const double closes_to = told ? std::max(goal, sent.position[0]) : goal;
  holds_ = still_ >= kPeriods && jaw.position[0] - closes_to >= gap_rad_;
  if (holds_) held_ever_ = true;
}

}  // namespace omentum
