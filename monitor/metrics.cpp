#include "monitor/metrics.h"

#include <fmt/core.h>

#include <cmath>
#include <functional>
#include <string_view>

namespace omentum {
namespace {

/// Inside double quotes of a label.
std::string escaped(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\' || c == '"') out += '\\';
    if (c == '\n') {
      out += "\\n";
    } else {
      out += c;
    }
  }
  return out;
}

std::string number(double value) {
  if (std::isnan(value)) return "NaN";
  if (std::isinf(value)) return value > 0 ? "+Inf" : "-Inf";
  return fmt::format("{}", value);
}

class Exposition {
 public:
  explicit Exposition(const RunState& state, std::int64_t now_ns)
      : state_(state), now_ns_(now_ns), run_(escaped(state.run())) {}

  void head(const std::string& name, const char* type, const char* help) {
    text_ += fmt::format("# HELP {} {}\n# TYPE {} {}\n", name, help, name, type);
  }
  void line(const std::string& name, double value, const std::string& labels = "") {
    text_ += fmt::format("{}{{run=\"{}\"{}}} {}\n", name, run_, labels, number(value));
  }
  void value(const std::string& name, const char* type, const char* help, double value) {
    head(name, type, help);
    line(name, value);
  }
  /// One line per worker.
  void workers(const std::string& name, const char* type, const char* help,
               const std::function<double(const WorkerRow&)>& value_of) {
    if (state_.workers().empty()) return;
    head(name, type, help);
    for (const auto& [id, row] : state_.workers()) line(name, value_of(row), labels_of(row));
  }
  static std::string labels_of(const WorkerRow& row) {
    return fmt::format(",worker=\"{}\",host=\"{}\"", row.status.worker_id,
                       escaped(row.status.host));
  }
  const RunState& state() const { return state_; }
  std::int64_t now_ns() const { return now_ns_; }
  std::string take() { return std::move(text_); }

 private:
  const RunState& state_;
  std::int64_t now_ns_;
  std::string run_, text_;
};

double count(std::uint64_t value) { return static_cast<double>(value); }

void add_ledger(Exposition& out, const LearnerStatus& l) {
  for (const LedgerCounter& counter : kLedgerCounters) {
    if (counter.value == &Ledger::evaluated || counter.value == &Ledger::failed) continue;
    const bool gauge = counter.value == &Ledger::outstanding;
    out.value(fmt::format("omentum_ledger_{}{}", counter.name, gauge ? "" : "_total"),
              gauge ? "gauge" : "counter", "Grants and segments by fate (docs/wire.md 4.3)",
              count(l.*counter.value));
  }
  out.value("omentum_ledger_balanced", "gauge", "1 when every grant and segment has one fate",
            balance_of(l).balanced() ? 1 : 0);
}

void add_learner(Exposition& out) {
  const RunState& state = out.state();
  out.value("omentum_learner_up", "gauge", "1 while the learner speaks",
            state.learner_presence(out.now_ns()) == Presence::kAlive ? 1 : 0);
  if (!state.learner()) return;
  const LearnerStatus& l = *state.learner();
  out.head("omentum_learner_phase", "gauge", "1 for the phase the learner is in");
  for (auto p = LearnerPhase::kWaiting; p <= LearnerPhase::kDone;
       p = static_cast<LearnerPhase>(static_cast<std::uint32_t>(p) + 1)) {
    out.line("omentum_learner_phase", l.phase == p ? 1 : 0,
             fmt::format(",phase=\"{}\"", name_of(p)));
  }
  const auto gauge = [&out](const char* name, const char* help, double value) {
    out.value(fmt::format("omentum_learner_{}", name), "gauge", help, value);
  };
  gauge("epoch", "Session of the learner, grows with every start", l.learner_epoch);
  gauge("policy_version", "Finished updates", count(l.policy_version));
  gauge("steps", "Steps of the run so far; a resume goes back to its checkpoint",
        count(l.steps_total));
  gauge("steps_wanted", "Steps of the whole run", count(l.steps_wanted));
  gauge("steps_per_second", "Steps taken in per second", l.steps_per_s);
  gauge("received_bytes_per_second", "Of segments", l.bytes_up_per_s);
  gauge("sent_bytes_per_second", "Of tasks and weights", l.bytes_down_per_s);
  gauge("oldest_task_age_seconds", "Age of the oldest grant alive", l.oldest_task_age_s);
  gauge("workers", "Workers that the learner holds for alive", l.workers_alive);
  gauge("barred_workers", "Workers that get no task for a while",
        count(l.barred_worker_ids.size()));
  gauge("mean_return", "Of the episodes that ended in the last batch", l.mean_return);
  gauge("mean_length_steps", "Of the episodes that ended in the last batch", l.mean_length);
  gauge("approx_kl", "Of the last update", l.approx_kl);
  gauge("entropy", "Of the policy, last update", l.entropy);
  gauge("explained_variance", "Of the critic, last update", l.explained_variance);
  gauge("alarms", "Alarms of the learner that hold now", count(l.alarms.size()));
  out.value("omentum_learner_alarms_raised_total", "counter", "Since the learner's start",
            count(l.alarms_raised));
  add_ledger(out, l);
}

void add_workers(Exposition& out) {
  const RunState& state = out.state();
  const std::int64_t now = out.now_ns();
  out.workers("omentum_worker_up", "gauge", "1 while the worker speaks", [now](const auto& row) {
    return RunState::presence_of(row, now) == Presence::kAlive ? 1.0 : 0.0;
  });
  out.workers("omentum_worker_version_lag", "gauge", "Policy versions behind the learner",
              [&state](const auto& row) { return count(version_lag(state, row.status)); });
  const auto add = [&out](const char* name, const char* type, const char* help, auto value_of) {
    out.workers(
        fmt::format("omentum_worker_{}", name), type, help,
        [value_of](const WorkerRow& row) { return static_cast<double>(value_of(row.status)); });
  };
  using W = WorkerStatus;
  constexpr const char* kGauge = "gauge";
  constexpr const char* kCounter = "counter";
  add("lanes", kGauge, "Environments side by side", [](const W& w) { return w.lanes; });
  add("tasks", kGauge, "Tasks in progress", [](const W& w) { return w.tasks_in_progress; });
  add("steps_per_second", kGauge, "Steps per second", [](const W& w) { return w.steps_per_s; });
  add("simulating_ratio", kGauge, "Share of the time spent in physics",
      [](const W& w) { return w.sim_time_fraction; });
  add("receive_buffer_bytes", kGauge, "Usable bytes of a UDP socket",
      [](const W& w) { return w.socket_receive_buffer_bytes; });
  add("alarms", kGauge, "Alarms that hold now", [](const W& w) { return w.alarms.size(); });
  add("warnings", kGauge, "Warnings told now", [](const W& w) { return w.warnings.size(); });
  add("steps_total", kCounter, "Steps since its start", [](const W& w) { return w.steps; });
  add("tasks_received_total", kCounter, "Grants", [](const W& w) { return w.tasks_received; });
  add("tasks_declined_total", kCounter, "Grants refused, for whatever reason", [](const W& w) {
    return w.tasks_declined_no_weights + w.tasks_declined_config + w.tasks_declined_state +
           w.tasks_declined_epoch;
  });
  add("tasks_abandoned_total", kCounter, "Grants given up",
      [](const W& w) { return w.tasks_abandoned; });
  add("segments_published_total", kCounter, "Results",
      [](const W& w) { return w.segments_published; });
  add("frames_published_total", kCounter, "Live frames",
      [](const W& w) { return w.frames_published; });
  add("write_timeouts_total", kCounter, "Writes that readers held up",
      [](const W& w) { return w.write_timeouts; });
  add("rexmit_bytes_total", kCounter, "Bytes sent again",
      [](const W& w) { return w.rexmit_bytes; });
  add("throttled_seconds_total", kCounter, "Time in which readers held writes up",
      [](const W& w) { return 1e-9 * static_cast<double>(w.time_throttle_ns); });
  add("alarms_raised_total", kCounter, "Since its start",
      [](const W& w) { return w.alarms_raised; });
}

void add_robots(Exposition& out) {
  const RunState& state = out.state();
  const std::int64_t now = out.now_ns();
  const auto add = [&](const char* name, const char* type, const char* help, auto value_of) {
    if (state.robots().empty()) return;
    const std::string full = fmt::format("omentum_robot_{}", name);
    out.head(full, type, help);
    for (const auto& [id, row] : state.robots()) {
      out.line(full, static_cast<double>(value_of(row)),
               fmt::format(",robot=\"{}\",host=\"{}\"", escaped(row.status.robot),
                           escaped(row.status.host)));
    }
  };
  using R = RobotRow;
  constexpr const char* kGauge = "gauge";
  constexpr const char* kCounter = "counter";
  add("up", kGauge, "1 while the gateway speaks", [now](const R& row) {
    return RunState::presence_of(row, now) == Presence::kAlive ? 1.0 : 0.0;
  });
  add("armed", kGauge, "1 while goals are sent", [](const R& r) { return r.status.armed; });
  add("reason", kGauge, "Why it is stopped or not ready (docs/dvrk.md 7.3), 0: nothing",
      [](const R& r) { return r.status.reason; });
  add("latency_max_seconds", kGauge, "Of the last second, begin of a period to command",
      [](const R& r) { return 1e-3 * r.status.latency_max_ms; });
  add("jitter_max_seconds", kGauge, "Of the last second",
      [](const R& r) { return 1e-3 * r.status.jitter_max_ms; });
  add("state_age_max_seconds", kGauge, "Of the last second",
      [](const R& r) { return 1e-3 * r.status.state_age_max_ms; });
  add("stops_total", kCounter, "Stops, refused goals among them",
      [](const R& r) { return r.status.stops; });
  add("datagrams_total", kCounter, "Taken", [](const R& r) { return r.status.datagrams; });
  add("datagrams_refused_total", kCounter, "Malformed, foreign or cut",
      [](const R& r) { return r.status.malformed + r.status.foreign + r.status.cut; });
  add("commands_sent_total", kCounter, "To the robot", [](const R& r) { return r.status.sent; });
  add("periods_missed_total", kCounter, "Did not take place",
      [](const R& r) { return r.status.missed; });
  add("episodes_total", kCounter, "That ended", [](const R& r) { return r.status.episodes; });
}

}  // namespace

std::string make_metrics(const RunState& state, std::int64_t now_ns) {
  Exposition out(state, now_ns);
  add_learner(out);
  add_workers(out);
  add_robots(out);
  out.value("omentum_episodes_seen_total", "counter", "Episodes told since the monitor's start",
            count(state.episodes()));
  out.value("omentum_targets_reached_seen_total", "counter", "Those that reached their target",
            count(state.targets_reached()));
  out.value("omentum_alarms", "gauge", "Alarms that hold now, of all and of the monitor itself",
            count(alarms_of(state, now_ns).size()));
  return out.take();
}

}  // namespace omentum
