#pragma once

#include <string>

namespace omentum {

/// Why the arm is not armed, or no longer (docs/dvrk.md 7.3). Values reach recordings and the bus:
/// add at the end, change none.
enum class StopReason : int {
  kNone = 0,
  // Before arming alone.
  kNothingReceived = 1,
  kOldShapes = 2,
  kStreamMissing = 3,
  kNoRegistration = 4,
  // The operator and the gateway itself.
  kOperatorStop = 5,
  kDeadManReleased = 6,
  kGatewayFault = 7,
  kClockBackward = 8,
  kTickLate = 9,
  // What the robot tells.
  kForeignSource = 10,
  kTimestampBackward = 11,
  kStale = 12,
  kFault = 13,
  kNotEnabled = 14,
  kNotHomed = 15,
  kBusy = 16,
  kInvalid = 17,
  kJointCount = 18,
  kNotOrthonormal = 19,
  kWrongInstrument = 20,
  kBaseFrame = 21,
  kInCannula = 22,
  kSetpointApart = 23,
  kTracking = 24,
  kEffort = 25,
  // What the policy asks.
  kPolicyLate = 26,
  kNotFinite = 27,
  kRotation = 28,
  kFeedForward = 29,
  kOutsideBox = 30,
  kUnreachable = 31,
  kJointLimit = 32,
  kCannula = 33,
  kStep = 34,
  kJointStep = 35,
  kJump = 36,
  kTooFast = 37,
  kSetpointVelocity = 38,  // before arming alone
  kCommandsLost = 39,      // what becomes of the goals
  kNotChecked = 40,        // before arming alone
  kNoWay = 41,             // before arming alone
};
inline constexpr int kStopReasons = 41;  ///< without kNone: 1 ... 41

/// It stands in the way of arming, and no armed arm is stopped for it.
constexpr bool is_before_arming_alone(StopReason reason) {
  return (reason > StopReason::kNone && reason <= StopReason::kNoRegistration) ||
         reason == StopReason::kSetpointVelocity || reason == StopReason::kNotChecked ||
         reason == StopReason::kNoWay;
}

/// FAULT, STALE, OUTSIDE_BOX: for recordings and counters. Aborts for a number that is no reason,
/// as a stranger may send: compare with kStopReasons first.
const char* stop_reason_name(StopReason reason);

/// A reason with its figures.
struct Finding {
  StopReason reason = StopReason::kNone;
  double value = 0;    ///< what was found; unit by the reason
  double allowed = 0;  ///< and its bound
  /// Which stream (index into stream_name), axis of W (0 x, 1 y, 2 z) or joint; -1 where none.
  int part = -1;

  explicit operator bool() const { return reason != StopReason::kNone; }
};

/// Streams in the order of Finding::part; setpoint_js, which is looked at before arming alone, is
/// behind them.
inline constexpr int kStreams = 6;
inline constexpr int kSetpointStream = kStreams;
const char* stream_name(int part);

/// One line for the operator: what, with figures and unit, and what to do.
std::string describe(const Finding& finding);

}  // namespace omentum
