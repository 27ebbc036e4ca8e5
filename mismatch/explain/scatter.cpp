#include "mismatch/explain/scatter.h"

#include <cmath>
#include <limits>
#include <vector>

#include "mismatch/explain/fold_evidence.h"

namespace omentum {
namespace {

/// Log density of the recordings, everything integrated [nats].
Result<double> log_density(std::vector<Evidence> recordings, const Scatter& scatter, double sd) {
  set_scatter(scatter, sd, recordings);
  for (Evidence& recording : recordings) {
    auto integrated = integrate_own(recording);
    if (!integrated) return Failure{integrated.error()};
    recording = std::move(integrated).value();
  }
  auto sum = sum_evidence(recordings);
  if (!sum) return Failure{sum.error()};
  auto posterior = solve(sum.value());
  if (!posterior) return Failure{posterior.error()};
  return posterior.value().log_evidence;
}

}  // namespace

void set_scatter(const Scatter& scatter, double sd, std::span<Evidence> recordings) {
  for (Evidence& recording : recordings) {
    for (Number& number : recording.numbers) {
      if (number.key.starts_with(scatter.number) && !number.owner.empty()) number.sd = sd;
    }
  }
}

Result<double> learned_scatter(std::span<const Evidence> recordings, const Scatter& scatter,
                               double believed) {
  constexpr std::size_t kLeastRecordings = 5;
  constexpr double kStep = 1.25, kMost = 30;  // [1] of the least
  if (recordings.size() < kLeastRecordings) return believed;
  std::vector<std::string> means;
  for (const Number& number : recordings.front().numbers) {
    if (number.role == NumberRole::kAtom && number.effect == scatter.mean)
      means.push_back(number.key);
  }
  const std::vector<Evidence> free = with_in_base(recordings, means);
  double best = believed, most = -std::numeric_limits<double>::infinity();
  for (double times = 1; times < kMost; times *= kStep) {
    const double sd = times * scatter.least;
    auto density = log_density(free, scatter, sd);
    if (!density) return Failure{density.error()};
    const double off = std::log(sd / believed);  // believed to a factor of e
    const double posterior = density.value() - 0.5 * off * off;
    if (posterior <= most) continue;
    most = posterior;
    best = sd;
  }
  return best;
}

}  // namespace omentum
