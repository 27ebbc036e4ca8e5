#include "dvrk_gateway/protocol/codec.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "dvrk_gateway/protocol/robot_codec.h"
#include "tests/support/wire_log.h"

namespace omentum {
namespace {

using Kind = RobotCommand::Kind;
using OperatingStateWord = OperatingState::State;
using testing::HasSubstr;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
const UdpAddress kRobot{0x7f000001, 40000};

std::string text_of(const RobotCommand& command) {
  std::array<char, 2000> memory{};
  return {memory.data(), encode_command(command, memory)};
}

template <typename Payload>
std::string text_of(const char* name, const Payload& payload) {
  std::array<char, 2000> memory{};
  return {memory.data(), encode_stream(name, payload, memory)};
}

/// The text that a robot would write for what a datagram said.
std::string again(const RobotDatagram& said) {
  std::string text;
  if (said.measured_js) text += text_of("measured_js", *said.measured_js);
  if (said.setpoint_js) text += text_of("setpoint_js", *said.setpoint_js);
  if (said.jaw_measured_js) text += text_of("jaw/measured_js", *said.jaw_measured_js);
  if (said.jaw_setpoint_js) text += text_of("jaw/setpoint_js", *said.jaw_setpoint_js);
  if (said.measured_cp) text += text_of("measured_cp", *said.measured_cp);
  if (said.setpoint_cp) text += text_of("setpoint_cp", *said.setpoint_cp);
  if (said.local_measured_cp) text += text_of("local/measured_cp", *said.local_measured_cp);
  if (said.operating_state) text += text_of("operating_state", *said.operating_state);
  return text;
}

RobotState after(std::initializer_list<std::string_view> datagrams) {
  RobotState state;
  std::int64_t now_ns = 0;
  for (const std::string_view text : datagrams)
    take_datagram(state, text, now_ns += 10'000'000, kRobot);
  return state;
}

std::string joints_at(double timestamp_s, double yaw = 0) {
  JointState joints;
  joints.count = 6;
  joints.position[0] = yaw;
  joints.valid = true;
  joints.timestamp_s = timestamp_s;
  return text_of("measured_js", joints);
}

TEST(Codec, EveryDatagramOfTheWireLogIsReadAndWrittenToTheByte) {
  const auto lines = test::read_wire_log();
  if (lines.empty()) GTEST_SKIP() << "no dvrk_wire in OMENTUM_REAL_DATA";
  int received = 0;
  for (const test::WireLine& line : lines) {
    if (line.sent) continue;
    ++received;
    const auto said = decode_robot(line.datagram);
    ASSERT_TRUE(said) << line.number;
    EXPECT_EQ(said->known_keys, 1) << line.number;
    EXPECT_EQ(said->not_finite, 0) << line.number;
    EXPECT_EQ(again(*said), line.datagram + "\n") << line.number;
  }
  EXPECT_EQ(received, 1960);
}

TEST(Codec, OfTheSentLinesOfTheWireLogOneIsNoJson) {
  const auto lines = test::read_wire_log();
  if (lines.empty()) GTEST_SKIP() << "no dvrk_wire in OMENTUM_REAL_DATA";
  int whole = 0;
  int counted = 0;
  for (const test::WireLine& line : lines) {
    if (line.sent) ++(decode_commands(line.datagram).whole ? whole : counted);
  }
  EXPECT_EQ(whole, 56);
  EXPECT_EQ(counted, 1);
}

TEST(Codec, CommandsAreReadAsTheyWereWritten) {
  RobotCommand command;
  command.kind = Kind::kServoCp;
  command.rotation << 0.1, -2.6984858791934131e-11, 3, 4, 5, 6, 7, 8, 1.0 / 3;
  command.translation << 0.1, -1e-300, 5e-324;
  command.jaw = -0.1;
  command.velocity << 1, 2, 3;
  command.angular_velocity << 0.4, 0.5, 0.6;
  CommandDatagram said = decode_commands(text_of(command));
  ASSERT_TRUE(said.whole && said.servo_cp && said.jaw_servo_jp);
  EXPECT_EQ(said.servo_cp->rotation, command.rotation);
  EXPECT_EQ(said.servo_cp->translation, command.translation);
  EXPECT_EQ(said.servo_cp->velocity, command.velocity);
  EXPECT_EQ(said.servo_cp->angular_velocity, command.angular_velocity);
  EXPECT_EQ(said.jaw_servo_jp->goal[0], command.jaw);

  command.kind = Kind::kServoJp;
  command.joints = {0.1, 0.2, 0.3, 0.4, 0.5, 1.0 / 3};
  command.joint_velocity = {1, 2, 3, 4, 5, 6};
  said = decode_commands(text_of(command));
  ASSERT_TRUE(said.whole && said.servo_jp);
  EXPECT_EQ(said.servo_jp->goal_count, 6);
  EXPECT_EQ(said.servo_jp->velocity_count, 6);
  for (std::size_t j = 0; j < 6; ++j) {
    EXPECT_EQ(said.servo_jp->goal[j], command.joints[j]);
    EXPECT_EQ(said.servo_jp->velocity[j], command.joint_velocity[j]);
  }

  command.kind = Kind::kHold;
  EXPECT_EQ(text_of(command), R"({"hold":""})");
}

TEST(Codec, EveryGoalStatesItsVelocities) {
  RobotCommand command;
  command.kind = Kind::kServoCp;
  CommandDatagram said = decode_commands(text_of(command));
  ASSERT_TRUE(said.servo_cp && said.servo_cp->has_velocity && said.servo_cp->has_angular_velocity);
  EXPECT_EQ(said.servo_cp->velocity, Eigen::Vector3d::Zero());
  EXPECT_EQ(said.servo_cp->angular_velocity, Eigen::Vector3d::Zero());
  ASSERT_TRUE(said.jaw_servo_jp);
  EXPECT_EQ(said.jaw_servo_jp->velocity_count, 1);
  command.kind = Kind::kServoJp;
  said = decode_commands(text_of(command));
  ASSERT_TRUE(said.servo_jp);
  EXPECT_EQ(said.servo_jp->velocity_count, 6);
}

TEST(Codec, LongestCommandFitsTheReceiver) {
  constexpr double kLongest = -1.2345678901234567e-300;
  RobotCommand command;
  command.rotation.setConstant(kLongest);
  command.translation.setConstant(kLongest);
  command.velocity.setConstant(kLongest);
  command.angular_velocity.setConstant(kLongest);
  command.joints.fill(kLongest);
  command.joint_velocity.fill(kLongest);
  command.jaw = kLongest;
  std::size_t longest = 0;
  for (const Kind kind : {Kind::kServoCp, Kind::kServoJp}) {
    command.kind = kind;
    longest = std::max(longest, text_of(command).size());
  }
  EXPECT_GT(longest, 0u);
  EXPECT_LE(longest, kMaxCommandBytes);
  RecordProperty("longest_command_bytes", static_cast<int>(longest));
}

TEST(Codec, CommandsThatAreNotFiniteOrDoNotFitAreRefused) {
  RobotCommand command;
  command.kind = Kind::kServoCp;
  command.translation.x() = std::nan("");
  EXPECT_EQ(text_of(command), "");
  command.translation.x() = 0;
  command.jaw = kInfinity;
  EXPECT_EQ(text_of(command), "");
  command.jaw = 0;
  std::array<char, 40> small{};
  EXPECT_EQ(encode_command(command, small), 0u);
}

TEST(Codec, EveryPrefixOfADatagramIsMalformed) {
  const std::string text = R"({"measured_cp":{"Position":{"Rotation":[[1,0,0],[0,1,0],[0,0,1]],)"
                           R"("Translation":[0,0,-0.1]},"Timestamp":1,"Valid":true}})";
  ASSERT_TRUE(decode_robot(text));
  for (std::size_t size = 0; size < text.size(); ++size)
    EXPECT_FALSE(decode_robot(text.substr(0, size))) << size;
}

TEST(Codec, NestingBeyondEightIsMalformed) {
  const auto nested = [](int depth) {
    return R"({"unknown":)" + std::string(static_cast<std::size_t>(depth - 1), '[') +
           std::string(static_cast<std::size_t>(depth - 1), ']') + "}";
  };
  EXPECT_TRUE(decode_robot(nested(8)));
  EXPECT_FALSE(decode_robot(nested(9)));
  EXPECT_FALSE(decode_robot(std::string(60'000, '[')));
  EXPECT_FALSE(decode_robot(std::string(60'000, '{')));
}

TEST(Codec, NumbersThatAreNotFiniteMakeThePayloadInvalid) {
  for (const char* number : {"null", "1e+9999", "-1e+9999"}) {
    const RobotState state =
        after({fmt::format(R"({{"jaw/measured_js":{{"Position":[{}],"Velocity":[0],"Effort":[0],)"
                           R"("Timestamp":1.5,"Valid":true}}}})",
                           number)});
    ASSERT_TRUE(state.jaw_measured_js.seen) << number;
    EXPECT_FALSE(state.jaw_measured_js.payload.valid) << number;
    EXPECT_EQ(state.jaw_measured_js.payload.position[0], 0) << number;
    EXPECT_EQ(state.not_finite, 1u) << number;
    EXPECT_EQ(state.malformed, 0u) << number;
  }
}

TEST(Codec, TimestampThatIsNotFiniteMakesThePayloadInvalidAndDoesNotAdvance) {
  for (const char* time : {"null", "1e+9999", "-3"}) {
    const std::string odd =
        fmt::format(R"({{"measured_js":{{"Position":[0],"Timestamp":{},"Valid":true}}}})", time);
    const RobotState state = after({joints_at(2.5), odd});
    EXPECT_FALSE(state.measured_js.payload.valid) << time;
    EXPECT_EQ(state.measured_js.payload.timestamp_s, 2.5) << time;
    EXPECT_LT(state.measured_js.advanced_ns, state.measured_js.arrival_ns) << time;
    EXPECT_EQ(state.restarts, 0u) << time;
  }
}

TEST(Codec, AbsentPoseIsInvalid) {
  const RobotState state = after({R"({"measured_cp":{"Timestamp":1,"Valid":true}})"});
  EXPECT_TRUE(state.measured_cp.seen);
  EXPECT_FALSE(state.measured_cp.payload.valid);
}

TEST(Codec, DenormalOfAnInvalidPayloadIsData) {
  const RobotState state = after(
      {R"({"jaw/measured_js":{"Position":[4.67e-310],"Timestamp":1,"Valid":false,"Velocity":null}})"});
  EXPECT_EQ(state.malformed, 0u);
  EXPECT_EQ(state.jaw_measured_js.payload.position[0], 4.67e-310);
  EXPECT_FALSE(state.jaw_measured_js.payload.valid);
}

TEST(Codec, StreamsOfStartUpAreEmptyAndInvalid) {
  const RobotState state = after({R"({"measured_js":{"AutomaticTimestamp":false,"Effort":null,)"
                                  R"("Name":null,"Position":null,"Timestamp":0.0,"Valid":false,)"
                                  R"("Velocity":null}})"});
  EXPECT_TRUE(state.measured_js.seen);
  EXPECT_EQ(state.measured_js.payload.count, 0);
  EXPECT_FALSE(state.measured_js.payload.valid);
  EXPECT_EQ(state.not_finite, 0u);
}

TEST(Codec, UnknownKeysAreCountedAndUnknownFieldsIgnored) {
  const RobotState state = after({R"( { "later" : {"a":[1,{"b":null}]} ,
               "jaw/measured_js":{"Position":[1],"New":{"deep":[[]]},"Timestamp":1,"Valid":true},
               "x":"\u00e9\n" } )"});
  EXPECT_EQ(state.unknown_keys, 2u);
  EXPECT_EQ(state.malformed, 0u);
  EXPECT_EQ(state.jaw_measured_js.payload.position[0], 1);
}

TEST(Codec, WrongTypesAndCountsAreMalformed) {
  for (const char* text : {R"({"measured_js":7})",
                           R"({"measured_js":{"Position":"x"}})",
                           R"({"measured_js":{"Position":[1,2,3,4,5,6,7,8,9]}})",
                           R"({"measured_js":{"Position":[1,2],"Velocity":[1]}})",
                           R"({"measured_cp":{"Position":{"Rotation":[[1,0,0],[0,1,0]]}}})",
                           R"({"measured_cp":{"Position":{"Translation":[1,2]}}})",
                           R"({"operating_state":{"State":1}})",
                           R"({"operating_state":{"IsHomed":"true"}})",
                           R"({"a":1,})",
                           R"({"a":01})",
                           R"({"a":+1})",
                           R"({"a":1.})",
                           R"({"a":.5})",
                           R"({"a":nan})",
                           R"({"a":1} {})",
                           R"({"a"})",
                           R"(["a"])",
                           "",
                           " ",
                           "not json",
                           "\xff\xfe"}) {
    const RobotState state = after({text});
    EXPECT_EQ(state.malformed, 1u) << text;
    EXPECT_FALSE(state.has_source) << text;
  }
}

TEST(Codec, ShapeOf2019IsReadButCannotArm) {
  // Pretty-printed, whole numbers, no poses, no operating state.
  const RobotState state = after({R"({
    "GetStateJaw" : { "AutomaticTimestamp" : true, "Effort" : [ 0 ], "Name" : [ "jaw" ],
                      "Position" : [ 1 ], "Timestamp" : 3, "Type" : [ 0 ], "Valid" : true,
                      "Velocity" : [ 0 ] },
    "GetStateJoint" : { "AutomaticTimestamp" : true, "Effort" : [ 0, 0, 0, 0, 0, 0 ],
      "Name" : [ "outer_yaw", "outer_pitch", "outer_insertion", "outer_roll",
                 "outer_wrist_pitch", "outer_wrist_yaw" ],
      "Position" : [ 0.5, 0, 0.1, 0, 0, 0 ], "Timestamp" : 3, "Type" : [ 2, 2, 1, 2, 2, 2 ],
      "Valid" : true, "Velocity" : [ 0, 0, 0, 0, 0, 0 ] }
  })"});
  EXPECT_EQ(state.measured_js.payload.count, 6);
  EXPECT_EQ(state.measured_js.payload.position[0], 0.5);
  EXPECT_EQ(state.jaw_measured_js.payload.position[0], 1);
  EXPECT_TRUE(state.old_shapes_only);
  EXPECT_FALSE(state.operating_state.seen);
}

TEST(Codec, OldNameOfMeasuredJsIsUnderstood) {
  const RobotState state = after(
      {R"({"state_joint_current":{"Position":[0.5,0,0.1,0,0,0],"Timestamp":3,"Valid":true}})"});
  EXPECT_EQ(state.measured_js.payload.count, 6);
  EXPECT_TRUE(state.old_shapes_only);
}

TEST(Codec, AllStreamsInOneDatagramAreUnderstood) {
  std::string all = "{";
  for (const char* name : {"jaw/measured_js", "jaw/setpoint_js", "measured_js", "setpoint_js"})
    all += fmt::format(R"("{}":{{"Position":[1],"Timestamp":1,"Valid":true}},)", name);
  for (const char* name : {"measured_cp", "setpoint_cp", "local/measured_cp"})
    all += fmt::format(R"("{}":{{"Position":{{"Rotation":[[1,0,0],[0,1,0],[0,0,1]],)"
                       R"("Translation":[1,2,3]}},"Timestamp":1,"Valid":true}},)",
                       name);
  all += R"("operating_state":{"State":"ENABLED","SubState":"HOMED","IsHomed":true,)"
         R"("IsBusy":false,"Timestamp":1,"Valid":true}})";
  const RobotState state = after({all});
  EXPECT_EQ(state.datagrams, 1u);
  for (const auto* joints :
       {&state.measured_js, &state.setpoint_js, &state.jaw_measured_js, &state.jaw_setpoint_js})
    EXPECT_TRUE(joints->seen && joints->payload.valid);
  for (const auto* pose : {&state.measured_cp, &state.setpoint_cp, &state.local_measured_cp}) {
    EXPECT_TRUE(pose->seen && pose->payload.valid);
    EXPECT_EQ(pose->payload.translation, Eigen::Vector3d(1, 2, 3));
  }
  EXPECT_EQ(state.operating_state.payload.state, OperatingStateWord::kEnabled);
  EXPECT_STREQ(state.operating_state.payload.sub_state.data(), "HOMED");
  EXPECT_FALSE(state.old_shapes_only);
}

TEST(Codec, LongSubStatesAreCut) {
  const RobotState state = after({fmt::format(
      R"({{"operating_state":{{"State":"SLEEPING","SubState":"{:A>200}","Timestamp":1,"Valid":true}}}})",
      "A")});
  EXPECT_EQ(std::string(state.operating_state.payload.sub_state.data()),
            std::string(kMaxSubState, 'A'));
  EXPECT_EQ(state.operating_state.payload.state, OperatingStateWord::kUnknown);
}

TEST(RobotState, LatePayloadsAreDroppedAndCounted) {
  const RobotState state = after({joints_at(1.02, 2), joints_at(1.01, 1)});
  EXPECT_EQ(state.measured_js.payload.position[0], 2);
  EXPECT_EQ(state.reordered, 1u);
  EXPECT_EQ(state.restarts, 0u);
}

TEST(RobotState, TimestampFarBackIsAnotherProcess) {
  const RobotState state = after({joints_at(10, 2), joints_at(0.5, 1)});
  EXPECT_EQ(state.measured_js.payload.position[0], 1);
  EXPECT_EQ(state.restarts, 1u);
}

TEST(RobotState, RepeatedTimestampDoesNotAdvance) {
  const RobotState state = after({joints_at(1), joints_at(1), joints_at(1)});
  EXPECT_EQ(state.measured_js.arrival_ns, 30'000'000);
  EXPECT_EQ(state.measured_js.advanced_ns, 10'000'000);
}

TEST(RobotState, OtherSendersAreCountedAndNotTaken) {
  RobotState state = after({joints_at(1, 1)});
  const UdpAddress stranger{0x7f000001, 40001};
  take_datagram(state, joints_at(2, 2), 50, stranger);
  EXPECT_EQ(state.foreign, 1u);
  EXPECT_EQ(state.foreign_source, stranger);
  EXPECT_EQ(state.source, kRobot);
  EXPECT_EQ(state.measured_js.payload.position[0], 1);
}

TEST(Commands, OfACutTextTheFirstPartIsThere) {
  const std::string text =
      R"({"jaw/servo_jp":{"Goal":[0.5]},"servo_jp":{"Goal":[1,2,3,4,5,6.25]}})";
  const std::size_t inside_the_last_number = text.find("25]");
  const CommandDatagram said = decode_commands(text.substr(0, inside_the_last_number + 1));
  EXPECT_FALSE(said.whole);
  ASSERT_TRUE(said.jaw_servo_jp && said.servo_jp);
  EXPECT_EQ(said.servo_jp->goal_count, 6);
  EXPECT_EQ(said.servo_jp->goal[5], 6.2);
}

}  // namespace
}  // namespace omentum
