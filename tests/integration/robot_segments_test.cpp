// Segments of a robot on the bus of a training: seen, counted, never trained on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>

#include "core/segment_fields.h"
#include "core/wire.h"
#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::Programs;
using test::operator+;
using testing::HasSubstr;

/// Publishes each segment of the workers again at once as one of a robot, with other rewards and
/// actions: whoever trains on one of them has other weights.
class Echo {
 public:
  Echo(std::uint32_t domain, const std::string& run)
      : thread_([this, domain, run](const std::stop_token& stop) { echo(domain, run, stop); }) {}
  std::uint64_t sent() const { return sent_; }
  /// As the learner's last status tells; the ledgers that were seen balanced.
  std::uint64_t counted_foreign() const { return foreign_; }

 private:
  void echo(std::uint32_t domain, const std::string& run, const std::stop_token& stop) {
    const dds::Participant participant(domain, test::loopback_profile().uri, "robot");
    BusReader<RolloutSegment> reader(participant, run_partition(run), "robot", 64, true);
    BusWriter<RolloutSegment> writer(participant, public_partitions(run), "robot", 16);
    dds::Waitset waitset(participant);
    waitset.attach(reader.raw());
    BusReader<LearnerStatus> learner(participant, run_partition(run), "robot-learner");
    waitset.attach(learner.raw());
    while (!stop.stop_requested()) {
      waitset.wait(20'000'000);
      const Result<int> taken = reader.take(64, [&](Arrival<RolloutSegment>&& arrival) {
        RolloutSegment& segment = arrival.record;
        if (!arrival.info.valid || segment.source != Source::kSimulation) return;
        segment.source = Source::kDvrk;
        for (float& reward : segment.rewards) reward += 1;
        for (std::uint8_t& action : segment.actions) action = 0;
        if (sent_ % 2 == 0) segment.worker_id ^= 0x5a5a;  // a gateway has an id of its own
        segment.payload_crc32c = segment_crc(segment);
        if (writer.write(segment)) ++sent_;
      });
      EXPECT_TRUE(taken);
      EXPECT_TRUE(learner.take(16, [&](Arrival<LearnerStatus>&& arrival) {
        if (!arrival.info.valid) return;
        const LearnerStatus& l = arrival.record;
        EXPECT_EQ(l.received,
                  l.admitted + l.duplicate + l.stale + l.invalid + l.foreign + l.overflow);
        EXPECT_EQ(l.duplicate + l.stale + l.invalid, 0U) << "none was taken for a worker's";
        foreign_ = l.foreign;
      }));
    }
  }

  std::atomic<std::uint64_t> sent_{0}, foreign_{0};
  std::jthread thread_;  // last: uses the other
};

TEST(RobotSegments, TrainingEndsWithTheSameWeightsAndCountsThemAsForeign) {
  Programs programs;
  test::Process worker = programs.worker("watched", {"--lanes", "6"});
  test::Process learner = programs.learner("watched", test::endless_task());
  const Echo robot(programs.domain(), "watched");
  EXPECT_TRUE(test::eventually([&] { return robot.counted_foreign() > 0; }));
  EXPECT_LE(robot.counted_foreign(), robot.sent());
  programs.expect_goes_on_undisturbed("watched", learner);
  const std::string log = test::read_text(programs.err("watched"));
  EXPECT_THAT(log, testing::Not(HasSubstr("event=segment_of_stranger")));
}

}  // namespace
}  // namespace omentum
