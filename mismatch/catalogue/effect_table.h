#pragma once

#include <string>
#include <vector>

namespace omentum {

/// How a value follows from its field.
enum class FieldMap {
  kLinear,      ///< shift + scale field
  kReciprocal,  ///< 1 / field; 0 = none
  kRatio,       ///< (1 + field) times `base`, another field of the scene
  kSum,         ///< field + `base`
};

/// A number of an effect and its field in the scene.
struct EffectField {
  std::string effect, parameter, unit;
  std::string path;  ///< below the scene; "[]" stands for the entry of a repeated field
  bool on = false;   ///< the effect is on where this field is not 0
  bool of_place = false;
  FieldMap map = FieldMap::kLinear;
  double scale = 1, shift = 0;
  std::string base = {};
};

/// Rows of an effect together.
const std::vector<EffectField>& effect_table();

}  // namespace omentum
