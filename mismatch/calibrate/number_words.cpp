#include "mismatch/calibrate/number_words.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <map>

#include "report/section_parts.h"

namespace omentum {
namespace {

/// Nuisances and numerics, docs/mismatch.md 5.2 and 5.6.
const std::map<std::string, std::string>& nuisances() {
  static const std::map<std::string, std::string> table = {
      {"clock", "the camera's clock"},
      {"discrepancy.constant", "the smooth difference that stays the same"},
      {"discrepancy.with_lift", "the smooth difference that grows with the lift"},
      {"discrepancy.with_lift_early_against_late",
       "the smooth difference of early from late frames of one lift"},
      {"discrepancy.with_lift_squared",
       "the smooth difference that grows with the square of the lift"},
      {"force.gain_change", "the scale of the force sensor"},
      {"force.zero_x", "the zero of the force sensor along x"},
      {"force.zero_y", "the zero of the force sensor along y"},
      {"force.zero_z", "the zero of the force sensor along z"},
      {"held.x", "the place where the body was held along x"},
      {"held.y", "the place where the body was held along y"},
      {"held.z", "the place where the body was held along z"},
      {"numerics.camera_bias.quadratic", "the error of the camera that grows with depth squared"},
      {"numerics.camera_bias.scale", "the scale of the camera's depth"},
      {"numerics.clamp_on_a_bed", "the give of the clamp"},
      {"numerics.grasp_compliance.C", "the give of the pad in the jaws"},
      {"numerics.grasp_compliance.C_turn", "the give of the pad when it turns in the jaws"},
      {"numerics.law.corotated", "the difference to the corotated law"},
      {"numerics.law.neo_hooke", "the difference to the neo-Hookean law"},
      {"numerics.law.st_venant_kirchhoff", "the difference to the law of St. Venant and Kirchhoff"},
      {"numerics.mesh", "the error of the mesh"},
      {"numerics.pad_size", "the size of the pad in the jaws"},
      {"numerics.slip_speed", "the speed below which friction is smooth"},
      {"numerics.step", "the error of the time step"},
      {"numerics.viscoelastic.g@tau=0.02", "the damping by rate"},
      {"pinch.x", "the place of the pinch along x"},
      {"pinch.y", "the place of the pinch along y"},
      {"registration.turn_x", "the turn of the camera about x"},
      {"registration.turn_y", "the turn of the camera about y"},
      {"registration.turn_z", "the turn of the camera about z"},
      {"registration.x", "the place of the camera along x"},
      {"registration.y", "the place of the camera along y"},
      {"registration.z", "the place of the camera along z"},
      {"scene.depth_sensor.time_offset_s", "the camera's clock"},
      {"stiffness.ln_factor", "the stiffness in this recording alone"},
  };
  return table;
}

}  // namespace

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

std::string nuisance_words(const std::string& key) {
  const auto found = nuisances().find(key.substr(0, key.find('[')));
  return found == nuisances().end() ? with_words(key) : found->second;
}

std::string named_nuisance(const std::string& name) {
  const std::size_t colon = name.rfind(": ");
  const std::string key = colon == std::string::npos ? name : name.substr(colon + 2);
  const std::string text = nuisance_words(key);
  return text.starts_with(key) ? name.substr(0, name.size() - key.size()) + text
                               : name + ", " + text;
}

}  // namespace omentum
