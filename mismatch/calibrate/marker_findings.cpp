#include "mismatch/calibrate/marker_findings.h"

#include <algorithm>
#include <cmath>

#include "mismatch/fit/fit_numbers.h"

namespace omentum {

void add_marker_numbers(const Findings& f, Calibration& result) {
  const Layout& layout = f.data.layout;
  const std::vector<FitNumber> numbers = numbers_of(f.data);
  const std::vector<MarkerPlace>& markers = f.data.likelihood.markers();
  for (int m = 0; m < static_cast<int>(markers.size()); ++m) {
    if (!markers[static_cast<std::size_t>(m)].on_tissue()) continue;
    for (int k = layout.marker(m); k < layout.marker(m) + 3; ++k) {
      const FitNumber& number = numbers[static_cast<std::size_t>(k)];
      const double variance = std::max(f.posterior.shared_covariance(k, k), 0.0);
      result.nuisances.push_back(plain_number(number.name, number.unit, f.found.state.shared[k],
                                              std::sqrt(variance), f.data.beliefs.shared_sd[k],
                                              "docs/calibrate.md 8"));
    }
  }
  for (std::size_t i = 0; i < f.fitted.size(); ++i) {
    const Observation& seen = f.data.observations[f.fitted[i]];
    add_own_numbers(f, i, layout.held_place, "docs/calibrate.md 8", result);
    if (layout.held_place.count == 0 || seen.pinched) continue;
    // Of what jaws never take the place in them is none.
    std::erase_if(result.nuisances, [&](const CalibratedNumber& number) {
      return number.recording == seen.name && number.name.starts_with(seen.name + ": pinch.");
    });
  }
}

}  // namespace omentum
