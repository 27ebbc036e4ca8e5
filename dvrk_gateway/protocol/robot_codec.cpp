#include "dvrk_gateway/protocol/robot_codec.h"

#include "dvrk_gateway/protocol/json_text.h"
#include "dvrk_gateway/protocol/json_writer.h"
#include "dvrk_gateway/protocol/payload_fields.h"

namespace omentum {
namespace {

void read_goal(JsonText& text, JointGoal& joints, bool& finite) {
  text.object([&](std::string_view field) {
    if (field == "Goal") {
      joints.goal_count = read_numbers(text, joints.goal, finite);
    } else if (field == "Velocity") {
      joints.velocity_count = read_numbers(text, joints.velocity, finite);
    } else {
      text.skip();
    }
  });
}

void read_goal(JsonText& text, CartesianGoal& pose, bool& finite) {
  text.object([&](std::string_view field) {
    if (field == "Goal") {
      text.object([&](std::string_view part) {
        if (part == "Rotation") {
          pose.has_rotation = read_rotation(text, pose.rotation, finite);
        } else if (part == "Translation") {
          pose.has_translation = read_vector(text, pose.translation, finite);
        } else {
          text.skip();
        }
      });
    } else if (field == "Velocity") {
      pose.has_velocity = read_vector(text, pose.velocity, finite);
    } else if (field == "VelocityAngular") {
      pose.has_angular_velocity = read_vector(text, pose.angular_velocity, finite);
    } else {
      text.skip();
    }
  });
}

void read_command(JsonText& text, std::string_view key, CommandDatagram& said) {
  ++said.known_keys;
  if (key == "hold") {
    said.hold = true;
    text.skip();
  } else if (key == "jaw/move_jp") {
    read_goal(text, said.jaw_move_jp.emplace(), said.finite);
  } else if (key == "jaw/servo_jp") {
    read_goal(text, said.jaw_servo_jp.emplace(), said.finite);
  } else if (key == "move_cp") {
    read_goal(text, said.move_cp.emplace(), said.finite);
  } else if (key == "move_jp") {
    read_goal(text, said.move_jp.emplace(), said.finite);
  } else if (key == "servo_cp") {
    read_goal(text, said.servo_cp.emplace(), said.finite);
  } else if (key == "servo_jp") {
    read_goal(text, said.servo_jp.emplace(), said.finite);
  } else {
    --said.known_keys;
    ++said.unknown_keys;
    text.skip();
  }
}

std::string_view names_of(int count) {
  switch (count) {
    case 0:
      return "null";
    case 1:
      return R"(["jaw"])";
    case 7:
      return R"(["yaw","pitch","insertion","disc_1","disc_2","disc_3","disc_4"])";
    default:
      return R"(["yaw","pitch","insertion","roll","wrist_pitch","wrist_yaw"])";
  }
}

std::span<const double> first(const std::array<double, kMaxJoints>& values, int count) {
  return std::span(values).first(static_cast<std::size_t>(count));
}

void begin(JsonWriter& writer, std::string_view name) {
  writer.put("{\"");
  writer.put(name);
  writer.put("\":");
}

void write_joints(JsonWriter& writer, const JointState& joints, std::string_view names,
                  std::string_view type) {
  writer.put(R"({"AutomaticTimestamp":)");
  writer.boolean(joints.automatic_timestamp);
  writer.put(R"(,"Effort":)");
  writer.numbers(first(joints.effort, joints.effort_count));
  writer.put(R"(,"Name":)");
  writer.put(names);
  writer.put(R"(,"Position":)");
  writer.numbers(first(joints.position, joints.count));
  writer.put(R"(,"Timestamp":)");
  writer.number(joints.timestamp_s);
  writer.put(type);
  writer.put(R"(,"Valid":)");
  writer.boolean(joints.valid);
  writer.put(R"(,"Velocity":)");
  writer.numbers(first(joints.velocity, joints.velocity_count));
  writer.put("}");
}

}  // namespace

CommandDatagram decode_commands(std::string_view datagram) noexcept {
  CommandDatagram said;
  JsonText text(datagram);
  text.object([&](std::string_view key) { read_command(text, key, said); });
  said.whole = text.ends();
  return said;
}

std::size_t encode_stream(std::string_view name, const JointState& joints, std::span<char> memory) {
  JsonWriter writer(memory);
  begin(writer, name);
  write_joints(writer, joints, names_of(joints.count), "");
  writer.put("}\n");
  return writer.size();
}

std::size_t encode_stream(std::string_view name, const CartesianPose& pose,
                          std::span<char> memory) {
  JsonWriter writer(memory);
  begin(writer, name);
  writer.put(R"({"AutomaticTimestamp":false,"MovingFrame":"PSM1)");
  writer.put(name == "setpoint_cp" ? "_setpoint" : "");
  writer.put(R"(","Position":)");
  write_pose(writer, pose.rotation, pose.translation);
  writer.put(R"(,"ReferenceFrame":"PSM1_base","Timestamp":)");
  writer.number(pose.timestamp_s);
  writer.put(R"(,"Valid":)");
  writer.boolean(pose.valid);
  writer.put("}}\n");
  return writer.size();
}

std::size_t encode_stream(std::string_view name, const OperatingState& state,
                          std::span<char> memory) {
  JsonWriter writer(memory);
  begin(writer, name);
  writer.put(R"({"AutomaticTimestamp":true,"IsBusy":)");
  writer.boolean(state.is_busy);
  writer.put(R"(,"IsHomed":)");
  writer.boolean(state.is_homed);
  writer.put(R"(,"State":")");
  writer.put(operating_state_word(state.state));
  writer.put(R"(","SubState":")");
  writer.put(state.sub_state.data());
  writer.put(R"(","Timestamp":)");
  writer.number(state.timestamp_s);
  writer.put(R"(,"Valid":)");
  writer.boolean(state.valid);
  writer.put("}}\n");
  return writer.size();
}

std::size_t encode_old_shape(const JointState& jaw, const JointState& joints,
                             std::span<char> memory) {
  JsonWriter writer(memory);
  writer.put(R"({"GetStateJaw":)");
  write_joints(writer, jaw, names_of(jaw.count), R"(,"Type":[0])");
  writer.put(R"(,"GetStateJoint":)");
  write_joints(writer, joints,
               R"(["outer_yaw","outer_pitch","outer_insertion","outer_roll",)"
               R"("outer_wrist_pitch","outer_wrist_yaw"])",
               R"(,"Type":[2,2,1,2,2,2])");
  writer.put("}\n");
  return writer.size();
}

}  // namespace omentum
