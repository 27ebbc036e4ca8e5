#include "dvrk_gateway/safety/stop_reason.h"

#include <fmt/format.h>

#include <array>

#include "core/check.h"
#include "core/psm_instrument.h"
#include "dvrk_gateway/protocol/robot_state.h"

namespace omentum {
namespace {

/// `text` may use {value}, {allowed}, {stream}, {axis} and {joint}.
struct Text {
  StopReason reason;
  const char* name;
  const char* text;
};

constexpr std::array<Text, kStopReasons + 1> kTexts = {{
    {StopReason::kNone, "NONE", "nothing"},
    {StopReason::kNothingReceived, "NOTHING_RECEIVED",
     "no datagram of a robot yet: does its streamer send to this port?"},
    {StopReason::kOldShapes, "OLD_SHAPES",
     "the robot sends GetState* alone, without poses and state: install the streamer file of "
     "deploy/dvrk"},
    {StopReason::kStreamMissing, "STREAM_MISSING",
     "stream {stream} was never received: add it to the read-commands of the streamer"},
    {StopReason::kNoRegistration, "NO_REGISTRATION",
     "no registration: where the robot stands in W is not known"},
    {StopReason::kOperatorStop, "OPERATOR_STOP", "the operator stopped"},
    {StopReason::kDeadManReleased, "DEAD_MAN_RELEASED",
     "key or pedal not held for {value:.3g} s, allowed {allowed:.3g} s"},
    {StopReason::kGatewayFault, "GATEWAY_FAULT", "the gateway itself cannot go on, see its log"},
    {StopReason::kClockBackward, "CLOCK_BACKWARD", "the clock went back by {value:.3g} s"},
    {StopReason::kTickLate, "TICK_LATE",
     "the gateway stood still for {value:.3g} s, allowed {allowed:.3g} s"},
    {StopReason::kForeignSource, "FOREIGN_SOURCE",
     "datagrams of another sender: {value:.0f} so far"},
    {StopReason::kTimestampBackward, "TIMESTAMP_BACKWARD",
     "Timestamp went back: the robot's process was started anew"},
    {StopReason::kStale, "STALE",
     "stream {stream} stands still for {value:.3g} s, allowed {allowed:.3g} s: its datagrams get "
     "lost on the network, or the robot sends no new ones"},
    {StopReason::kFault, "FAULT", "the robot is in FAULT: clear it at its console"},
    {StopReason::kNotEnabled, "NOT_ENABLED", "the robot is not ENABLED: power it at its console"},
    {StopReason::kNotHomed, "NOT_HOMED", "the robot is not homed: home it at its console"},
    {StopReason::kBusy, "BUSY", "the robot is busy with a motion that is not ours"},
    {StopReason::kInvalid, "INVALID", "stream {stream} is not valid"},
    {StopReason::kJointCount, "JOINT_COUNT",
     "stream {stream} has {value:.0f} entries, needed {allowed:.0f}"},
    {StopReason::kNotOrthonormal, "NOT_ORTHONORMAL",
     "rotation of {stream} is not orthonormal by {value:.3g}, allowed {allowed:.3g}"},
    {StopReason::kWrongInstrument, "WRONG_INSTRUMENT",
     "local/measured_cp is {value:.3g} m from the pose of measured_js: another instrument or arm"},
    {StopReason::kBaseFrame, "BASE_FRAME",
     "measured_cp is {value:.3g} m from local/measured_cp in the base frame given, allowed "
     "{allowed:.3g} m: is the base frame of the console another?"},
    {StopReason::kInCannula, "IN_CANNULA",
     "wrist-pitch axis {value:.4g} m from the remote centre, needed {allowed:.4g} m: insert the "
     "instrument past the cannula"},
    {StopReason::kSetpointApart, "SETPOINT_APART",
     "setpoint_cp is {value:.3g} m from the last goals, allowed {allowed:.3g} m: clipped, lost, or "
     "another client moves the arm"},
    {StopReason::kTracking, "TRACKING",
     "measured_cp is {value:.3g} m from setpoint_cp, allowed {allowed:.3g} m: something is in the "
     "way"},
    {StopReason::kEffort, "EFFORT",
     "effort of {joint} is {value:.3g}, allowed {allowed:.3g} N m (N): something is in the way"},
    {StopReason::kPolicyLate, "POLICY_LATE", "no action of the policy for {value:.0f} periods"},
    {StopReason::kNotFinite, "NOT_FINITE", "the goal is not finite"},
    {StopReason::kRotation, "ROTATION",
     "rotation of the goal is not orthonormal by {value:.3g}, allowed {allowed:.3g}"},
    {StopReason::kFeedForward, "FEED_FORWARD",
     "velocity of the goal is {value:.3g}, allowed {allowed:.3g}: goals are places to rest at"},
    {StopReason::kOutsideBox, "OUTSIDE_BOX",
     "tip at {axis}_W = {value:.5g} m, the workspace ends at {allowed:.5g} m"},
    {StopReason::kUnreachable, "UNREACHABLE",
     "no joints reach a goal {value:.3g} m from the remote centre"},
    {StopReason::kJointLimit, "JOINT_LIMIT",
     "joint {joint} at {value:.5g}, allowed to {allowed:.5g}"},
    {StopReason::kCannula, "CANNULA",
     "goal with the wrist-pitch axis {value:.4g} m from the remote centre, allowed {allowed:.4g} "
     "m"},
    {StopReason::kStep, "STEP", "step of {value:.3g} m along {axis}_W, allowed {allowed:.3g} m"},
    {StopReason::kJointStep, "JOINT_STEP",
     "step of {value:.3g} of joint {joint}, allowed {allowed:.3g} rad (m)"},
    {StopReason::kJump, "JUMP",
     "goal {value:.3g} m from setpoint_cp along {axis}_W, allowed {allowed:.3g} m"},
    {StopReason::kTooFast, "TOO_FAST",
     "goals follow each other after {value:.3g} s, the period is {allowed:.3g} s"},
    {StopReason::kSetpointVelocity, "SETPOINT_VELOCITY",
     "the set-point of {joint} has a velocity of {value:.3g} rad/s (m/s): another client gave it "
     "one, which stays until it is taken back; end that client, then hold the arm at its console"},
    {StopReason::kCommandsLost, "COMMANDS_LOST",
     "the set-point is still where it was {value:.0f} goals ago: commands get lost on the network, "
     "or the robot no longer takes them"},
    {StopReason::kNotChecked, "NOT_CHECKED",
     "the instrument could not be checked yet: measured_js, measured_cp and local/measured_cp of "
     "one Timestamp are needed"},
    {StopReason::kNoWay, "NO_WAY",
     "no way inside box and joint limits leads from here to the start: at the console turn "
     "{joint} from {value:.3g} towards {allowed:.3g} rad (m), or bring the tip elsewhere"},
}};

/// NOT_ENABLED where the robot says PAUSED.
constexpr const char* kPaused = "the robot is PAUSED: resume it at its console";

/// STALE of no stream in particular.
constexpr const char* kSilent =
    "nothing came from the robot for {value:.3g} s, allowed {allowed:.3g} s: it has ended, the "
    "network "
    "is cut or loses most of its datagrams, or another client spoke to it and took the stream";

const Text& text_of(StopReason reason) {
  const auto at = static_cast<std::size_t>(reason);
  OMENTUM_CHECK(at < kTexts.size() && kTexts[at].reason == reason, "reason {}", at);
  return kTexts[at];
}

}  // namespace

const char* stop_reason_name(StopReason reason) { return text_of(reason).name; }

const char* stream_name(int part) {
  constexpr std::array<const char*, kStreams + 1> kNames = {
      "measured_js",     "measured_cp",     "setpoint_cp", "local/measured_cp",
      "jaw/measured_js", "operating_state", "setpoint_js"};
  return part >= 0 && part <= kStreams ? kNames[static_cast<std::size_t>(part)] : "";
}

std::string describe(const Finding& finding) {
  constexpr std::array<const char*, 3> kAxes = {"x", "y", "z"};
  const auto part = static_cast<std::size_t>(finding.part);
  const char* text = text_of(finding.reason).text;
  if (finding.reason == StopReason::kStale && finding.part < 0) text = kSilent;
  constexpr auto kPausedState = static_cast<int>(OperatingState::State::kPaused);
  if (finding.reason == StopReason::kNotEnabled && finding.value == kPausedState) text = kPaused;
  return fmt::format(
      fmt::runtime(text), fmt::arg("value", finding.value), fmt::arg("allowed", finding.allowed),
      fmt::arg("stream", stream_name(finding.part)), fmt::arg("axis", part < 3 ? kAxes[part] : ""),
      fmt::arg("joint", part < 6 ? large_needle_driver().limits[part].name : ""));
}

}  // namespace omentum
