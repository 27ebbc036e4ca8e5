#include "monitor/run_state.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "monitor/top.h"
#include "tests/monitor/run_fixture.h"

namespace omentum {
namespace {

using test::arrived;
using test::ended;
using test::some_learner;
using test::some_worker;
using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr std::int64_t kNow = 100'000'000'000;

TEST(RunState, AnOlderLearnerChangesNothing) {
  RunState state("fixture");
  state.apply(arrived(some_learner()), kNow);
  LearnerStatus older = some_learner();
  older.learner_epoch = 6;
  older.policy_version = 900;
  state.apply(arrived(older), kNow);
  EXPECT_EQ(state.learner()->policy_version, 12u);
  state.apply(ended(older, dds::InstanceState::kNoWriters), kNow);
  EXPECT_EQ(state.learner_presence(kNow), Presence::kAlive);
}

TEST(RunState, ACurveBeginsWithTheFirstUpdateOfASession) {
  RunState state("fixture");
  LearnerStatus resumed = some_learner();
  resumed.steps_per_s = 0;
  resumed.mean_return = 0;
  state.apply(arrived(resumed), kNow);
  EXPECT_THAT(state.curve(), IsEmpty());
  LearnerStatus updated = some_learner();
  ++updated.policy_version;
  state.apply(arrived(updated), kNow);
  EXPECT_EQ(state.curve().size(), 1u);
}

TEST(RunState, AWorkerThatLeftIsGoneAndOneThatCrashedIsAnAlarm) {
  RunState state("fixture");
  state.apply(arrived(some_learner()), kNow);
  for (const std::uint32_t id : {1U, 2U}) state.apply(arrived(some_worker(id)), kNow);
  EXPECT_THAT(alarms_of(state, kNow), IsEmpty());
  state.apply(ended(some_worker(1), dds::InstanceState::kDisposed), kNow);
  state.apply(ended(some_worker(2), dds::InstanceState::kNoWriters), kNow);
  EXPECT_FALSE(state.workers().contains(1));
  EXPECT_THAT(alarms_of(state, kNow), Contains(HasSubstr("worker 2 on node2: lost")));
}

// DDS tells the end with the last sample where that was not taken yet, and not by itself.
TEST(RunState, AnEndThatComesWithTheLastStatusCounts) {
  RunState state("fixture");
  const auto last_word = [](auto status, dds::InstanceState end) {
    auto arrival = ended(status, end);
    arrival.info.valid = true;
    return arrival;
  };
  state.apply(last_word(some_worker(1), dds::InstanceState::kDisposed), kNow);
  state.apply(last_word(some_worker(2), dds::InstanceState::kNoWriters), kNow);
  state.apply(last_word(some_learner(), dds::InstanceState::kNoWriters), kNow);
  EXPECT_FALSE(state.workers().contains(1));
  EXPECT_TRUE(state.workers().at(2).lost);
  EXPECT_EQ(state.learner_presence(kNow), Presence::kLost);
}

TEST(RunState, WhoSaysNothingForLongIsSilent) {
  RunState state("fixture");
  state.apply(arrived(some_learner()), kNow);
  state.apply(arrived(some_worker(1)), kNow);
  EXPECT_THAT(alarms_of(state, kNow + kSilentNs), IsEmpty());
  const auto alarms = alarms_of(state, kNow + kSilentNs + 1);
  EXPECT_THAT(alarms, Contains(HasSubstr("learner: silent")));
  EXPECT_THAT(alarms, Contains(HasSubstr("node1: silent")));
}

TEST(RunState, ALedgerOffByOneIsAnAlarm) {
  RunState state("fixture");
  LearnerStatus learner = some_learner();
  EXPECT_TRUE(balance_of(learner).balanced());
  ++learner.received;
  EXPECT_EQ(balance_of(learner).received, 1);
  state.apply(arrived(learner), kNow);
  EXPECT_THAT(alarms_of(state, kNow), Contains(HasSubstr("does not balance")));
}

TEST(RunState, TheCurveHoldsOnePointPerUpdateAndStaysBounded) {
  RunState state("fixture");
  LearnerStatus learner = some_learner();
  for (std::uint64_t update = 1; update <= 10'000; ++update) {
    learner.policy_version = update;
    learner.steps_total = 100 * update;
    state.apply(arrived(learner), kNow);
    state.apply(arrived(learner), kNow);  // told again within the update
    if (update == 300) {
      EXPECT_EQ(state.curve().size(), 300u);
    }
  }
  EXPECT_LT(state.curve().size(), 1000u);
  EXPECT_GT(state.curve().size(), 400u);
  EXPECT_GT(state.curve().back().steps, 990'000u);
  for (std::size_t k = 1; k < state.curve().size(); ++k)
    EXPECT_GT(state.curve()[k].steps, state.curve()[k - 1].steps);
}

TEST(RunState, AResumedRunTakesItsCurveUpAtItsCheckpoint) {
  RunState state("fixture");
  LearnerStatus learner = some_learner();
  for (std::uint64_t update = 1; update <= 10; ++update) {
    learner.policy_version = update;
    learner.steps_total = 100 * update;
    state.apply(arrived(learner), kNow);
  }
  ++learner.learner_epoch;
  learner.policy_version = 6;
  learner.steps_total = 600;
  state.apply(arrived(learner), kNow);
  EXPECT_EQ(state.curve().size(), 6u);
}

TEST(TopTable, ShowsTheFiguresOfLearnerAndWorkers) {
  RunState state("fixture");
  state.apply(arrived(some_learner()), kNow);
  WorkerStatus worker = some_worker(3);
  worker.warnings = {"small buffers"};
  state.apply(arrived(worker), kNow);
  const std::string table = make_top_table(state, kNow);
  EXPECT_THAT(table, HasSubstr("updating (alive), epoch 7, policy 12"));
  EXPECT_THAT(table, HasSubstr("250000 of 1000000 steps, 25.0 %, 5000 steps/s, 2 min 30 s left"));
  EXPECT_THAT(table, HasSubstr("balance    ok"));
  EXPECT_THAT(table, HasSubstr("node3"));
  EXPECT_THAT(table, HasSubstr("small buffers"));
  EXPECT_THAT(table, HasSubstr("alarms     none"));
}

TEST(TopTable, TextOfAWorkerCannotSteerTheTerminal) {
  RunState state("fixture");
  WorkerStatus worker = some_worker(3);
  worker.host = "\x1b[2Jevil";
  worker.warnings = {"a\nb\x07"};
  state.apply(arrived(worker), kNow);
  const std::string table = make_top_table(state, kNow);
  EXPECT_THAT(table, Not(HasSubstr("\x1b")));
  EXPECT_THAT(table, Not(HasSubstr("\x07")));
  EXPECT_THAT(table, HasSubstr("?[2Jevil"));
}

TEST(RunState, ARobotThatIsStoppedSilentOrLostIsAnAlarm) {
  RunState state("fixture");
  state.apply(arrived(test::some_robot()), kNow);
  EXPECT_THAT(alarms_of(state, kNow),
              testing::ElementsAre("robot PSM1 of console: stopped: step of 0.7 mm"))
      << "and none for a learner, which a policy of a file does not need";
  EXPECT_THAT(alarms_of(state, kNow + kSilentNs + 1),
              testing::ElementsAre("robot PSM1 of console: silent"));
  state.apply(ended(test::some_robot(), dds::InstanceState::kNoWriters), kNow);
  EXPECT_THAT(alarms_of(state, kNow), testing::ElementsAre("robot PSM1 of console: lost"));
  state.apply(ended(test::some_robot(), dds::InstanceState::kDisposed), kNow);
  EXPECT_TRUE(state.robots().empty());
}

TEST(TopTable, ShowsPhaseReasonPlaceTimesAndCountersOfARobot) {
  RunState state("fixture");
  RobotStatus robot = test::some_robot();
  robot.host = "\x1b[2Jevil";
  state.apply(arrived(robot), kNow);
  const std::string table = make_top_table(state, kNow);
  EXPECT_THAT(table, HasSubstr("PSM1 of ?[2Jevil (pid 77): stopped, ENABLED, homed"));
  EXPECT_THAT(table, HasSubstr("STEP: step of 0.7 mm"));
  EXPECT_THAT(table, HasSubstr("(10.0, -20.0, 30.5) mm"));
  EXPECT_THAT(table, HasSubstr("latency 0.21 (max 1.34) ms, jitter -"));
  EXPECT_THAT(table, HasSubstr("malformed 3"));
  EXPECT_THAT(table, HasSubstr("2: 2 STEP"));
  EXPECT_THAT(table, Not(HasSubstr("\x1b")));
}

TEST(TopTable, DurationsAreShort) {
  EXPECT_EQ(short_duration(0.4), "0 s");
  EXPECT_EQ(short_duration(150), "2 min 30 s");
  EXPECT_EQ(short_duration(3725), "1 h 2 min");
  EXPECT_EQ(short_duration(200'000), "2 d 7 h");
  EXPECT_EQ(short_duration(-1), "unknown time");
}

}  // namespace
}  // namespace omentum
