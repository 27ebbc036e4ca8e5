#include "dvrk_gateway/protocol/codec.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "dvrk_gateway/protocol/json_text.h"
#include "dvrk_gateway/protocol/json_writer.h"
#include "dvrk_gateway/protocol/payload_fields.h"

namespace omentum {
namespace {

using State = OperatingState::State;

constexpr std::array<std::pair<State, const char*>, 5> kStateWords = {
    {{State::kUndefined, "UNDEFINED"},
     {State::kDisabled, "DISABLED"},
     {State::kEnabled, "ENABLED"},
     {State::kPaused, "PAUSED"},
     {State::kFault, "FAULT"}}};

State state_of(std::string_view word) {
  for (const auto& [state, name] : kStateWords) {
    if (word == name) return state;
  }
  return State::kUnknown;
}

/// What every payload has. A time that is absent, not finite or negative stays negative.
struct Stamp {
  double timestamp_s = -1;
  bool valid = false;
  bool automatic = false;

  /// Whether the field was one of these, and was read.
  bool take(JsonText& text, std::string_view field) {
    if (field == "Timestamp") return text.number(timestamp_s), true;
    if (field == "Valid") return text.boolean(valid), true;
    if (field == "AutomaticTimestamp") return text.boolean(automatic), true;
    return false;
  }
  bool has_time() const { return timestamp_s >= 0; }
};

/// Copies the stamp; `finite` says whether all other numbers were.
template <typename Payload>
void finish(Payload& payload, const Stamp& stamp, bool finite, int& not_finite) {
  const bool whole = finite && stamp.has_time();
  if (!whole) ++not_finite;
  payload.valid = stamp.valid && whole;
  payload.timestamp_s = stamp.has_time() ? stamp.timestamp_s : -1;
}

JointState read_joints(JsonText& text, int& not_finite) {
  JointState joints;
  Stamp stamp;
  bool finite = true;
  text.object([&](std::string_view field) {
    if (field == "Position") {
      joints.count = read_numbers(text, joints.position, finite);
    } else if (field == "Velocity") {
      joints.velocity_count = read_numbers(text, joints.velocity, finite);
    } else if (field == "Effort") {
      joints.effort_count = read_numbers(text, joints.effort, finite);
    } else if (!stamp.take(text, field)) {
      text.skip();
    }
  });
  const auto fits = [&](int count) { return count == 0 || count == joints.count; };
  if (!fits(joints.velocity_count) || !fits(joints.effort_count)) text.refuse();
  joints.automatic_timestamp = stamp.automatic;
  finish(joints, stamp, finite, not_finite);
  return joints;
}

CartesianPose read_pose(JsonText& text, int& not_finite, JsonText::Word& frame) {
  CartesianPose pose;
  Stamp stamp;
  bool finite = true;
  bool rotation = false;
  bool translation = false;
  text.object([&](std::string_view field) {
    if (field == "Position") {
      text.object([&](std::string_view part) {
        if (part == "Rotation") {
          rotation = read_rotation(text, pose.rotation, finite);
        } else if (part == "Translation") {
          translation = read_vector(text, pose.translation, finite);
        } else {
          text.skip();
        }
      });
    } else if (field == "ReferenceFrame") {
      if (!text.null()) text.word(frame);
    } else if (!stamp.take(text, field)) {
      text.skip();
    }
  });
  finish(pose, stamp, finite && rotation && translation, not_finite);
  return pose;
}

OperatingState read_operating_state(JsonText& text, int& not_finite) {
  OperatingState state;
  Stamp stamp;
  JsonText::Word word;
  text.object([&](std::string_view field) {
    if (field == "State") {
      text.word(word);
      state.state = state_of(word.text());
    } else if (field == "SubState") {
      text.word(word);
      state.sub_state = word.characters;
    } else if (field == "IsHomed") {
      text.boolean(state.is_homed);
    } else if (field == "IsBusy") {
      text.boolean(state.is_busy);
    } else if (!stamp.take(text, field)) {
      text.skip();
    }
  });
  finish(state, stamp, true, not_finite);
  return state;
}

/// Reads the payload of one key.
void read_stream(JsonText& text, std::string_view key, RobotDatagram& said) {
  ++said.known_keys;
  int& bad = said.not_finite;
  JsonText::Word frame;
  if (key == "measured_js") {
    said.measured_js = read_joints(text, bad);
  } else if (key == "setpoint_js") {
    said.setpoint_js = read_joints(text, bad);
  } else if (key == "jaw/measured_js") {
    said.jaw_measured_js = read_joints(text, bad);
  } else if (key == "jaw/setpoint_js") {
    said.jaw_setpoint_js = read_joints(text, bad);
  } else if (key == "measured_cp") {
    said.measured_cp = read_pose(text, bad, frame);
    said.reference_frame = frame.characters;
  } else if (key == "setpoint_cp") {
    said.setpoint_cp = read_pose(text, bad, frame);
  } else if (key == "local/measured_cp") {
    said.local_measured_cp = read_pose(text, bad, frame);
  } else if (key == "operating_state") {
    said.operating_state = read_operating_state(text, bad);
  } else if (key == "GetStateJoint" || key == "state_joint_current") {
    ++said.old_keys;
    said.measured_js = read_joints(text, bad);
  } else if (key == "GetStateJaw") {
    ++said.old_keys;
    said.jaw_measured_js = read_joints(text, bad);
  } else {
    --said.known_keys;
    ++said.unknown_keys;
    text.skip();
  }
}

template <typename Payload>
void keep(RobotState& state, Stream<Payload>& stream, const std::optional<Payload>& said,
          std::int64_t arrival_ns) {
  constexpr double kLatestReordering_s = 0.1;
  if (!said) return;
  const double held_s = stream.payload.timestamp_s;
  const bool timed = said->timestamp_s >= 0;
  const double behind_s = stream.seen && timed ? held_s - said->timestamp_s : 0;
  if (behind_s > kLatestReordering_s) {
    if (said->valid) {  // what is not may hold anything, as a robot's that forgot its homing
      ++state.restarts;
      state.newest_s = said->timestamp_s;
    }
  } else if (behind_s > 0) {
    ++state.reordered;
    return;
  }
  if (!stream.seen || (timed && said->timestamp_s != held_s)) stream.advanced_ns = arrival_ns;
  if (said->timestamp_s > state.newest_s) {
    if (state.newest_s > 0) state.gap_s = std::max(state.gap_s, said->timestamp_s - state.newest_s);
    state.newest_s = said->timestamp_s;
  }
  stream.payload = *said;
  if (!timed) stream.payload.timestamp_s = held_s;
  stream.seen = true;
  stream.arrival_ns = arrival_ns;
}

bool is_finite(const RobotCommand& command) {
  const auto all_finite = [](std::span<const double> values) {
    return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
  };
  return command.rotation.allFinite() && command.translation.allFinite() &&
         command.velocity.allFinite() && command.angular_velocity.allFinite() &&
         all_finite(command.joints) && all_finite(command.joint_velocity) &&
         std::isfinite(command.jaw);
}

}  // namespace

const char* operating_state_word(OperatingState::State state) {
  for (const auto& [known, word] : kStateWords) {
    if (state == known) return word;
  }
  return "UNKNOWN";
}

std::optional<RobotDatagram> decode_robot(std::string_view datagram) noexcept {
  RobotDatagram said;
  JsonText text(datagram);
  text.object([&](std::string_view key) { read_stream(text, key, said); });
  if (!text.ends()) return std::nullopt;
  return said;
}

void take_datagram(RobotState& state, std::string_view text, std::int64_t arrival_ns,
                   const UdpAddress& source) noexcept {
  if (state.has_source && source != state.source) {
    ++state.foreign;
    state.foreign_source = source;
    state.foreign_ns = arrival_ns;
    return;
  }
  const std::optional<RobotDatagram> said = decode_robot(text);
  if (!said) {
    ++state.malformed;
    return;
  }
  state.unknown_keys += static_cast<std::uint64_t>(said->unknown_keys);
  state.not_finite += static_cast<std::uint64_t>(said->not_finite);
  if (said->known_keys == 0) return;
  state.old_shapes_only =
      (!state.has_source || state.old_shapes_only) && said->old_keys == said->known_keys;
  state.has_source = true;
  state.source = source;
  state.source_ns = arrival_ns;
  ++state.datagrams;
  keep(state, state.measured_js, said->measured_js, arrival_ns);
  keep(state, state.setpoint_js, said->setpoint_js, arrival_ns);
  keep(state, state.jaw_measured_js, said->jaw_measured_js, arrival_ns);
  keep(state, state.jaw_setpoint_js, said->jaw_setpoint_js, arrival_ns);
  keep(state, state.measured_cp, said->measured_cp, arrival_ns);
  if (said->measured_cp) state.reference_frame = said->reference_frame;
  keep(state, state.setpoint_cp, said->setpoint_cp, arrival_ns);
  keep(state, state.local_measured_cp, said->local_measured_cp, arrival_ns);
  keep(state, state.operating_state, said->operating_state, arrival_ns);
}

std::size_t encode_command(const RobotCommand& command, std::span<char> memory) noexcept {
  if (!is_finite(command)) return 0;
  JsonWriter writer(memory.first(std::min(memory.size(), kMaxCommandBytes)));
  if (command.kind == RobotCommand::Kind::kHold) {
    writer.put(R"({"hold":""})");
    return writer.size();
  }
  // Whatever the arm reads of a command is stated: an absent field keeps the value that any client
  // gave it last (docs/dvrk.md 4.3).
  writer.put(R"({"jaw/servo_jp":{"Goal":)");
  writer.numbers({&command.jaw, 1});
  writer.put(R"(,"Velocity":[0.0]},)");
  if (command.kind == RobotCommand::Kind::kServoCp) {
    writer.put(R"("servo_cp":{"Goal":)");
    write_pose(writer, command.rotation, command.translation);
    writer.put(R"(,"Velocity":)");
    writer.numbers({command.velocity.data(), 3});
    writer.put(R"(,"VelocityAngular":)");
    writer.numbers({command.angular_velocity.data(), 3});
  } else {
    writer.put(R"("servo_jp":{"Goal":)");
    writer.numbers(command.joints);
    writer.put(R"(,"Velocity":)");
    writer.numbers(command.joint_velocity);
  }
  writer.put("}}");
  return writer.size();
}

}  // namespace omentum
