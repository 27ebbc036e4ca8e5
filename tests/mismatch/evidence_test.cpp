// Evidence of recordings as values: made, added, integrated, solved.
#include "mismatch/evidence/evidence.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "mismatch/linear_world.h"

namespace omentum {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using testing::HasSubstr;

const std::vector<double> kTruth = {1.5, 0, 0};

TEST(Evidence, AddedTwiceIsEvidenceOfTwiceTheData) {
  const LinearWorld world = draw_world(1, kTruth);
  const Evidence& once = world.recordings[0];
  const Evidence twice = add_evidence(once, once).value();
  ASSERT_EQ(twice.numbers.size(), once.numbers.size());
  EXPECT_DOUBLE_EQ(twice.log_constant, 2 * once.log_constant);
  // The same rows one below the other.
  LinearRows rows = world.rows[0];
  rows.J = MatrixXd(2 * world.rows[0].J.rows(), world.rows[0].J.cols());
  rows.J << world.rows[0].J, world.rows[0].J;
  rows.y = VectorXd(2 * world.rows[0].y.size());
  rows.y << world.rows[0].y, world.rows[0].y;
  const Posterior added = solve(twice).value();
  const Posterior stacked = solve(evidence_of(rows, once.numbers, "both")).value();
  EXPECT_NEAR(added.log_evidence, stacked.log_evidence, 1e-9);
  for (std::size_t k = 0; k < added.numbers.size(); ++k) {
    const auto other = std::find_if(stacked.numbers.begin(), stacked.numbers.end(),
                                    [&](const Number& x) { return x.key == added.numbers[k].key; });
    const Index at = other - stacked.numbers.begin();
    EXPECT_NEAR(added.mean[static_cast<Index>(k)], stacked.mean[at], 1e-12);
  }
}

TEST(Evidence, AddsByKeySoThatTheOrderOfNumbersAndRecordingsDoesNotMatter) {
  LinearWorld world = draw_world(2, kTruth);
  const Evidence sum = sum_evidence(world.recordings).value();
  EXPECT_EQ(sum.numbers.size(), 3U + 1U + 7U * 2U + 3U)
      << "own numbers stay those of each recording";
  const Posterior before = solve(sum).value();
  std::reverse(world.recordings.begin(), world.recordings.end());
  for (Evidence& recording : world.recordings) {
    const Index size = recording.b.size();
    const auto order =
        VectorXd::LinSpaced(size, static_cast<double>(size - 1), 0).cast<Index>().eval();
    recording.A = MatrixXd(recording.A(order, order));
    recording.b = VectorXd(recording.b(order));
    std::reverse(recording.numbers.begin(), recording.numbers.end());
  }
  const Posterior after = solve(sum_evidence(world.recordings).value()).value();
  EXPECT_LT((before.mean - after.mean).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_LT((before.covariance - after.covariance).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_NEAR(before.log_evidence, after.log_evidence, 1e-9);
}

TEST(Evidence, OwnNumbersIntegratedLeaveTheFitOfTheSharedOnesAsItWas) {
  const LinearWorld world = draw_world(3, kTruth);
  const Posterior whole = solve(sum_evidence(world.recordings).value()).value();
  std::vector<Evidence> integrated;
  for (const Evidence& recording : world.recordings) {
    integrated.push_back(integrate_own(recording).value());
  }
  const Posterior shared = solve(sum_evidence(integrated).value()).value();
  ASSERT_EQ(shared.numbers.size(), 4U);
  for (std::size_t k = 0; k < 4; ++k) {
    const auto at = static_cast<Index>(k);
    EXPECT_EQ(shared.numbers[k].key, whole.numbers[k].key);
    EXPECT_NEAR(shared.mean[at], whole.mean[at], 1e-12);
    EXPECT_NEAR(shared.covariance(at, at), whole.covariance(at, at), 1e-12);
  }
  EXPECT_NEAR(shared.log_evidence, whole.log_evidence, 1e-9);
}

TEST(Evidence, IntegratesToTheDensityOfTheRows) {
  LinearWorld world = draw_world(4, kTruth, {.recordings = 2, .rows = 20});
  for (Evidence& recording : world.recordings) recording.numbers[0].sd = 1e3;
  const Posterior posterior = solve(sum_evidence(world.recordings).value()).value();
  EXPECT_NEAR(posterior.log_evidence, dense_log_density(world, "", 0), 1e-7);
}

TEST(Evidence, APriorOffZeroPullsTheFitAndThePullSaysHowFar) {
  Evidence evidence;
  evidence.name = "one row";
  evidence.numbers = {{"x", "", NumberRole::kNuisance, 2, 0.5, "m"}};
  evidence.A = MatrixXd::Constant(1, 1, 4);
  evidence.b = VectorXd::Constant(1, 4);  // the row says 1
  const Posterior posterior = solve(evidence).value();
  EXPECT_DOUBLE_EQ(posterior.mean[0], 1.5);
  EXPECT_DOUBLE_EQ(posterior.covariance(0, 0), 1.0 / 8);
  EXPECT_DOUBLE_EQ(posterior.pull(0), -1);
}

TEST(Evidence, NamesTheNumberThatDataAndPriorLeaveOpen) {
  LinearWorld world = draw_world(5, kTruth);
  Evidence& recording = world.recordings[0];
  recording.A.row(0).setZero();
  recording.A.col(0).setZero();
  recording.b[0] = 0;
  const auto open = solve(recording);
  ASSERT_FALSE(open);
  EXPECT_THAT(open.error(), HasSubstr("recording0: data and prior leave numbers open: base0"));
  recording.numbers[0].sd = 1;
  EXPECT_TRUE(solve(recording));
  // Two free numbers with one column.
  Evidence twins = world.recordings[1];
  twins.numbers[1].sd = twins.numbers[0].sd;
  twins.A.row(1) = twins.A.row(0);
  twins.A.col(1) = twins.A.col(0);
  EXPECT_THAT(solve(twins).error(), HasSubstr("leave numbers open: base"));
}

TEST(Evidence, RefusesWhatContradictsItself) {
  const LinearWorld world = draw_world(6, kTruth);
  const auto error = [&](auto change) {
    Evidence changed = world.recordings[0];
    change(changed);
    const auto sum = add_evidence(world.recordings[1], changed);
    return sum ? std::string("none") : sum.error();
  };
  EXPECT_EQ(error([](Evidence&) {}), "none");
  EXPECT_THAT(error([](Evidence& e) { e.numbers[1].sd = 0.4; }),
              HasSubstr("base1 has another role or prior elsewhere"));
  EXPECT_THAT(error([](Evidence& e) { e.numbers[1].sd = 0; }),
              HasSubstr("base1 has no positive sd"));
  EXPECT_THAT(error([](Evidence& e) { e.numbers[1].key = "base0"; }),
              HasSubstr("base0 stands twice"));
  EXPECT_THAT(error([](Evidence& e) { e.numbers.pop_back(); }), HasSubstr("another size"));
  EXPECT_THAT(error([](Evidence& e) { e.b[0] = std::nan(""); }), HasSubstr("not finite"));
  EXPECT_THAT(error([](Evidence& e) { e.A(0, 1) += 1; }), HasSubstr("not symmetric"));
  EXPECT_THAT(error([](Evidence& e) { e.A(0, 0) = -1; }), HasSubstr("negative information"));
  EXPECT_THAT(error([](Evidence& e) { e.numbers.back().owner = "recording0"; }),
              HasSubstr("atom2 of recording0 is an atom of one recording alone"));
}

}  // namespace
}  // namespace omentum
