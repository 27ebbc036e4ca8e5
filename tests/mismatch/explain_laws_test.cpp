// Laws of the statistics that decide (docs/mismatch.md 5), on drawn evidence.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "mismatch/explain/detection_limits.h"
#include "mismatch/explain/shares.h"
#include "mismatch/explain/spread.h"
#include "mismatch/explain/verdict_class.h"
#include "mismatch/linear_world.h"

namespace omentum {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

const Floors kFloors = {{"atom0", {0.2, ""}}, {"atom1", {0.2, ""}}, {"atom2", {0.2, ""}}};
const Thresholds kByDispersion = {6, 2, 1, 5, true};  // those of explain

std::vector<AtomGains> gains_of(std::span<const Evidence> recordings,
                                std::span<const std::string> fold_of = {}) {
  return left_out_gains(make_folds(recordings, fold_of).value(), kFloors).value();
}

/// The effect that atom 0 stands for acts in some recordings alone.
LinearWorld seen_in(unsigned seed, double amplitude, const std::vector<std::size_t>& recordings,
                    const WorldSize& size = {}) {
  LinearWorld world = draw_world(seed, {0, 0, 0}, size);
  const Index atom = world.recordings[0].b.size() - size.atoms;
  for (const std::size_t r : recordings) {
    world.rows[r].y += amplitude * world.rows[r].J.col(atom);
    world.recordings[r] =
        evidence_of(world.rows[r], world.recordings[r].numbers, world.recordings[r].name);
  }
  return world;
}

TEST(ExplainLaws, TheScoreOfAnAtomIsTheSlopeOfTheLogLikelihood) {
  LinearWorld world = draw_world(21, {1.5, 0, 0}, {.recordings = 3, .rows = 20});
  for (Evidence& recording : world.recordings) recording.numbers[0].sd = 1e3;
  const FoldEvidence folds = make_folds(world.recordings).value();
  const ProjectedAtoms atoms = project_atoms(folds).value();
  for (int k = 0; k < folds.atoms(); ++k) {
    const std::string& key = folds.atom(k).key;
    const double step = 1e-2;
    const double up = dense_log_density(world, key, step), at = dense_log_density(world, key, 0),
                 down = dense_log_density(world, key, -step);
    EXPECT_NEAR((up - down) / (2 * step), atoms.score[k], 1e-6 * std::fabs(atoms.score[k])) << key;
    EXPECT_NEAR((2 * at - up - down) / (step * step), atoms.information(k, k),
                1e-4 * atoms.information(k, k))
        << key;
  }
}

TEST(ExplainLaws, OrderOfRecordingsAndOfAtomsChangesNothing) {
  LinearWorld world = draw_world(22, {1.5, 0, 1.5});
  const VerdictClass before = judge_atoms(world.recordings, {}, kFloors).value();
  std::reverse(world.recordings.begin(), world.recordings.end());
  for (Evidence& recording : world.recordings) {
    const Index size = recording.b.size();
    const VectorXd places = VectorXd::LinSpaced(size, static_cast<double>(size - 1), 0);
    const auto order = places.cast<Index>().eval();
    recording.A = MatrixXd(recording.A(order, order));
    recording.b = VectorXd(recording.b(order));
    std::reverse(recording.numbers.begin(), recording.numbers.end());
  }
  const VerdictClass after = judge_atoms(world.recordings, {}, kFloors).value();
  EXPECT_EQ(before.winner, after.winner);
  EXPECT_EQ(before.members, after.members);
  ASSERT_EQ(before.gains.size(), after.gains.size());
  for (std::size_t k = 0; k < before.gains.size(); ++k) {
    EXPECT_EQ(before.gains[k].atom, after.gains[k].atom);
    EXPECT_NEAR(before.gains[k].trimmed, after.gains[k].trimmed, 1e-10);
  }
  ASSERT_EQ(before.entrants.size(), after.entrants.size());
  for (std::size_t k = 0; k < before.entrants.size(); ++k) {
    EXPECT_EQ(before.entrants[k].atom, after.entrants[k].atom);
    EXPECT_NEAR(before.entrants[k].left[0].gain, after.entrants[k].left[0].gain, 1e-10);
  }
}

TEST(ExplainLaws, EvidenceAddedTwiceShrinksSdByRootTwoAndLeavesTheAmplitude) {
  LinearWorld world = draw_world(23, {1.5, 0, 0});
  for (Evidence& recording : world.recordings) {
    for (Number& number : recording.numbers) number.sd = std::numeric_limits<double>::infinity();
  }
  const auto once = score_tests(make_folds(world.recordings).value()).value();
  for (Evidence& recording : world.recordings) {
    recording = add_evidence(recording, recording).value();
  }
  const auto twice = score_tests(make_folds(world.recordings).value()).value();
  for (std::size_t k = 0; k < once.size(); ++k) {
    EXPECT_NEAR(twice[k].amplitude, once[k].amplitude, 1e-12);
    EXPECT_NEAR(twice[k].sd, once[k].sd / std::sqrt(2), 1e-12);
  }
}

TEST(ExplainLaws, AnEffectInTheBaseVanishesFromTheClaimsAndComesBackTakenOut) {
  const LinearWorld world = draw_world(24, {1.5, 0, 0});
  const VerdictClass found = judge_atoms(world.recordings, {}, kFloors).value();
  EXPECT_EQ(found.winner, "atom0");
  EXPECT_THAT(found.members, ElementsAre("atom0"));
  const std::string base[] = {"atom0"};
  const auto repaired = with_in_base(world.recordings, base);
  const VerdictClass silent = judge_atoms(repaired, {}, kFloors).value();
  EXPECT_THAT(silent.entrants, IsEmpty());
  ASSERT_EQ(silent.gains.size(), 2U);
  const auto posterior = solve(sum_evidence(repaired).value()).value();
  EXPECT_EQ(posterior.numbers[0].key, "atom0");
  EXPECT_NEAR(posterior.mean[0], 1.5, 0.2);
  EXPECT_EQ(judge_atoms(world.recordings, {}, kFloors).value().winner, "atom0");
}

TEST(ExplainLaws, WhatCouldNotActAsItWasFoundIsNotClaimed) {
  VerdictClass judged = judge_atoms(draw_world(24, {1.5, 0, 1.5}).recordings, {}, kFloors).value();
  const auto names = [&] {
    std::vector<std::string> claimed;
    for (const Entrant& entrant : judged.entrants) claimed.push_back(entrant.atom);
    return claimed;
  };
  ASSERT_THAT(names(), testing::IsSupersetOf({"atom0", "atom2"}));
  withdraw("atom0", judged);
  EXPECT_THAT(names(), testing::Not(testing::Contains("atom0")));
  EXPECT_THAT(names(), testing::Contains("atom2"));
  EXPECT_FALSE(judged.gains[0].claimed);
  EXPECT_EQ(judged.gains[0].agreed, 0);
  EXPECT_TRUE(judged.gains[2].claimed);
}

TEST(ExplainLaws, TrimmingLeavesOutTheLargestAndTheSmallestOfFiveOrMore) {
  EXPECT_EQ(trimmed_sum({1, 100, 3, -50, 4}), 8);
  EXPECT_EQ(trimmed_sum({1, 100, 3, -50}), 54);
  EXPECT_EQ(trimmed_sum({7}), 7);
}

TEST(ExplainLaws, WhatActsInOneRecordingOfSevenAloneIsNeverClaimed) {
  for (const double amplitude : {3.0, 30.0}) {
    const auto alone = gains_of(seen_in(25, amplitude, {2}).recordings);
    EXPECT_FALSE(alone[0].claimed);
    const auto twice = gains_of(seen_in(25, amplitude, {2, 4}).recordings);
    EXPECT_GT(twice[0].folds[2].gain + twice[0].folds[4].gain, alone[0].total);
  }
}

TEST(ExplainLaws, ARecordingAndItsRepeatAreOneFold) {
  LinearWorld world = draw_world(26, {3, 0, 0}, {.recordings = 6});
  for (std::size_t r = 2; r < 6; ++r) {  // four recordings know next to nothing of the effect
    const Index atom = world.rows[r].J.cols() - 3;
    world.rows[r].y -= 0.98 * 3 * world.rows[r].J.col(atom);
    world.rows[r].J.col(atom) *= 0.02;
    world.recordings[r] =
        evidence_of(world.rows[r], world.recordings[r].numbers, world.recordings[r].name);
  }
  EXPECT_TRUE(gains_of(world.recordings)[0].claimed);
  const std::vector<std::string> folds = {"a", "a", "b", "c", "d", "e"};
  const auto gains = gains_of(world.recordings, folds);
  ASSERT_EQ(gains[0].folds.size(), 5U);
  EXPECT_EQ(gains[0].folds[0].fold, "a");
  EXPECT_FALSE(gains[0].claimed) << "one of five";
}

TEST(ExplainLaws, OneRecordingIsTestedInSampleAndSaysSo) {
  const LinearWorld world = draw_world(27, {2, 0, 0}, {.recordings = 1});
  const auto gains = gains_of(world.recordings);
  EXPECT_TRUE(gains[0].claimed);
  EXPECT_TRUE(gains[0].in_sample);
  const ScoreTest test = score_tests(make_folds(world.recordings).value()).value()[0];
  EXPECT_NEAR(gains[0].trimmed, std::pow((test.amplitude - 0.2) / test.sd, 2) / 2, 1e-9);
  EXPECT_FALSE(gains_of(draw_world(28, {0, 0, 0}, {.recordings = 1}).recordings)[0].claimed);
}

TEST(ExplainLaws, OfThreeRecordingsOneThatShouldGainAndDoesNotForbidsTheClaim) {
  EXPECT_TRUE(gains_of(seen_in(29, 3, {0, 1, 2}, {.recordings = 3}).recordings)[0].claimed);
  const auto against = gains_of(seen_in(29, 3, {0, 1}, {.recordings = 3}).recordings);
  EXPECT_FALSE(against[0].claimed);
  EXPECT_FALSE(against[0].against.empty());
}

TEST(ExplainLaws, TenTimesThePointsLeaveAnAmplitudeWithinTheFloorSilent) {
  LinearWorld world = draw_world(30, {0.15, 0, 0}, {.rows = 600});
  EXPECT_GT(score_tests(make_folds(world.recordings).value()).value()[0].z, 5);
  EXPECT_EQ(gains_of(world.recordings)[0].total, 0);
  for (Evidence& recording : world.recordings) {
    recording.A *= 10;
    recording.b *= 10;
  }
  EXPECT_EQ(gains_of(world.recordings)[0].total, 0);
  EXPECT_FALSE(gains_of(world.recordings)[0].claimed);
}

TEST(ExplainLaws, TheForetoldGainIsTheMeanGainOfDrawnRecordings) {
  double foretold = 0, gained = 0;
  for (unsigned seed = 100; seed < 200; ++seed) {
    const auto gains = gains_of(draw_world(seed, {0.6, 0, 0}).recordings);
    for (const FoldGain& fold : gains[0].folds) {
      foretold += fold.foretold / 700;
      gained += fold.gain / 700;
    }
  }
  EXPECT_GT(foretold, 3);
  EXPECT_NEAR(gained, foretold, 0.1 * foretold);
}

TEST(ExplainLaws, AnEffectAtItsLimitIsClaimedInFourOfFiveDraws) {
  int claimed = 0, silent = 0;
  for (unsigned seed = 300; seed < 500; ++seed) {
    const FoldEvidence planned = make_folds(draw_world(seed, {0, 0, 0}).recordings).value();
    const DetectionLimit limit = detection_limits(planned, kFloors).value()[0];
    claimed += gains_of(draw_world(seed, {limit.detected, 0, 0}).recordings)[0].claimed ? 1 : 0;
    const double half = limit.floor.amplitude + 5 * (limit.detected - limit.floor.amplitude) / 11;
    silent += gains_of(draw_world(seed, {half, 0, 0}).recordings)[0].claimed ? 0 : 1;
  }
  EXPECT_GT(claimed, 150) << "of 200; 84 % are foretold";
  EXPECT_EQ(silent, 200) << "at 5 sd beyond the floor";
}

TEST(ExplainLaws, AnEffectAtItsLimitIsClaimedInFourOfFiveDrawsByItsDispersionToo) {
  int claimed = 0;
  for (unsigned seed = 300; seed < 500; ++seed) {
    const FoldEvidence planned = make_folds(draw_world(seed, {0, 0, 0}).recordings).value();
    const double amplitude = detection_limits(planned, kFloors, kByDispersion).value()[0].detected;
    const LinearWorld world = draw_world(seed, {amplitude, 0, 0});
    const FoldEvidence folds = make_folds(world.recordings).value();
    claimed += left_out_gains(folds, kFloors, kByDispersion).value()[0].claimed ? 1 : 0;
  }
  EXPECT_NEAR(claimed, 168, 18) << "of 200; 84 % are foretold";
}

TEST(ExplainLaws, WhatScattersMoreMustBeLargerToBeClaimed) {
  const FoldEvidence folds = make_folds(draw_world(36, {0, 0, 0}).recordings).value();
  const auto limit = [&](double dispersion) {
    const auto found = detection_limits(folds, kFloors, kByDispersion, dispersion).value()[0];
    return found.detected - found.floor.amplitude;
  };
  EXPECT_NEAR(limit(9), 3 * limit(1), 1e-12);
}

TEST(ExplainLaws, AFloorIsWhatOneNumericsColumnLeftOutDoesToTheAmplitude) {
  const LinearWorld world = draw_world(31, {0, 0, 0}, {.numerics = 2});
  const Floors floors = amplitude_floors(world.recordings, 1.25).value();
  double largest = 0;
  std::string makes;
  for (const Index column : {3, 4}) {
    // The rows are that column, and the fit does not have it.
    std::vector<Evidence> without;
    for (std::size_t r = 0; r < world.rows.size(); ++r) {
      LinearRows rows = world.rows[r];
      rows.y = rows.J.col(column);
      rows.J.col(column).setZero();
      without.push_back(evidence_of(rows, world.recordings[r].numbers, world.recordings[r].name));
    }
    const double amplitude =
        std::fabs(score_tests(make_folds(without).value()).value()[1].amplitude);
    if (amplitude > largest) makes = "numerics" + std::to_string(column - 3);
    largest = std::max(largest, amplitude);
  }
  EXPECT_NEAR(floors.at("atom1").amplitude, 1.25 * largest, 1e-12);
  EXPECT_EQ(floors.at("atom1").numerics, makes);
}

TEST(ExplainLaws, FloorsTakeAColumnOfEachRecordingTogetherAndMoveItByItsStep) {
  LinearWorld world = draw_world(32, {0, 0, 0});
  const double shared = amplitude_floors(world.recordings, 1).value().at("atom0").amplitude;
  for (Evidence& recording : world.recordings) recording.numbers[3].owner = recording.name;
  EXPECT_NEAR(amplitude_floors(world.recordings, 1).value().at("atom0").amplitude, shared, 1e-12);
  for (Evidence& recording : world.recordings) recording.numbers[3].floor_step = 5;
  EXPECT_NEAR(amplitude_floors(world.recordings, 1).value().at("atom0").amplitude, 5 * shared,
              1e-12);
}

TEST(ExplainLaws, AnAtomThatTheBaseCanImitateIsNotTestable) {
  LinearWorld world = draw_world(33, {0, 0, 0});
  for (std::size_t r = 0; r < world.rows.size(); ++r) {
    const Index atom = world.rows[r].J.cols() - 3;
    world.rows[r].J.col(atom) = 2 * world.rows[r].J.col(0);
    world.recordings[r] =
        evidence_of(world.rows[r], world.recordings[r].numbers, world.recordings[r].name);
  }
  const FoldEvidence folds = make_folds(world.recordings).value();
  EXPECT_FALSE(score_tests(folds).value()[0].testable);
  EXPECT_EQ(gains_of(world.recordings)[0].total, 0);
  const DetectionLimit limit = detection_limits(folds, kFloors).value()[0];
  EXPECT_FALSE(limit.testable);
  EXPECT_TRUE(std::isinf(limit.detected));
  EXPECT_TRUE(std::isinf(limit.named));
}

TEST(ExplainLaws, AtomsOfOneEffectAreNoRivalsOfItsNamedLimit) {
  LinearWorld world = draw_world(34, {0, 0, 0});
  const auto rivals = detection_limits(make_folds(world.recordings).value(), kFloors).value();
  EXPECT_EQ(rivals[1].look_alike, "atom2");
  EXPECT_GT(rivals[1].named, 1.3 * rivals[1].detected - kFloors.at("atom1").amplitude);
  for (Evidence& recording : world.recordings) {
    for (Number& number : recording.numbers) {
      if (number.key == "atom1" || number.key == "atom2") number.effect = "inclusion";
    }
  }
  const auto places = detection_limits(make_folds(world.recordings).value(), kFloors).value();
  EXPECT_EQ(places[1].look_alike, "atom0");
  EXPECT_LT(places[1].named, 1.1 * places[1].detected);
}

TEST(ExplainLaws, PullsAreThoseOfTheFitOfAllNumbersAtOnce) {
  const LinearWorld world = draw_world(35, {0, 0, 0});
  const Posterior whole = solve(sum_evidence(world.recordings).value()).value();
  const auto found = pulls(world.recordings).value();
  ASSERT_EQ(found.size(), 1U + 7U * 2U) << "base numbers have none";
  for (const Pull& pull : found) {
    std::size_t k = 0;
    while (whole.numbers[k].key != pull.key || whole.numbers[k].owner != pull.owner) ++k;
    EXPECT_NEAR(pull.pull, whole.pull(k), 1e-12) << pull.key << " of " << pull.owner;
  }
  for (std::size_t k = 1; k < found.size(); ++k) {
    EXPECT_GE(std::fabs(found[k - 1].pull), std::fabs(found[k].pull));
  }
}

TEST(ExplainLaws, APullOfOneFoldOfFiveAloneDoesNotCount) {
  std::map<std::string, std::string> folds;
  for (const char* name : {"a", "b", "c", "d", "e"}) folds[name] = name;
  folds["again"] = "a";  // a repeat of a
  const auto own = [](const char* recording, double pull) {
    return Pull{"own", recording, NumberRole::kNuisance, 0, pull};
  };
  const std::vector<Pull> alone = {own("a", 9), own("again", 8), own("c", -2)};
  EXPECT_EQ(repeated_pull(alone, folds)->owner, "c");
  const std::vector<Pull> shared = {
      own("a", 9), {"clock", "", NumberRole::kNuisance, 0, 6}, own("b", 5)};
  EXPECT_EQ(repeated_pull(shared, folds)->key, "clock");
  folds.erase("e");
  EXPECT_EQ(repeated_pull(alone, folds)->owner, "a") << "as gains of fewer folds, not trimmed";
  EXPECT_FALSE(repeated_pull({}, folds).has_value());
}

TEST(ExplainLaws, ANuisancePulledTooFarLeavesNoAtomAdequate) {
  LinearWorld world = draw_world(36, {2, 0, 0});
  // Recording 3 moved by ten times what is believed of its own number 0.
  world.rows[3].y += 3.0 * world.rows[3].J.col(4);
  world.recordings[3] = evidence_of(world.rows[3], world.recordings[3].numbers, "recording3");
  const VerdictClass verdict = judge_atoms(world.recordings, {}, kFloors).value();
  EXPECT_EQ(verdict.winner, "atom0");
  EXPECT_EQ(verdict.entrants[0].largest_pull.key, "own0");
  EXPECT_EQ(verdict.entrants[0].largest_pull.owner, "recording3");
  EXPECT_THAT(verdict.members, IsEmpty());
}

TEST(ExplainLaws, HeldOutRecordingsGainWhatTheFitForetells) {
  const FoldEvidence folds = make_folds(draw_world(37, {1.5, 0, 0}).recordings).value();
  const std::size_t held_out[] = {1, 5};
  const auto gains = held_out_gains(folds, held_out, kFloors).value();
  ASSERT_EQ(gains[0].size(), 2U);
  for (const FoldGain& fold : gains[0]) {
    EXPECT_GT(fold.foretold, 4);
    EXPECT_GT(fold.gain, 0);
  }
  EXPECT_EQ(gains[0][1].fold, "recording5");
  EXPECT_LT(gains[1][0].gain, 1);
}

/// A recording that says `estimate` of one free number, with this information.
Evidence saying(const std::string& name, double estimate, double information) {
  Evidence evidence;
  evidence.name = name;
  evidence.numbers.emplace_back().key = "number";
  evidence.A = MatrixXd::Constant(1, 1, information);
  evidence.b = VectorXd::Constant(1, information * estimate);
  return evidence;
}

TEST(ExplainLaws, IntervalsAreThePosteriorsWhereRecordingsAgreeAndWiderWhereTheyContradict) {
  const std::vector<std::string> keys = {"number"}, folds = {"a", "b", "c"};
  const std::vector<Evidence> agree = {saying("a", 0, 4), saying("b", 0, 4), saying("c", 0, 4)};
  EXPECT_NEAR(spread_of(keys, agree, folds).value().sd[0], 1 / std::sqrt(12), 1e-12);
  // Of equal recordings the jackknife is the standard error of the mean of what each says.
  const std::vector<Evidence> apart = {saying("a", -3, 4), saying("b", 1, 4), saying("c", 2, 4)};
  const double standard_error = std::sqrt((9.0 + 1 + 4) / (3 * 2));
  EXPECT_NEAR(spread_of(keys, apart, folds).value().sd[0],
              std::sqrt(1.0 / 12 + standard_error * standard_error), 1e-12);
  // What all would move it by counts, too: it stands where none of them is.
  const std::vector<Evidence> moved = {saying("a", 2, 4), saying("b", 2, 4), saying("c", 2, 4)};
  EXPECT_NEAR(spread_of(keys, moved, folds).value().sd[0], std::sqrt(1.0 / 12 + 4), 1e-12);
  // Variances that a jackknife finds against those that the posterior states.
  EXPECT_EQ(spread_of(keys, agree, folds).value().dispersion, 1);
  EXPECT_NEAR(spread_of(keys, apart, folds).value().dispersion,
              standard_error * standard_error * 12, 1e-9);
  EXPECT_THAT(spread_of(std::vector<std::string>{"other"}, agree, folds).error(),
              HasSubstr("no number is called other"));
}

TEST(ExplainLaws, AFoldIsForetoldByTheOthersAlone) {
  // One row that is the number, with noise: a normal density about what the others say of it.
  const auto normal = [](const std::string& name, double seen, double information) {
    Evidence evidence = saying(name, seen, information);
    evidence.log_constant =
        (std::log(information / (2 * std::numbers::pi)) - information * seen * seen) / 2;
    return evidence;
  };
  const std::vector<Evidence> seen = {normal("r0", 1.5, 4), normal("r1", 1, 2), normal("r2", 3, 1)};
  const std::vector<std::string> each = {"a", "b", "c"};
  const auto densities = foretold_densities(seen, each).value();
  ASSERT_EQ(densities.size(), 3U);
  EXPECT_EQ(densities[0].fold, "a");
  const double others = (2 * 1 + 1 * 3) / 3.0, variance = 1 / 3.0 + 1 / 4.0;
  EXPECT_NEAR(
      densities[0].log_density,
      -std::log(2 * std::numbers::pi * variance) / 2 - std::pow(1.5 - others, 2) / (2 * variance),
      1e-12);
  // A repeat is foretold together with what it repeats.
  const std::vector<std::string> repeated = {"a", "b", "a"};
  const auto together = foretold_densities(seen, repeated).value();
  ASSERT_EQ(together.size(), 2U);
  const std::vector<Evidence> swapped = {seen[1], seen[2], seen[0]};
  EXPECT_NEAR(
      together[0].log_density,
      foretold_densities(swapped, std::vector<std::string>{"b", "a", "a"}).value()[1].log_density,
      1e-12);
  // What no other fold says is open, unless something is believed of it.
  const std::vector<Evidence> alone = {seen[0]};
  EXPECT_NEAR(foretold_densities(alone, std::vector<std::string>{"a"}).value()[0].log_density, 0,
              1e-12);
}

TEST(ExplainLaws, SharesAreTheMixtureThatForetellsBest) {
  MatrixXd density(4, 3);
  density << 0, 5, 5, 0, 6, 6, 0, 7, 7, 0, 4, 4;
  const VectorXd twins = stacking_weights(density);
  EXPECT_NEAR(twins.sum(), 1, 1e-12);
  EXPECT_LT(twins[0], 1e-6);
  EXPECT_NEAR(twins[1], 0.5, 1e-6) << "two that foretell the same share alike";
  // Half of the folds are foretold by one, half by the other.
  MatrixXd halves(2, 2);
  halves << 0, 3, 3, 0;
  EXPECT_NEAR(stacking_weights(halves)[0], 0.5, 1e-12);
  halves << 0, 300, 0, 400;
  EXPECT_NEAR(stacking_weights(halves)[1], 1, 1e-12);
  // On drawn evidence the effect has nearly all of it, and a look-alike the rest.
  const auto gains = gains_of(draw_world(39, {0, 1.5, 0}).recordings);
  MatrixXd drawn = MatrixXd::Zero(7, 4);
  for (Index k = 0; k < 3; ++k) {
    for (Index r = 0; r < 7; ++r) {
      drawn(r, k + 1) =
          gains[static_cast<std::size_t>(k)].folds[static_cast<std::size_t>(r)].against_zero;
    }
  }
  EXPECT_GT(stacking_weights(drawn)[2], 0.9);
}

TEST(ExplainLaws, AnOpenNumberIsToldWithTheFoldThatKnewIt) {
  LinearWorld world = draw_world(38, {0, 0, 0});
  for (std::size_t r = 1; r < world.recordings.size(); ++r) {
    Evidence& recording = world.recordings[r];
    recording.A.row(0).setZero();
    recording.A.col(0).setZero();
    recording.b[0] = 0;
  }
  const auto gains = left_out_gains(make_folds(world.recordings).value(), kFloors);
  ASSERT_FALSE(gains);
  EXPECT_THAT(gains.error(),
              HasSubstr("without recording0: data and prior leave numbers open: base0"));
  EXPECT_THAT(make_folds({}).error(), HasSubstr("no recording"));
  const std::string unknown[] = {"suction"};
  EXPECT_THAT(with_in_base(make_folds(world.recordings).value(), unknown).error(),
              HasSubstr("no atom is called suction"));
}

}  // namespace
}  // namespace omentum
