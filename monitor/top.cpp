#include "monitor/top.h"

#include <fmt/core.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "core/clock.h"
#include "core/printable.h"
#include "monitor/robot_figures.h"
#include "monitor/run_watch.h"

namespace omentum {
namespace {

/// A word within a line.
std::string shown(const std::string& text) {
  std::string line = printable(text);
  std::replace(line.begin(), line.end(), '\n', '?');
  return line;
}

void add_learner(std::string& out, const RunState& state, std::int64_t now_ns) {
  if (!state.learner()) {
    out += "learner    none has spoken yet\n";
    return;
  }
  const LearnerStatus& l = *state.learner();
  const std::optional<double> left = seconds_left(l);
  out += fmt::format("learner    {} ({}), epoch {}, policy {}\n", name_of(l.phase),
                     name_of(state.learner_presence(now_ns)), l.learner_epoch, l.policy_version);
  out += l.steps_wanted == 0
             ? fmt::format("progress   {} steps, {:.0f} steps/s\n", l.steps_total, l.steps_per_s)
             : fmt::format("progress   {} of {} steps, {:.1f} %, {:.0f} steps/s, {} left\n",
                           l.steps_total, l.steps_wanted, 100 * share_done(l), l.steps_per_s,
                           left ? short_duration(*left) : "unknown time");
  out += fmt::format(
      "learning   return {:.3f}, length {:.0f}, KL {:.4f}, entropy {:.3f}, "
      "explained variance {:.2f}\n",
      l.mean_return, l.mean_length, l.approx_kl, l.entropy, l.explained_variance);
  out += "ledger    ";
  for (const LedgerCounter& counter : kLedgerCounters) {
    if (counter.value == &Ledger::evaluated || counter.value == &Ledger::failed) continue;
    out += fmt::format(" {} {}", counter.name, l.*counter.value);
  }
  const LedgerBalance balance = balance_of(l);
  out += balance.balanced()
             ? "\nbalance    ok\n"
             : fmt::format("\nbalance    WRONG: received off by {}, granted off by {}\n",
                           balance.received, balance.granted);
}

void add_workers(std::string& out, const RunState& state, std::int64_t now_ns) {
  out += fmt::format("\n{:>10} {:<20} {:>8} {:<11} {:>9} {:>5} {:>5} {:>5} {}\n", "worker", "host",
                     "pid", "phase", "steps/s", "lag", "lanes", "tasks", "warnings");
  for (const auto& [id, row] : state.workers()) {
    const WorkerStatus& w = row.status;
    const Presence presence = RunState::presence_of(row, now_ns);
    std::string warnings;
    for (const std::string& warning : w.warnings)
      warnings += (warnings.empty() ? "" : "; ") + shown(warning);
    out +=
        fmt::format("{:>10} {:<20} {:>8} {:<11} {:>9.0f} {:>5} {:>5} {:>5} {}\n", id,
                    shown(w.host).substr(0, 20), w.pid,
                    presence == Presence::kAlive ? name_of(w.phase) : name_of(presence),
                    w.steps_per_s, version_lag(state, w), w.lanes, w.tasks_in_progress, warnings);
  }
  if (state.workers().empty()) out += "           none\n";
}

void add_robots(std::string& out, const RunState& state, std::int64_t now_ns) {
  for (const auto& [id, row] : state.robots()) {
    out += fmt::format("\nrobot      {}\n", shown(describe_robot(row, now_ns)));
    for (const RobotFigure& figure : robot_figures(row.status))
      out += fmt::format("  {:<9}{}\n", figure.name, shown(figure.text));
  }
}

}  // namespace

std::string short_duration(double seconds) {
  if (!std::isfinite(seconds) || seconds < 0 || seconds > 1e9) return "unknown time";
  const auto total = static_cast<long>(std::lround(seconds));
  if (total < 60) return fmt::format("{} s", total);
  if (total < 3600) return fmt::format("{} min {} s", total / 60, total % 60);
  if (total < 86400) return fmt::format("{} h {} min", total / 3600, total % 3600 / 60);
  return fmt::format("{} d {} h", total / 86400, total % 86400 / 3600);
}

std::string make_top_table(const RunState& state, std::int64_t now_ns) {
  std::string out = fmt::format("run        {}\n", state.run());
  add_learner(out, state, now_ns);
  add_workers(out, state, now_ns);
  add_robots(out, state, now_ns);
  const std::vector<std::string> alarms = alarms_of(state, now_ns);
  out += alarms.empty() ? "\nalarms     none\n" : "\nalarms\n";
  for (const std::string& alarm : alarms) out += "  " + shown(alarm) + "\n";
  return out;
}

int run_top(const TopOptions& options) {
  catch_stop_signals();
  RunLink link(options.tool, "omentum-top", false);
  if (!link.join()) return 0;
  RunState state(options.tool.run);
  const std::string nobody =
      fmt::format("\nnobody of run {} speaks on domain {}; another one: --domain N\n",
                  options.tool.run, options.tool.domain);
  const bool once = options.once || isatty(STDOUT_FILENO) == 0;
  const auto interval = static_cast<std::int64_t>(1e9 * options.interval_s);
  const std::int64_t began = steady_now_ns();
  std::int64_t heard_at = 0, drawn_at = 0;
  while (!stop_requested()) {
    // Short, since a signal does not wake the wait set.
    link.watch().wait(100'000'000);
    link.watch().take_into(state);
    const std::int64_t now = steady_now_ns();
    if (link.is_deaf(state, now)) {
      link.leave();
      if (!link.join()) return 0;
    }
    // Workers that simulate recordings have no learner.
    const bool simulated = std::ranges::any_of(state.workers(), [](const auto& entry) {
      return entry.second.status.phase == WorkerPhase::kCollecting;
    });
    const bool heard = state.learner() || !state.robots().empty() || simulated;
    if (heard && heard_at == 0) heard_at = now;
    if (once) {
      // Workers publish at least once a second: so long after the learner everybody has spoken.
      const bool complete = heard_at != 0 && now - heard_at > 1'500'000'000;
      if (!complete && seconds_since(began) < options.patience_s) continue;
      std::fputs((make_top_table(state, now) + (heard ? "" : nobody)).c_str(), stdout);
      return heard ? 0 : 1;
    }
    if (now - drawn_at < interval) continue;
    drawn_at = now;
    // Home, the table, and nothing below it; lines are cleared first as they may have been longer.
    fmt::print("\x1b[H\x1b[J{}{}\n(Ctrl-C ends)\n", make_top_table(state, now),
               heard ? "" : nobody);
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace omentum
