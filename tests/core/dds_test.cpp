#include "core/dds.h"

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <sstream>
#include <thread>

#include "core/check.h"
#include "core/loopback_sockets.h"
#include "core/wire.h"
#include "tests/support/domain.h"

namespace omentum {
namespace {

using test::PrivateDomain;

constexpr std::int64_t kS = 1'000'000'000;

std::string message_of(const std::function<void()>& act) {
  try {
    act();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

// Waits for condition() with the wait set of a reader; false after ten seconds.
bool wait_until(dds::Waitset& waitset, const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    waitset.wait(20'000'000);
  }
  return true;
}

TEST(DdsParticipant, ABadDomainIsOneLineWithTheRange) {
  const std::string text =
      message_of([] { dds::Participant(231, test::loopback_profile().uri, "test"); });
  EXPECT_NE(text.find("231"), std::string::npos) << text;
  EXPECT_NE(text.find("[0, 230]"), std::string::npos) << text;
  EXPECT_EQ(text.find('\n'), std::string::npos) << text;
}

TEST(DdsParticipant, ABadConfigurationIsOneLine) {
  const PrivateDomain domain;
  const std::string text = message_of([&] {
    dds::Participant(domain.id(),
                     "<CycloneDDS><Domain><General><Nonsense>1</Nonsense>"
                     "</General></Domain></CycloneDDS>",
                     "test");
  });
  EXPECT_NE(text, "no error");
  EXPECT_EQ(text.find('\n'), std::string::npos) << text;
}

TEST(DdsParticipant, ATakenParticipantIndexIsOneLineWithAHint) {
  const PrivateDomain domain;
  std::string uri = test::loopback_profile().uri;
  const std::string many = "<MaxAutoParticipantIndex>80<";
  uri.replace(uri.find(many), many.size(), "<MaxAutoParticipantIndex>0<");
  // Another process would hold the index; a bound socket on its port does the same.
  const int fd = socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_ANY);
  address.sin_port = htons(static_cast<std::uint16_t>(7410 + 250 * domain.id()));
  ASSERT_EQ(bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  const std::string text = message_of([&] { dds::Participant(domain.id(), uri, "test"); });
  close(fd);
  EXPECT_NE(text.find("participant index"), std::string::npos) << text;
  EXPECT_NE(text.find("port " + std::to_string(7410 + 250 * domain.id())), std::string::npos)
      << text;
  EXPECT_NE(text.find("--domain"), std::string::npos) << text;
  EXPECT_EQ(text.find('\n'), std::string::npos) << text;
}

TEST(DdsParticipant, OnLoopbackHasNoSocketThatListensToOtherInterfaces) {
  const std::set<int> before = open_udp_sockets();
  const PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "loopback");
  int sockets = 0;
  for (const int socket : open_udp_sockets()) {
    if (before.contains(socket)) continue;
    ++sockets;
    char device[16] = {};
    socklen_t size = sizeof device;
    ASSERT_EQ(getsockopt(socket, SOL_SOCKET, SO_BINDTODEVICE, device, &size), 0);
    EXPECT_STREQ(device, "lo");
  }
  EXPECT_GE(sockets, 2);  // discovery and data
}

TEST(DdsParticipant, SeveralShareADomainAndItCanBeMadeAgain) {
  const PrivateDomain domain;
  for (int i = 0; i < 3; ++i) {
    const dds::Participant a(domain.id(), test::loopback_profile().uri, "a");
    const dds::Participant b(domain.id(), test::loopback_profile().uri, "b");
    EXPECT_GT(a.handle(), 0);
    EXPECT_NE(a.handle(), b.handle());
  }
}

TEST(DdsReader, LoansGoBackWhenTheCallbackThrows) {
  const PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  BusWriter<RolloutSegment> writer(participant, run_partition("r"), "w");
  BusReader<RolloutSegment> reader(participant, run_partition("r"), "r", 8);
  dds::Waitset waitset(participant);
  waitset.attach(reader.raw());
  ASSERT_TRUE(wait_until(waitset, [&] { return writer.matched() == 1; }));
  // With a forgotten loan the cache of 8 samples would fill after 8 rounds.
  for (int i = 0; i < 50; ++i) {
    ASSERT_TRUE(writer.write(RolloutSegment{}));
    ASSERT_TRUE(waitset.wait(10 * kS));
    EXPECT_THROW((void)reader.take(1, [](Arrival<RolloutSegment>&&) { throw 1; }), int);
  }
  EXPECT_EQ(reader.raw().rejected(), 0u);
}

TEST(DdsReader, LeavingAndCrashingLookDifferent) {
  const PrivateDomain domain;
  const dds::Participant learner(domain.id(), test::loopback_profile().uri, "learner");
  BusReader<WorkerStatus> reader(learner, run_partition("r"), "r");
  dds::Waitset waitset(learner);
  waitset.attach(reader.raw());
  for (const bool graceful : {true, false}) {
    WorkerStatus status;
    status.worker_id = graceful ? 11 : 12;
    {
      const dds::Participant worker(domain.id(), test::loopback_profile().uri, "worker");
      BusWriter<WorkerStatus> writer(worker, public_partitions("r"), "w");
      ASSERT_TRUE(writer.write(status));
      ASSERT_TRUE(wait_until(waitset, [&] { return writer.matched() == 1; }));
      if (graceful) {
        ASSERT_TRUE(writer.dispose(status));
      }
    }
    std::vector<dds::InstanceState> seen;
    std::uint32_t id = 0;
    ASSERT_TRUE(wait_until(waitset, [&] {
      (void)reader.take(64, [&](Arrival<WorkerStatus>&& arrival) {
        id = arrival.record.worker_id;
        seen.push_back(arrival.info.state);
      });
      return !seen.empty() && seen.back() != dds::InstanceState::kAlive;
    }));
    EXPECT_EQ(id, status.worker_id);
    EXPECT_EQ(seen.back(),
              graceful ? dds::InstanceState::kDisposed : dds::InstanceState::kNoWriters);
    (void)reader.take(64, [](Arrival<WorkerStatus>&&) {});
  }
}

TEST(DdsReader, ALateJoinerGetsTheLastTwoWeights) {
  const PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  BusWriter<PolicyWeights> writer(participant, public_partitions("r"), "w");
  PolicyWeights weights;
  for (std::uint64_t version = 0; version < 5; ++version) {
    weights.policy_version = version;
    ASSERT_TRUE(writer.write(weights));
  }
  BusReader<PolicyWeights> reader(participant, run_partition("r"), "r");
  dds::Waitset waitset(participant);
  waitset.attach(reader.raw());
  std::vector<std::uint64_t> versions;
  ASSERT_TRUE(wait_until(waitset, [&] {
    (void)reader.take(64, [&](Arrival<PolicyWeights>&& arrival) {
      versions.push_back(arrival.record.policy_version);
    });
    return versions.size() >= 2;
  }));
  EXPECT_EQ(versions, (std::vector<std::uint64_t>{3, 4}));
}

TEST(DdsReader, RunsDoNotSeeEachOther) {
  const PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  BusWriter<RolloutTask> other(participant, run_partition("b"), "w");
  BusWriter<RolloutTask> writer(participant, worker_partition("a", 3), "w");
  BusReader<RolloutTask> reader(participant, worker_partition("a", 3), "r");
  dds::Waitset waitset(participant);
  waitset.attach(reader.raw());
  RolloutTask task;
  task.reset = true;
  task.slot = 1;
  ASSERT_TRUE(wait_until(waitset, [&] { return writer.matched() == 1; }));
  EXPECT_EQ(other.matched(), 0);
  ASSERT_TRUE(other.write(task));
  task.slot = 2;
  ASSERT_TRUE(writer.write(task));
  ASSERT_TRUE(waitset.wait(10 * kS));
  std::vector<std::uint32_t> slots;
  (void)reader.take(64, [&](Arrival<RolloutTask>&& a) { slots.push_back(a.record.slot); });
  EXPECT_EQ(slots, std::vector<std::uint32_t>{2});
}

TEST(DdsWriter, AFullReaderTimesOutTheWriteAndTheRetryLosesNothing) {
  const PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  BusWriter<RolloutSegment> writer(participant, run_partition("r"), "w");
  BusReader<RolloutSegment> reader(participant, run_partition("r"), "r", 4);
  dds::Waitset waitset(participant);
  waitset.attach(reader.raw());
  ASSERT_TRUE(wait_until(waitset, [&] { return writer.matched() == 1; }));
  std::uint64_t timeouts = 0;
  std::jthread writing([&] {
    RolloutSegment segment;
    for (segment.segment = 0; segment.segment < 6;) {
      if (writer.write(segment)) {
        ++segment.segment;
      } else {
        EXPECT_TRUE(writer.timed_out());
        ++timeouts;
      }
    }
  });
  ASSERT_TRUE(wait_until(waitset, [&] { return reader.raw().rejected() > 0; }));
  std::vector<std::uint64_t> got;
  ASSERT_TRUE(wait_until(waitset, [&] {
    (void)reader.take(64, [&](Arrival<RolloutSegment>&& a) { got.push_back(a.record.segment); });
    return got.size() == 6;
  }));
  EXPECT_EQ(got, (std::vector<std::uint64_t>{0, 1, 2, 3, 4, 5}));
}

TEST(DdsWaitset, WakeEndsAWaitFromAnotherThread) {
  const PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  dds::Waitset waitset(participant);
  std::jthread waker([&] { waitset.wake(); });
  EXPECT_TRUE(waitset.wait(10 * kS));
  EXPECT_FALSE(waitset.wait(0));  // consumed
}

}  // namespace
}  // namespace omentum
