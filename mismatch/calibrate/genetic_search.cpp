#include "mismatch/calibrate/genetic_search.h"

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "core/rng.h"

namespace omentum {
namespace {

constexpr std::size_t kElite = 2, kTournament = 3, kPatience = 4;
constexpr double kBlend = 0.3;     // beyond both parents, of their distance
constexpr double kMutated = 0.3;   // share of the genes
constexpr double kFirstSd = 0.15;  // of a mutation; falls to a fifth of it

class Draws {
 public:
  explicit Draws(std::uint64_t seed) : stream_(seed, 0, Purpose::kEvaluation, 0) {}
  double uniform() { return uniform_between(stream_.next(), 0, 1); }
  double normal() {
    const double u = (static_cast<double>(stream_.next()) + 0.5) * 0x1p-32;
    return std::sqrt(-2 * std::log(u)) * std::cos(2 * kPi * uniform());
  }
  std::size_t below(std::size_t count) {
    return bounded(stream_.next(), static_cast<std::uint32_t>(count));
  }

 private:
  RandomStream stream_;
};

bool better(const Candidate& a, const Candidate& b) {
  return a.cost != b.cost ? a.cost < b.cost : a.gene < b.gene;
}

}  // namespace

std::vector<Candidate> search_genetically(const GeneticSettings& settings, const CostsOf& costs) {
  Draws draws(settings.seed);
  std::vector<Candidate> population(settings.population);
  // Each gene in as many strata as there are candidates.
  for (std::size_t g = 0; g < Candidate::kGenes; ++g) {
    std::vector<std::size_t> stratum(population.size());
    for (std::size_t k = 0; k < stratum.size(); ++k) stratum[k] = k;
    for (std::size_t k = stratum.size(); k > 1; --k)
      std::swap(stratum[k - 1], stratum[draws.below(k)]);
    for (std::size_t k = 0; k < population.size(); ++k)
      population[k].gene[g] = (static_cast<double>(stratum[k]) + draws.uniform()) /
                              static_cast<double>(population.size());
  }
  costs(population);
  std::vector<Candidate> all = population;
  std::sort(population.begin(), population.end(), better);
  double best = population.front().cost;
  std::size_t waited = 0;
  for (std::size_t generation = 1; generation < settings.generations && waited < kPatience;
       ++generation) {
    const auto parent = [&]() -> const Candidate& {
      std::size_t winner = draws.below(population.size());
      for (std::size_t k = 1; k < kTournament; ++k)
        winner = std::min(winner, draws.below(population.size()));
      return population[winner];
    };
    const double sd = kFirstSd * (1 - 0.8 * static_cast<double>(generation) /
                                          static_cast<double>(settings.generations));
    std::vector<Candidate> children;
    while (children.size() + kElite < population.size()) {
      const Candidate a = parent(), b = parent();
      Candidate child;
      for (std::size_t g = 0; g < Candidate::kGenes; ++g) {
        const double low = std::min(a.gene[g], b.gene[g]), high = std::max(a.gene[g], b.gene[g]);
        const double apart = high - low;
        double x = low - kBlend * apart + draws.uniform() * (1 + 2 * kBlend) * apart;
        if (draws.uniform() < kMutated) x += sd * draws.normal();
        child.gene[g] = std::clamp(x, 0.0, 1.0);
      }
      children.push_back(child);
    }
    costs(children);
    all.insert(all.end(), children.begin(), children.end());
    population.resize(kElite);
    population.insert(population.end(), children.begin(), children.end());
    std::sort(population.begin(), population.end(), better);
    waited = population.front().cost < 0.999 * best ? 0 : waited + 1;
    best = population.front().cost;
  }
  std::sort(all.begin(), all.end(), better);
  return all;
}

}  // namespace omentum
