#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "proto/knob.pb.h"
#include "proto/tissue_effects.pb.h"

// tissue/ is what all tissue models share: Tissue::step and its stages, what surrounds a tissue,
// the catalogue and formulas of effects, the base of the models that run in lanes, and the bytes of
// a saved state. The models are in the folders after it.

namespace omentum {

/// The effects of one environment, resolved: SI, angles in radians; one double per row of the
/// catalogue, in its order. Plain numbers only: they travel in the state bytes. All zero (but for
/// scales that another zero switches off) = nothing.
struct EffectValues {
  double stiffening = 0;  ///< c2 / mu
  double fibre_ratio = 0, fibre_angle = 0;
  std::array<double, 3> share{}, time{1, 1, 1};  ///< Prony branches
  double loss_factor = 0;
  double slider_ratio = 0, slider_yield = 0.05;
  std::array<double, 3> inclusion_x{}, inclusion_y{}, inclusion_radius{0.01, 0.01, 0.01},
      inclusion_change{};
  double density_change = 0;
  double tilt_x = 0, tilt_y = 0;
  double poisson_change = 0, bending_change = 0;
  double curvature_x = 0, curvature_y = 0, twist = 0, stretch = 0;
  double thickness_x = 0, thickness_y = 0;      ///< [1/m]
  double adhesion = 0, adhesion_break = 0.002;  ///< [Pa/m], [m]
  double adhesion_x = 0, adhesion_y = 0;        ///< centre of its place [m]
  double adhesion_half_x = 0, adhesion_half_y = 0;
  double suction = 0, suction_reach = 0.001;  ///< [Pa s/m], [m]
  double friction_change = 0;
  double anchor_compliance = 0, anchor_free_from = 0, anchor_free_to = 0, anchor_break = 0;
  double grasp_x = 0, grasp_y = 0, grasp_radius = 0;
  double slip_speed = 0, slip_force = 0.1, slip_loss = 0, slip_total = 0;
  double grasp_compliance = 0;
  double grasp_turn = 0;  ///< [rad/(N m)]
  double jaw_roll = 0, jaw_tilt = 0, jaw_lean = 0;
  double air_drag = 0;
  double softening = 0, softening_strain = 0.05;
  double exponential = 0;  ///< b
  double added_mass = 0, added_x = 0, added_y = 0, added_radius = 0.005;
  double pull = 0;                                                 ///< strength of the local force
  double pull_x = 0, pull_y = 0, pull_radius = 0.01;               ///< its disc [m]
  double pull_stiffness = 0, pull_slack = 0;                       ///< [N/m], [m]
  double pull_anchor_x = 0, pull_anchor_y = 0, pull_anchor_z = 0;  ///< in W [m]
  double pull_damper = 0;                                          ///< [N s/m]
  double push_x = 0, push_y = 0, push_z = 0;                       ///< in W [N]
  double push_decay = 0;                                           ///< [s], 0 = it stays

  bool operator==(const EffectValues&) const = default;

  /// Whether the rows of the part kStructure agree: what shapes mass, stiffness of cells and
  /// bending, other than by one factor.
  bool same_structure(const EffectValues& other) const;
  bool moves_anchor() const { return anchor_compliance > 0 || anchor_free_from != anchor_free_to; }
  bool has_memory() const;  ///< of its material: Prony branches, a slider or softening
  bool stiffens() const { return stiffening != 0 || exponential > 0; }
  bool sticks_everywhere() const { return adhesion_half_x == 0 || adhesion_half_y == 0; }
  bool has_inclusion() const;
  bool turns_jaw() const { return jaw_roll != 0 || jaw_tilt != 0 || jaw_lean != 0; }
  /// Factors at a place of the sheet at rest, p_B [m].
  double stiffness_at(const Eigen::Vector3d& p_B) const;
  double thickness_at(const Eigen::Vector3d& p_B) const;
};

/// What an effect is of.
enum class EffectPart { kMaterial, kStructure, kShape, kGravity, kContact, kAnchor, kJaw };

/// Models, as bits of EffectRow::models and EffectRow::baked. A soft body is the solid beside an
/// elastic sheet: it has what surrounds both and what the jaws do.
enum EffectModel : std::uint32_t {
  kClusterModel = 1,
  kShellModel = 2,
  kSolidModel = 4,
  kSoftBodyModel = 8,
  kReferenceModel = 16
};

/// A value of the catalogue. Unit, range and neutral value are those of its knob in
/// proto/tissue_effects.proto.
struct EffectRow {
  const char* path;  ///< below TissueEffects: "inclusion.x_m", "viscoelastic[0].share"
  /// Null: no value of a lane but a rigid body of the scene (obstacle); get() must not be called.
  double& (*member)(EffectValues&);
  EffectPart part;
  std::uint32_t models;      ///< that have it
  std::uint32_t baked = 0;   ///< models in which all lanes must have the scene's value
  const char* of = nullptr;  ///< path of the value that switches this one off where zero
  double factor = 1;         ///< SI value per unit of the knob

  double get(const EffectValues& values) const { return member(const_cast<EffectValues&>(values)); }
};

/// Every value, in the order of EffectValues, then the obstacle's.
std::span<const EffectRow> effect_catalogue();

/// Unit, range and source of a row's value.
const pb::Knob& knob_of(const EffectRow& row);

/// Sets the effect of a path, in units of its knob. Throws Error for an unknown path or a value
/// outside the knob's range.
void set_effect(pb::TissueEffects& effects, const std::string& path, double value);

/// Scales of an effect that is off do not count: they get their neutral values. `particles`: p_B at
/// rest [m]; without them places and thickness are not checked. Throws Error, one line with knob,
/// value and what is allowed, for what the knobs alone cannot exclude: too many branches or
/// inclusions, Poisson's ratio or thickness out of range, a place off the tissue, an anchor whose
/// parts contradict each other.
EffectValues make_effects(const pb::TissueEffects& effects, double poisson_ratio,
                          std::span<const Eigen::Vector3d> particles);

/// What the knobs and make_effects() promise of ranges, for values from elsewhere (a saved state);
/// of places it says nothing.
bool usable(const EffectValues& effects, double poisson_ratio,
            std::span<const Eigen::Vector3d> particles);

/// Throws Error for the first effect that is on and that the model does not have; `name` is the
/// model's in the message.
void refuse_effects(const pb::TissueEffects& effects, EffectModel model, const std::string& name);

/// Whether a model has every effect that is on.
bool has_effects(const pb::TissueEffects& effects, EffectModel model);

/// The values that a model has; the others are neutral.
EffectValues effects_of_model(const EffectValues& values, EffectModel model);

/// Whether a lane has the scene's values where the model has them baked.
bool baked_fit(const EffectValues& scene, const EffectValues& lane, EffectModel model);

/// Whether a lane may have the anchor of `lane` in a scene of these effects: whether there are
/// anchor springs, and which nodes are detached, is part of the scene.
bool anchors_fit(const EffectValues& scene, const EffectValues& lane);

}  // namespace omentum
