// The program of the tests of the bus. Run with `--worker`, `--flood` or `--end-full` it is another
// process of these tests.
#include <gtest/gtest.h>

#include <chrono>
#include <cstring>
#include <string>
#include <thread>

#include "tests/learner/bus_loop.h"

namespace omentum {
namespace {

using test::kS;

// Writes segments of a worker that nobody knows, as fast as they are taken, for ever.
void flood(std::uint32_t domain) {
  const dds::Participant participant(domain, test::loopback_profile().uri, "flood");
  BusWriter<RolloutSegment> writer(participant, run_partition("loop"), "flood");
  RolloutSegment segment;
  segment.worker_id = 9;
  while (true) {
    segment.slot = static_cast<std::uint32_t>(segment.segment % 64);
    if (writer.write(segment)) ++segment.segment;
  }
}

// A program whose reader is full at its end, and nobody takes from it.
int end_full(std::uint32_t domain) {
  const dds::Participant participant(domain, test::loopback_profile().uri, "full");
  const BusReader<RolloutSegment> reader(participant, run_partition("loop"), "full", 4);
  const std::int64_t give_up_ns = steady_now_ns() + 20 * kS;
  while (reader.raw().rejected() == 0 && steady_now_ns() < give_up_ns)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return reader.raw().rejected() > 0 ? 0 : 3;
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  if (argc == 3 && std::strcmp(argv[1], "--flood") == 0)
    omentum::flood(static_cast<std::uint32_t>(std::stoul(argv[2])));
  if (argc == 3 && std::strcmp(argv[1], "--end-full") == 0)
    return omentum::end_full(static_cast<std::uint32_t>(std::stoul(argv[2])));
  if (argc >= 6 && std::strcmp(argv[1], "--worker") == 0) {
    omentum::test::FakeWorker fake;
    fake.domain = static_cast<std::uint32_t>(std::stoul(argv[2]));
    fake.run = argv[3];
    fake.lanes = std::stoi(argv[4]);
    fake.group_ms = std::stoll(argv[5]);
    if (argc >= 7) fake.state_bytes = std::stoul(argv[6]);
    omentum::BusWorker worker(omentum::test::fake_options(fake));
    return worker.run([] { return false; });
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
