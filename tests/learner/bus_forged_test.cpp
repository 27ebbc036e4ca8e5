// The protocol below DDS forged by somebody on the machine (tests/hostile/forger.py): those who are
// parted find each other again.
#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <thread>

#include "tests/learner/bus_loop.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using test::expected;
using test::kS;
using test::Loop;
using test::loop_config;
using test::PrivateDomain;
using test::Process;
using test::worker_process;

TEST(BusForged, ParticipantsThatWerePartedFindEachOtherAgain) {
  if (std::system("python3 -c pass") != 0) GTEST_SKIP() << "python3 is not installed";
  const PrivateDomain domain;
  const test::TempDir folder;
  Loop loop(domain.id(), loop_config(8, 0));
  const Process first = worker_process(domain, 4, 20), second = worker_process(domain, 4, 20);
  loop.start();
  ASSERT_TRUE(loop.serve_until([&] { return loop.bus().workers_ready() == 2; }));
  std::vector<std::uint64_t> hashes = loop.collect(3);
  Process forger({"/usr/bin/env", "python3", OMENTUM_TESTS_DIR "/hostile/forger.py",
                  std::to_string(domain.id()), "3"},
                 folder / "forger");
  // Batches that are complete wait meanwhile: every writer is at a number of its own.
  std::optional<int> code;
  loop.serve_until([&] { return (code = forger.wait(std::chrono::milliseconds(0))).has_value(); });
  ASSERT_EQ(code, 0) << "it found nobody";
  const std::int64_t ended_ns = steady_now_ns();
  for (const std::uint64_t hash : loop.collect(3)) hashes.push_back(hash);
  EXPECT_LT(steady_now_ns() - ended_ns, 15 * kS);
  RecordProperty("again_ms", static_cast<int>((steady_now_ns() - ended_ns) / 1'000'000));
  EXPECT_EQ(hashes, expected(loop_config(8, 0), 6));
}

}  // namespace
}  // namespace omentum
