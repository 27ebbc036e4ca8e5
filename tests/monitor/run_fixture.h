#pragma once

#include <string>
#include <utility>

#include "core/clock.h"
#include "monitor/run_state.h"

namespace omentum::test {

template <typename Record>
Arrival<Record> arrived(Record record) {
  Arrival<Record> arrival{std::move(record), {}};
  arrival.info.valid = true;
  return arrival;
}

template <typename Record>
Arrival<Record> ended(Record record, dds::InstanceState state) {
  Arrival<Record> arrival{std::move(record), {}};
  arrival.info.state = state;
  return arrival;
}

/// A learner in the middle of a run, with a ledger that balances.
inline LearnerStatus some_learner() {
  LearnerStatus l;
  l.run_id = "fixture";
  l.learner_epoch = 7;
  l.policy_version = 12;
  l.phase = LearnerPhase::kUpdating;
  l.granted = 110;
  l.regranted = 3;
  l.received = 104;
  l.admitted = 100;
  l.duplicate = 2;
  l.stale = 1;
  l.invalid = 1;
  l.cancelled = 1;
  l.outstanding = 6;
  l.steps_total = 250'000;
  l.steps_wanted = 1'000'000;
  l.steps_per_s = 5000;
  l.mean_return = -0.5;
  l.mean_length = 320;
  return l;
}

inline WorkerStatus some_worker(std::uint32_t id) {
  WorkerStatus w;
  w.worker_id = id;
  w.host = "node" + std::to_string(id);
  w.pid = 4000 + id;
  w.lanes = 16;
  w.phase = WorkerPhase::kCollecting;
  w.learner_epoch = 7;
  w.policy_version = 11;
  w.tasks_in_progress = 16;
  w.steps_per_s = 1234;
  return w;
}

/// A robot that was stopped on its way.
inline RobotStatus some_robot() {
  RobotStatus r;
  r.gateway_id = 9;
  r.robot = "PSM1";
  r.host = "console";
  r.pid = 77;
  r.phase = RobotPhase::kStopped;
  r.reason = 34;
  r.reason_name = "STEP";
  r.reason_text = "step of 0.7 mm";
  r.operating_state = "ENABLED";
  r.is_homed = true;
  r.registered = true;
  r.measured_tip_in_world_m = {0.01, -0.02, 0.0305};
  r.latency_p50_ms = 0.21;
  r.latency_max_ms = 1.34;
  r.malformed = 3;
  r.stops = 2;
  r.refusals.assign(38, 0);
  r.refusal_names.assign(38, "OTHER");
  r.refusal_names[34] = "STEP";
  r.refusals[34] = 2;
  r.policy_version = 12;
  return r;
}

}  // namespace omentum::test
