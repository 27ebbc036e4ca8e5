#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "proto/scene.pb.h"

// mismatch/catalogue/ is the table between the fields of a scene and the names by which effects go
// elsewhere: verdicts, columns, limits (docs/mismatch.md 4). Any thread.

namespace omentum {

/// A number of an effect under its name. SI, angles in radians.
struct NamedValue {
  std::string name, unit;
  double value = 0;

  bool operator==(const NamedValue&) const = default;
};

/// An effect that is on. Several inclusions and viscoelastic branches are an effect each.
struct NamedEffect {
  std::string name;  ///< of docs/mismatch.md 4: "adhesion"; an inclusion below 1 is a "soft_spot"
  std::vector<NamedValue> parameters;
  /// Its place: centre_x, centre_y [m] in B (an obstacle's in W, with centre_z), half_x, half_y of
  /// a rectangle, from, to on the clamped edge; empty = everywhere.
  std::vector<NamedValue> where;

  /// Null where there is none of that name.
  const NamedValue* find(const std::string& parameter) const;
  bool operator==(const NamedEffect&) const = default;
};

/// A number that an effect may have: "adhesion.k".
struct ParameterName {
  std::string effect, parameter, unit;
  bool of_place = false;  ///< one of NamedEffect::where
};
/// All, effects together, in the order of docs/mismatch.md 4.
std::vector<ParameterName> parameter_names();

/// The effects that are on in a scene, in that order, with all of their numbers.
std::vector<NamedEffect> effects_of_scene(const pb::Scene& scene);

/// Sets the effects in a scene; numbers that are not named keep what the scene has, and so do other
/// effects. Inclusions or branches replace all of the scene's. Throws Error, one line, for an
/// unknown name and a number outside of its field's range.
void apply_effects(const std::vector<NamedEffect>& effects, pb::Scene& scene);

/// The scene with every effect of the table off: what has no name here, and the base.
pb::Scene without_effects(const pb::Scene& scene);

/// What follows from the numbers of an effect and is told beside them: k_r2 of inclusions, G of
/// adhesion, the size of a tilt, an offset, a curvature, an angle, a compliance; length of a
/// detached piece.
std::vector<NamedValue> derived_values(const NamedEffect& effect);

}  // namespace omentum
