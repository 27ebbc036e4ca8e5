#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <vector>

namespace omentum {

/// One candidate: numbers in 0 ... 1, and what it is worth; smaller is better.
struct Candidate {
  static constexpr std::size_t kGenes = 3;
  std::array<double, kGenes> gene{};
  double cost = 0;
};

struct GeneticSettings {
  std::size_t population = 20;
  std::size_t generations = 12;
  std::uint64_t seed = 1;
};

/// Gives candidates their cost; called once a generation with those that have none.
using CostsOf = std::function<void(std::vector<Candidate>& candidates)>;

/// Real-coded genetic algorithm: the two best survive, parents win tournaments of three, children
/// are blends (BLX-0.3 [Eshelman93]) with a normal mutation that shrinks over the generations.
/// Ends early when the best has not become better by a thousandth for four generations. Every
/// candidate there was, the best first. The same numbers give the same search.
std::vector<Candidate> search_genetically(const GeneticSettings& settings, const CostsOf& costs);

}  // namespace omentum
