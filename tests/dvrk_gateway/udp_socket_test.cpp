#include "dvrk_gateway/protocol/udp_socket.h"

#include <gtest/gtest.h>
#include <poll.h>

#include <array>
#include <string>

#include "core/check.h"
#include "dvrk_gateway/protocol/codec.h"

namespace omentum {
namespace {

/// Waits until a datagram is there, at most 10 s.
std::optional<Link::Received> wait_for(UdpSocket& socket, std::span<char> memory) {
  pollfd waiting{socket.descriptor(), POLLIN, 0};
  poll(&waiting, 1, 10'000);
  return socket.receive(memory);
}

TEST(UdpSocket, AnswersTheAddressADatagramCameFrom) {
  UdpSocket one(0);
  UdpSocket other(0);
  std::array<char, 100> memory{};
  EXPECT_FALSE(one.receive(memory));
  ASSERT_EQ(other.send("hello", {0x7f000001, one.port()}), SendOutcome::kSent);
  const auto received = wait_for(one, memory);
  ASSERT_TRUE(received);
  EXPECT_EQ(std::string(memory.data(), received->size), "hello");
  EXPECT_EQ(received->source, (UdpAddress{0x7f000001, other.port()}));
  EXPECT_FALSE(received->cut);
  ASSERT_EQ(one.send("back", received->source), SendOutcome::kSent);
  ASSERT_TRUE(wait_for(other, memory));
}

TEST(UdpSocket, TellsThatADatagramWasCut) {
  UdpSocket one(0);
  ASSERT_EQ(one.send("longer than that", {0x7f000001, one.port()}), SendOutcome::kSent);
  std::array<char, 4> memory{};
  const auto received = wait_for(one, memory);
  ASSERT_TRUE(received);
  EXPECT_EQ(received->size, 4u);
  EXPECT_TRUE(received->cut);
}

TEST(UdpSocket, RefusesWhatTheReceiverWouldCutAndEmptyDatagrams) {
  UdpSocket one(0, kMaxCommandBytes);
  const UdpAddress self{0x7f000001, one.port()};
  EXPECT_EQ(one.send(std::string(1024, 'x'), self), SendOutcome::kRefused);
  EXPECT_EQ(one.send(std::string(kMaxCommandBytes + 1, 'x'), self), SendOutcome::kRefused);
  EXPECT_EQ(one.send("", self), SendOutcome::kRefused);
  EXPECT_EQ(one.send(std::string(kMaxCommandBytes, 'x'), self), SendOutcome::kSent);
  std::array<char, 2000> memory{};
  ASSERT_TRUE(wait_for(one, memory));
  EXPECT_FALSE(one.receive(memory));
}

TEST(UdpSocket, PortInUseIsNamed) {
  UdpSocket one(0);
  try {
    UdpSocket other(one.port());
    FAIL() << "two sockets on one port";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find(std::to_string(one.port())), std::string::npos);
  }
}

TEST(UdpSocket, AddressesAreReadAndWritten) {
  EXPECT_EQ(to_string(resolve_address("--robot", "127.0.0.1", 48051)), "127.0.0.1:48051");
  EXPECT_THROW(resolve_address("--robot", "256.1.1.1", 1), Error);
}

}  // namespace
}  // namespace omentum
