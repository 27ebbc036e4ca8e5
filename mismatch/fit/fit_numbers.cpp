#include "mismatch/fit/fit_numbers.h"

#include <fmt/format.h>

#include <array>

#include "core/check.h"

namespace omentum {

std::string discrepancy_name(int function) {
  constexpr std::array<const char*, kTimeFunctions> kNames = {
      "discrepancy.constant", "discrepancy.with_lift", "discrepancy.with_lift_squared",
      "discrepancy.with_lift_early_against_late"};
  return kNames[static_cast<std::size_t>(function)];
}

std::vector<FitNumber> numbers_of(const FitData& data) {
  const Layout& layout = data.layout;
  std::vector<FitNumber> list;
  for (const Unknown& unknown : data.unknowns)
    list.push_back({unknown.path, unknown.unit, unknown.role, false});
  const auto nuisance = [&](const std::string& name, const char* unit, bool own) {
    list.push_back({name, unit, NumberRole::kNuisance, own});
  };
  for (const char* what : {"registration.", "registration.turn_"}) {
    for (const char axis : {'x', 'y', 'z'})
      nuisance(std::string(what) + axis, what == std::string("registration.") ? "m" : "rad", false);
  }
  nuisance("scene.depth_sensor.time_offset_s", "s", false);
  for (int m = 0; m < layout.markers.count / 3; ++m) {
    const std::string& name = data.observations.front().markers[static_cast<std::size_t>(m)];
    for (const char* axis : {"along", "across", "normal"})
      nuisance(fmt::format("marker.{}.{}", name, axis), "m", false);
  }
  for (const char axis : {'x', 'y'}) nuisance(std::string("pinch.") + axis, "m", true);
  nuisance("stiffness.ln_factor", "1", true);
  nuisance("clock", "s", true);
  for (const char axis : {'x', 'y', 'z'}) nuisance(std::string("force.zero_") + axis, "N", true);
  nuisance("force.gain_change", "1", true);
  for (int k = 0; k < layout.held_place.count; ++k)
    nuisance(fmt::format("held.{}", "xyz"[k]), "m", true);
  for (int k = 0; k < layout.modes.count; ++k) {
    const int cosines = layout.cosines();
    nuisance(fmt::format("{}[{}]", discrepancy_name(k / cosines), k % cosines), "m", true);
  }
  OMENTUM_CHECK(list.size() == static_cast<std::size_t>(layout.size()), "{} names of {} columns",
                list.size(), layout.size());
  return list;
}

}  // namespace omentum
