#include "dvrk_gateway/dvrk_double/dvrk_double.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>

#include "core/check.h"

namespace omentum {
namespace {

void require_stream(const char* option, const std::string& name) {
  if (name.empty() ||
      std::find(kStreamNames.begin(), kStreamNames.end(), name) != kStreamNames.end())
    return;
  throw_error("{} {}: allowed {}", option, name, fmt::join(kStreamNames, ", "));
}

constexpr double kNotFinite = std::numeric_limits<double>::quiet_NaN();

void spoil(JointState& joints) { joints.position.fill(kNotFinite); }
void spoil(CartesianPose& pose) { pose.translation.setConstant(kNotFinite); }
/// A goal of a client in A.
void turn_to_R(const Eigen::Isometry3d& X_RA, std::optional<CartesianGoal>& goal) {
  if (!goal) return;
  goal->rotation = X_RA.linear() * goal->rotation;
  goal->translation = X_RA * goal->translation;
  goal->velocity = X_RA.linear() * goal->velocity;
  goal->angular_velocity = X_RA.linear() * goal->angular_velocity;
}

void keep(std::optional<JointGoal>& said, JointGoal& kept) {
  if (!said) return;
  if (said->velocity_count > 0) {
    kept.velocity_count = said->velocity_count;
    kept.velocity = said->velocity;
  }
  said->velocity_count = kept.velocity_count;
  said->velocity = kept.velocity;
}

void keep(std::optional<CartesianGoal>& said, CartesianGoal& kept) {
  if (!said) return;
  if (said->has_velocity) kept.velocity = said->velocity;
  if (said->has_angular_velocity) kept.angular_velocity = said->angular_velocity;
  said->velocity = kept.velocity;
  said->angular_velocity = kept.angular_velocity;
}

void spoil(OperatingState& state) { state.timestamp_s = kNotFinite; }

}  // namespace

DvrkDouble::DvrkDouble(const DoubleOptions& options, const pb::ArmEffects& effects,
                       const ToolMount& mount, const UdpAddress& destination)
    : options_(options),
      has_base_frame_(!options.X_AR.matrix().isIdentity(0)),
      arm_(effects, mount, options.hardware_like),
      destination_(destination) {
  require_stream("--missing", options.missing_stream);
  require_stream("--invalid", options.invalid_stream);
  require_stream("--not-finite", options.not_finite_stream);
}

void DvrkDouble::period(std::int64_t now_ns, Link& link) {
  constexpr std::int64_t kSecond_ns = 1'000'000'000;
  if (options_.home_at_s >= 0 && !homing_asked_ &&
      static_cast<double>(now_ns) * 1e-9 >= options_.home_at_s) {
    homing_asked_ = true;
    arm_.power();
    arm_.home();
  }
  // now_ns / 1e9 * 1500 in whole numbers that do not overflow.
  const std::int64_t due = now_ns / kSecond_ns * RobotArm::kTicksPerSecond +
                           now_ns % kSecond_ns * RobotArm::kTicksPerSecond / kSecond_ns;
  for (; ticks_ < due; ++ticks_) arm_.tick();
  send_all(link);
  receive_all(link);
}

void DvrkDouble::send(std::string_view datagram, Link& link) {
  if (silent_) return;
  const bool gone = link.send(datagram, destination_) == SendOutcome::kSent;
  ++(gone ? sent_ : not_sent_);
}

template <typename Payload>
void DvrkDouble::send_stream(std::string_view name, Payload payload, Link& link) {
  if (name == options_.missing_stream) return;
  if (name == options_.invalid_stream) payload.valid = false;
  if (name == options_.not_finite_stream) spoil(payload);
  if (payload.timestamp_s > 0)
    payload.timestamp_s = std::max(0.0, payload.timestamp_s - timestamp_origin_s_);
  std::array<char, 1024> memory{};
  const std::string_view text(memory.data(), encode_stream(name, payload, memory));
  OMENTUM_CHECK(!text.empty(), "{} does not fit", name);
  if (options_.shape == DoubleOptions::Shape::kAllInOne) {
    // Without the outer braces and the end of line.
    burst_ += burst_.empty() ? "{" : ",";
    burst_ += text.substr(1, text.size() - 3);
  } else {
    send(text, link);
  }
}

/// Where there is no base frame every bit stays as it is.
CartesianPose DvrkDouble::in_A(CartesianPose pose_R) const {
  if (!has_base_frame_ || !pose_R.valid) return pose_R;
  pose_R.rotation = options_.X_AR.linear() * pose_R.rotation;
  pose_R.translation = options_.X_AR * pose_R.translation;
  return pose_R;
}

void DvrkDouble::send_all(Link& link) {
  const std::vector<OperatingState> events = arm_.take_events();
  if (options_.shape == DoubleOptions::Shape::k2019) {
    std::array<char, 2048> memory{};
    const std::size_t size = encode_old_shape(arm_.jaw_measured_js(), arm_.measured_js(), memory);
    return send({memory.data(), size}, link);
  }
  if (options_.shape == DoubleOptions::Shape::kToday) {
    for (const OperatingState& event : events) send_stream("operating_state", event, link);
  }
  burst_.clear();
  send_stream(kStreamNames[0], arm_.jaw_measured_js(), link);
  send_stream(kStreamNames[1], arm_.jaw_setpoint_js(), link);
  send_stream(kStreamNames[2], arm_.measured_cp(), link);
  send_stream(kStreamNames[3], in_A(arm_.measured_cp()), link);
  send_stream(kStreamNames[4], arm_.measured_js(), link);
  send_stream(kStreamNames[5], arm_.operating_state(), link);
  send_stream(kStreamNames[6], in_A(arm_.setpoint_cp()), link);
  send_stream(kStreamNames[7], arm_.setpoint_js(), link);
  if (!burst_.empty()) send(burst_ + "}\n", link);
}

/// The streamer reads each command into one object that lasts: what a datagram leaves out keeps its
/// value, also where the arm did not take the command (docs/dvrk.md 4.3).
void DvrkDouble::fill_in(CommandDatagram& commands) {
  keep(commands.jaw_move_jp, kept_fields_.jaw_move_jp);
  keep(commands.jaw_servo_jp, kept_fields_.jaw_servo_jp);
  keep(commands.move_cp, kept_fields_.move_cp);
  keep(commands.move_jp, kept_fields_.move_jp);
  keep(commands.servo_cp, kept_fields_.servo_cp);
  keep(commands.servo_jp, kept_fields_.servo_jp);
}

/// Everything that waits. As the robot's own receiver: 1024 bytes, an empty datagram ends it for
/// this period, and what cannot be parsed runs the commands before it again (docs/dvrk.md 4.3).
void DvrkDouble::receive_all(Link& link) {
  std::array<char, 1024> memory{};
  CommandDatagram kept;
  while (const auto received = link.receive(memory)) {
    destination_ = received->source;
    ++received_;
    if (received->size == 0) return;
    if (received->cut) ++cut_;
    CommandDatagram commands = decode_commands({memory.data(), received->size});
    fill_in(commands);
    if (has_base_frame_) {
      turn_to_R(options_.X_AR.inverse(), commands.move_cp);
      turn_to_R(options_.X_AR.inverse(), commands.servo_cp);
    }
    if (!commands.whole) arm_.refuse(Refusal::kNotJson);
    for (int k = 0; k < commands.unknown_keys; ++k) arm_.refuse(Refusal::kUnknownKey);
    if (commands.whole || commands.known_keys > 0) kept = commands;
    arm_.command(kept);
  }
}

}  // namespace omentum
