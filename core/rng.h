#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace omentum {

/// Philox4x32-10 [Salmon11]: a pure function (counter, key) -> four words, without state.
using PhiloxWords = std::array<std::uint32_t, 4>;

constexpr PhiloxWords philox(PhiloxWords counter, std::array<std::uint32_t, 2> key) {
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t product0 = std::uint64_t{0xD2511F53u} * counter[0];
    const std::uint64_t product1 = std::uint64_t{0xCD9E8D57u} * counter[2];
    counter = {static_cast<std::uint32_t>(product1 >> 32) ^ counter[1] ^ key[0],
               static_cast<std::uint32_t>(product1),
               static_cast<std::uint32_t>(product0 >> 32) ^ counter[3] ^ key[1],
               static_cast<std::uint32_t>(product0)};
    key[0] += 0x9E3779B9u;
    key[1] += 0xBB67AE85u;
  }
  return counter;
}

/// What a draw is for; part of the counter. Values reach results: do not change.
enum class Purpose : std::uint32_t {
  kAction = 0,
  kReset = 1,
  kDynamics = 2,
  kObservationNoise = 3,
  kShuffle = 5,
  kWeights = 6,
  kEvaluation = 7,
  kEvaluationDynamics = 8,  ///< as kDynamics, for StartSet::kGridDrawn
};

/// Counter layout of docs/learner.md 3.2: key = run seed, counter = (slot, purpose 2^24 + draw,
/// episode, step). `draw` must be below 2^24, else it is a draw of another purpose; of `episode`
/// the lower 32 bits count.
constexpr PhiloxWords random_words(std::uint64_t run_seed, std::uint32_t slot, Purpose purpose,
                                   std::uint32_t draw, std::uint64_t episode, std::uint32_t step) {
  return philox({slot, (static_cast<std::uint32_t>(purpose) << 24) + draw,
                 static_cast<std::uint32_t>(episode), step},
                {static_cast<std::uint32_t>(run_seed), static_cast<std::uint32_t>(run_seed >> 32)});
}

/// Uniform in [0, 1) with 24 bits: exact in f32.
constexpr float uniform_24(std::uint32_t word) { return static_cast<float>(word >> 8) * 0x1p-24f; }

/// Uniform in [min, max) with 32 bits.
constexpr double uniform_between(std::uint32_t word, double min, double max) {
  return min + (max - min) * static_cast<double>(word) * 0x1p-32;
}

/// The words of a counter in order: step = number of the call, draw = 0.
class RandomStream {
 public:
  RandomStream(std::uint64_t run_seed, std::uint32_t slot, Purpose purpose, std::uint64_t episode)
      : run_seed_(run_seed), episode_(episode), slot_(slot), purpose_(purpose) {}

  std::uint32_t next() {
    if (position_ == words_.size()) {
      words_ = random_words(run_seed_, slot_, purpose_, 0, episode_, call_++);
      position_ = 0;
    }
    return words_[position_++];
  }

 private:
  std::uint64_t run_seed_, episode_;
  std::uint32_t slot_, call_ = 0;
  Purpose purpose_;
  PhiloxWords words_{};
  std::size_t position_ = words_.size();
};

/// Uniform integer in [0, bound) from 32 random bits, multiply-shift (bias < bound / 2^32); 0 where
/// the bound is 0.
constexpr std::uint32_t bounded(std::uint32_t word, std::uint32_t bound) {
  return static_cast<std::uint32_t>((std::uint64_t{word} * bound) >> 32);
}

}  // namespace omentum
