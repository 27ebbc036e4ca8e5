// What the gateway's real-time thread calls takes no memory.
#include <gtest/gtest.h>

#include <array>
#include <string>

#include "dvrk_gateway/protocol/codec.h"
#include "dvrk_gateway/protocol/udp_socket.h"
#include "tests/support/allocation_count.h"

namespace omentum {
namespace {

TEST(Allocations, NoneFromSocketToStateAndBack) {
  UdpSocket socket(0, kMaxCommandBytes);
  const UdpAddress self{0x7f000001, socket.port()};
  RobotState state;
  RobotCommand command;
  command.kind = RobotCommand::Kind::kServoCp;
  const std::string long_name(5000, 'x');
  const std::string texts[] = {
      R"({"measured_js":{"Name":["yaw"],"Position":[0.1],"Timestamp":1e-3,"Valid":true}})",
      R"({"operating_state":{"State":"ENABLED","SubState":"CALIBRATING_ENCODERS_FROM_POTS"}})",
      R"({"measured_cp":{"Position":{"Rotation":[[1,0,0],[0,1,0],[0,0,1]]}}})",
      R"({"a":[[[[[[[[[[1]]]]]]]]]]})",
      R"({"jaw/measured_js":{"Position":[1e9999,0.12345678901234567890123456789e-290]}})",
      "garbage",
      "{\"" + long_name + "\":\"" + long_name + "\"}"};
  std::array<char, 2000> memory{};

  const std::uint64_t before = test::allocation_count();
  for (int k = 0; k < 100; ++k) {
    for (const std::string& text : texts) take_datagram(state, text, k, self);
    for (int joints = 0; joints < 2; ++joints) {
      command.kind = joints != 0 ? RobotCommand::Kind::kServoJp : RobotCommand::Kind::kServoCp;
      const std::size_t size = encode_command(command, memory);
      socket.send({memory.data(), size}, self);
    }
    while (socket.receive(memory)) {
    }
  }
  EXPECT_EQ(test::allocation_count(), before);
  EXPECT_EQ(state.datagrams, 400u);
  EXPECT_EQ(state.malformed, 200u);
}

}  // namespace
}  // namespace omentum
