#include "mismatch/fit/recording_evidence.h"

#include <string>
#include <vector>

#include "mismatch/fit/fit_numbers.h"

namespace omentum {

Evidence evidence_of(const FitData& data, const NormalEquations& equations, const SearchState& at,
                     std::size_t recording, double information) {
  constexpr double kOff = 1e-6;  // standard deviation of what is not looked for
  const Layout& layout = data.layout;
  Evidence evidence;
  evidence.name = data.observations[recording].name;
  const std::vector<FitNumber> names = numbers_of(data);
  std::vector<int> columns;
  for (int k = 0; k < layout.size(); ++k) {
    const FitNumber& named = names[static_cast<std::size_t>(k)];
    const int own = k - layout.shared();
    Number number;
    number.key = named.name;
    number.unit = named.unit;
    number.role = named.role;
    if (named.own || named.role == NumberRole::kNumerics) number.owner = evidence.name;
    if (named.role == NumberRole::kAtom) number.effect = named.name.substr(0, named.name.find('.'));
    number.sd = named.own ? at.scales.own_sd[own] : data.beliefs.shared_sd[k];
    number.mean = named.own ? -at.state.own[recording][own] : -at.state.shared[k];
    if (number.sd < kOff) continue;
    columns.push_back(k);
    evidence.numbers.push_back(std::move(number));
  }
  evidence.A = information * equations.A(columns, columns);
  evidence.b = information * equations.b(columns);
  evidence.log_constant = -equations.cost;
  return evidence;
}

}  // namespace omentum
