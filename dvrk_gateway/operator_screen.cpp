#include "dvrk_gateway/operator_screen.h"

#include <fmt/core.h>

#include <atomic>
#include <csignal>
#include <utility>

namespace omentum {
namespace {

// Taken in one step: a signal that arrives while the last is read is the next one.
std::atomic<bool> signal_arm = false, signal_stop = false, signal_end = false;
static_assert(std::atomic<bool>::is_always_lock_free);
void on_signal(int number) {
  if (number == SIGUSR1) signal_arm = true;
  if (number == SIGUSR2) signal_stop = true;
  if (number == SIGINT || number == SIGTERM) signal_end = true;
}

}  // namespace

void catch_operator_signals() {
  for (const int number : {SIGUSR1, SIGUSR2, SIGINT, SIGTERM}) std::signal(number, on_signal);
}

bool end_was_signalled() { return signal_end; }

OperatorWishes OperatorDesk::ask() {
  const char key = keys_.next(20).value_or('\0');
  OperatorWishes wishes;
  wishes.key = key;
  wishes.arm = signal_arm.exchange(false) || key == 'a';
  wishes.held = key == 'a' || key == 'h';  // a held key repeats
  wishes.stop = signal_stop.exchange(false) || key == ' ';
  wishes.acknowledge = key == 'k';
  wishes.end = signal_end || key == 'q';
  return wishes;
}

void OperatorScreen::on_period(const Period& period) {
  // Nothing is armed to teach, so it does not wait for the phase that tells of the keys.
  if (teaches_ && !std::exchange(told_keys_, true))
    fmt::print("press a to begin a demonstration, space to end it, q to end\n");
  const SafetyMemory& memory = period.judgement.memory;
  // Of a stop the first reason counts: behind it there is none.
  // Other senders are part of what describe() says.
  const bool others = period.robot.foreign > 0, moved = moved_to_another_port(period.robot);
  bool changed = memory.phase != phase_;
  if (phase_ != SafetyPhase::kStopped)
    changed |= period.judgement.finding.reason != reason_ || others != heard_others_;
  changed |= moved && !moved_;
  heard_others_ = others;
  moved_ = moved;
  phase_ = memory.phase;
  reason_ = period.judgement.finding.reason;
  if (!changed) return;
  if (ending_ && phase_ == SafetyPhase::kStopped && memory.stop.reason == StopReason::kOperatorStop)
    return;
  Finding finding = period.judgement.finding;
  if (!finding && moved) finding.reason = StopReason::kForeignSource;
  const std::string why = finding ? ": " + describe(finding, period.robot) : "";
  fmt::print("{}{}\n", safety_phase_name(phase_), why);
  if (phase_ == SafetyPhase::kReady && !teaches_) {
    fmt::print("{}press a to arm, space to stop, q to end\n",
               period.dry_run ? "dry run, nothing is sent to the robot: " : "");
  }
  if (phase_ == SafetyPhase::kActive && period.dry_run)
    fmt::print("dry run: a model of the arm moves, the robot does not\n");
  if (phase_ == SafetyPhase::kStopped) fmt::print("press k when you have seen why\n");
  std::fflush(stdout);
}

}  // namespace omentum
