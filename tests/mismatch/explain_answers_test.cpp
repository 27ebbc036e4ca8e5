// Known answers of nine small worlds, by a reading of docs/mismatch.md 5 that shares no code with
// ours.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "mismatch/explain/detection_limits.h"
#include "mismatch/explain/verdict_class.h"

namespace omentum {
namespace {

using nlohmann::json;

json read(const std::string& name) {
  std::ifstream file(std::string(OMENTUM_TESTS_DIR) + "/mismatch/explain_algebra/" + name);
  return json::parse(file);
}

struct World {
  std::vector<Evidence> recordings;
  Floors floors;
};

World world_of(const json& stored) {
  World world;
  std::vector<Number> numbers;
  const auto add = [&](const json& keys, const json& sds, NumberRole role) {
    for (std::size_t k = 0; k < keys.size(); ++k) {
      Number& number = numbers.emplace_back();
      number.key = keys[k];
      number.role = number.key.starts_with("numerics.")       ? NumberRole::kNumerics
                    : number.key.starts_with("registration.") ? NumberRole::kNuisance
                                                              : role;
      if (!sds[k].is_null()) number.sd = sds[k];
    }
  };
  add(stored["shared"], stored["shared_sd"], NumberRole::kBase);
  for (std::size_t k = 0; k < numbers.size(); ++k) numbers[k].mean = stored["shared_mean"][k];
  const std::size_t first = numbers.size();
  add(stored["own"], stored["own_sd"], NumberRole::kNuisance);
  const std::size_t last = numbers.size();
  add(stored["atoms"], stored["atom_sd"], NumberRole::kAtom);
  for (std::size_t k = 0; k < stored["atoms"].size(); ++k) {
    world.floors[stored["atoms"][k]].amplitude = stored["floor"][k];
  }
  for (const json& recording : stored["recordings"]) {
    Evidence& evidence = world.recordings.emplace_back();
    evidence.name = "recording " + std::to_string(world.recordings.size());
    evidence.numbers = numbers;
    for (std::size_t k = first; k < last; ++k) evidence.numbers[k].owner = evidence.name;
    const auto size = static_cast<Eigen::Index>(numbers.size());
    evidence.A.resize(size, size);
    evidence.b.resize(size);
    for (Eigen::Index i = 0; i < size; ++i) {
      evidence.b[i] = recording["b"][static_cast<std::size_t>(i)];
      for (Eigen::Index j = 0; j < size; ++j) {
        evidence.A(i, j) = recording["A"][static_cast<std::size_t>(i)][static_cast<std::size_t>(j)];
      }
    }
  }
  return world;
}

/// Rounding of sums grows with what is summed.
void expect_answer(double got, const json& answer, const std::string& what) {
  const double wanted = answer;
  EXPECT_LE(std::fabs(got - wanted), 1e-9 * std::max(1.0, std::fabs(wanted)))
      << what << ": " << got;
}

class ExplainAnswers : public testing::TestWithParam<std::string> {
 protected:
  const World world_ = world_of(read("evidence.json")[GetParam()]);
  const json answers_ = read("answers.json")[GetParam()];
  const FoldEvidence folds_ = make_folds(world_.recordings).value();
};

TEST_P(ExplainAnswers, BaseAndScoreTestsAreThoseOfTheReference) {
  std::vector<Evidence> parts;
  for (const Evidence& recording : world_.recordings)
    parts.push_back(integrate_own(recording).value());
  const Posterior base = solve(sum_evidence(parts).value()).value();
  ASSERT_EQ(base.numbers.size(), answers_["base"].size());
  for (std::size_t k = 0; k < base.numbers.size(); ++k) {
    expect_answer(base.mean[static_cast<Eigen::Index>(k)], answers_["base"][base.numbers[k].key],
                  base.numbers[k].key);
  }
  const auto tests = score_tests(folds_).value();
  for (const ScoreTest& test : tests) {
    const json& answer = answers_["atoms"][test.atom];
    expect_answer(test.z, answer["z"], test.atom + " z");
    expect_answer(test.amplitude, answer["a"], test.atom + " a");
    expect_answer(test.sd, answer["sd"], test.atom + " sd");
    EXPECT_NEAR(test.detectability(test.amplitude), test.z, 1e-9);
  }
}

TEST_P(ExplainAnswers, GainsSumsAndClaimsAreThoseOfTheReference) {
  const auto gains = left_out_gains(folds_, world_.floors).value();
  ASSERT_EQ(gains.size(), answers_["atoms"].size());
  for (const AtomGains& atom : gains) {
    const json& answer = answers_["atoms"][atom.atom];
    ASSERT_EQ(atom.folds.size(), answer["gains"].size());
    for (std::size_t r = 0; r < atom.folds.size(); ++r) {
      expect_answer(atom.folds[r].gain, answer["gains"][r],
                    atom.atom + " in " + atom.folds[r].fold);
    }
    expect_answer(atom.trimmed, answer["trimmed"], atom.atom + " trimmed");
    EXPECT_EQ(atom.claimed, answer["claimed"].get<bool>()) << atom.atom;
  }
}

TEST_P(ExplainAnswers, LimitsAreThoseOfTheReference) {
  const auto limits = detection_limits(folds_, world_.floors).value();
  for (const DetectionLimit& limit : limits) {
    expect_answer(limit.detected, answers_["atoms"][limit.atom]["limit"], limit.atom + " limit");
    expect_answer(limit.named, answers_["atoms"][limit.atom]["named"], limit.atom + " named");
  }
}

TEST_P(ExplainAnswers, WhatIsLeftAndTheClassAreThoseOfTheReference) {
  const VerdictClass verdict = judge_atoms(world_.recordings, {}, world_.floors).value();
  EXPECT_EQ(verdict.winner, answers_["winner"].get<std::string>());
  EXPECT_EQ(std::set<std::string>(verdict.members.begin(), verdict.members.end()),
            answers_["class"].get<std::set<std::string>>());
  ASSERT_EQ(verdict.entrants.size(), answers_["left"].size());
  for (const Entrant& entrant : verdict.entrants) {
    ASSERT_EQ(entrant.left.size(), answers_["left"][entrant.atom].size());
    for (const LeftGain& left : entrant.left) {
      expect_answer(left.gain, answers_["left"][entrant.atom][left.atom],
                    entrant.atom + " leaves " + left.atom);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Worlds, ExplainAnswers,
                         testing::Values("null", "effect", "look_alikes", "inseparable",
                                         "two_effects", "in_three_of_seven", "below_the_floor",
                                         "one_recording_against", "three_recordings"),
                         [](const auto& world) { return world.param; });

}  // namespace
}  // namespace omentum
