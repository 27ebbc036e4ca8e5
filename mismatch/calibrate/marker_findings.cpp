#include "mismatch/calibrate/marker_findings.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace omentum {
void add_marker_numbers(const Findings& f, Calibration& result) {
  const Layout& layout = f.fit.layout;
  constexpr std::array<const char*, 3> kAxes = {"along", "across", "normal"};
  for (int m = 0; m < layout.markers; ++m) {
    if (!f.fit.markers[static_cast<std::size_t>(m)].on_tissue()) continue;
    const std::string& name = f.fit.observations.front().markers[static_cast<std::size_t>(m)];
    for (int k = 0; k < 3; ++k) {
      const int at = layout.marker(m) + k;
      result.nuisances.push_back(plain_number(
          fmt::format("marker.{}.{}", name, kAxes[static_cast<std::size_t>(k)]), "m",
          f.state.shared[at], std::sqrt(std::max(f.sure.shared_covariance(at, at), 0.0)),
          f.fit.beliefs.shared_sd[at], "docs/calibrate.md 8"));
    }
  }
  for (std::size_t i = 0; i < f.fitted.size(); ++i) {
    const std::size_t r = f.fitted[i];
    const Observation& seen = f.fit.observations[r];
    for (int k = 0; k < layout.held; ++k) {
      const int own = Layout::kOwnPlace + k;
      result.nuisances.push_back(plain_number(fmt::format("{}: held.{}", seen.name, "xyz"[k]), "m",
                                              f.state.own[r][own], f.sure.own_sd[i][own],
                                              f.fit.beliefs.own_sd[own], "docs/calibrate.md 8"));
    }
    if (layout.held == 0 || seen.pinched) continue;
    const std::string pinch = fmt::format("{}: pinch.", seen.name);
    std::erase_if(result.nuisances,
                  [&](const CalibratedNumber& number) { return number.name.starts_with(pinch); });
  }
}

}  // namespace omentum
