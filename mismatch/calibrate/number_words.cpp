#include "mismatch/calibrate/number_words.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

#include "report/section_parts.h"

namespace omentum {

std::string told(const CalibratedNumber& n) {
  return number_in_line(n.value, n.low90, n.high90, n.unit);
}

std::string told_belief(const CalibratedNumber& n) {
  return number_in_line(n.prior_value, n.prior_low90, n.prior_high90, n.unit);
}

std::string with_words(const std::string& path) {
  struct Words {
    const char *path, *words;
  };
  static constexpr Words kWords[] = {
      {"scene.tissue.material.young_modulus_pa", "stiffness"},
      {"scene.tissue.effects.bending_change", "change of the stiffness in bending, as a share"},
      {"scene.tissue.effects.friction_change", "change of the friction, as a share"},
      {"scene.tissue.effects.density_change", "change of the density, as a share"},
      {"scene.depth_sensor.time_offset_s", "clock of the camera"},
  };
  const auto* found = std::ranges::find(kWords, path, &Words::path);
  return found == std::end(kWords) ? path : fmt::format("{} ({})", path, found->words);
}

}  // namespace omentum
