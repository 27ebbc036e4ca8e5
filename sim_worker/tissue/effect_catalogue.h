#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <string>
#include <vector>

#include "proto/tissue_effects.pb.h"

namespace omentum {

/// Branches of the Prony series at most: three of viscoelastic, three of structural_damping.
inline constexpr int kMaxBranches = 6;
/// What every model can do; all that clusters, whose stiffness is no material constant (mismatch.md
/// 5.2), can.
inline constexpr std::array<const char*, 4> kBasicEffects = {
    "gravity_tilt_x_deg", "gravity_tilt_y_deg", "friction_change", "obstacle"};
/// What an elastic solid can do: all but what only a sheet has.
inline constexpr std::array<const char*, 22> kSolidEffects = {"strain_stiffening",
                                                              "anisotropy",
                                                              "viscoelastic",
                                                              "structural_damping",
                                                              "plastic_set",
                                                              "inclusion",
                                                              "density_change",
                                                              "gravity_tilt_x_deg",
                                                              "gravity_tilt_y_deg",
                                                              "poisson_change",
                                                              "adhesion",
                                                              "suction",
                                                              "obstacle",
                                                              "friction_change",
                                                              "anchor",
                                                              "grasp_offset",
                                                              "grasp_slip",
                                                              "grasp_compliance_m_per_n",
                                                              "jaw_roll_deg",
                                                              "jaw_tilt_deg",
                                                              "air_drag",
                                                              "mullins"};
inline constexpr double kAirDensity = 1.2;  ///< [kg/m^3], dry, 20 C

/// exp(-x) for x >= 0 by our own series: the same bits on every machine, unlike libm's.
double decay(double x);

/// The effects of one environment, resolved: SI, angles in radians, one double per knob of
/// TissueEffects in the order of the file. Plain numbers only: they travel in the state bytes. All
/// zero (but for scales that another zero switches off) = nothing.
struct EffectValues {
  double stiffening = 0;  ///< c2 / mu
  double fibre_ratio = 0, fibre_angle = 0;
  std::array<double, 3> share{}, time{1, 1, 1};  ///< Prony branches
  double loss_factor = 0;
  double slider_ratio = 0, slider_yield = 0.05;
  double inclusion_x = 0, inclusion_y = 0, inclusion_radius = 0.01, inclusion_change = 0;
  double density_change = 0;
  double tilt_x = 0, tilt_y = 0;
  double poisson_change = 0, bending_change = 0;
  double curvature_x = 0, curvature_y = 0, twist = 0, stretch = 0;
  double thickness_x = 0, thickness_y = 0;      ///< [1/m]
  double adhesion = 0, adhesion_break = 0.002;  ///< [Pa/m], [m]
  double suction = 0, suction_reach = 0.001;    ///< [Pa s/m], [m]
  double friction_change = 0;
  double anchor_compliance = 0, anchor_free_from = 0, anchor_free_to = 0, anchor_break = 0;
  double grasp_x = 0, grasp_y = 0, grasp_radius = 0;
  double slip_speed = 0, slip_force = 0.1, slip_loss = 0;
  double grasp_compliance = 0;
  double jaw_roll = 0, jaw_tilt = 0;
  double air_drag = 0;
  double softening = 0, softening_strain = 0.05;

  bool operator==(const EffectValues&) const = default;

  /// What shapes mass, stiffness of cells and bending, other than by one factor.
  bool same_structure(const EffectValues& other) const;
  bool moves_anchor() const { return anchor_compliance > 0 || anchor_free_from != anchor_free_to; }
  bool has_memory() const;  ///< of its material: Prony branches, a slider or softening
  /// Factors at a place of the sheet at rest, p_B [m].
  double stiffness_at(const Eigen::Vector3d& p_B) const;
  double thickness_at(const Eigen::Vector3d& p_B) const;
};

/// What the knobs and make_effects() promise, for values from elsewhere (a saved state).
bool usable(const EffectValues& effects, double poisson_ratio,
            std::span<const Eigen::Vector3d> particles);

/// Scales of an effect that is off do not count: they get their defaults.
/// Throws Error, one line with knob, value and what is allowed, for what the knobs alone cannot
/// exclude: too many branches, Poisson's ratio or thickness out of range.
EffectValues make_effects(const pb::TissueEffects& effects, double poisson_ratio,
                          std::span<const Eigen::Vector3d> particles);

/// Throws Error for the first effect that is on and that `model` cannot do; `allowed` are the names
/// of those it can, as in the file.
void refuse_effects(const pb::TissueEffects& effects, const std::string& model,
                    std::span<const char* const> allowed);

/// Sets the effect of a path below TissueEffects ("inclusion.x_m", "viscoelastic[0].share"). Throws
/// Error for an unknown path or a value outside the knob's range.
void set_effect(pb::TissueEffects& effects, const std::string& path, double value);

/// Gravity of a tilted board.
Eigen::Vector3d tilted_gravity(const EffectValues& effects, const Eigen::Vector3d& gravity);

/// Turn of the held patch: roll about the shaft, then tilt about x_W.
Eigen::Matrix3d jaw_turn(const EffectValues& effects, const Eigen::Vector3d& shaft_axis);

/// Way that a held patch slips along the force F on the tool within dt [m], for tissue whose force
/// falls by `stiffness` per way [N/m]: it does not overshoot the force at which slip ends.
Eigen::Vector3d slip_of(const EffectValues& effects, const Eigen::Vector3d& force, double stiffness,
                        double dt);

/// Shares of three branches with times 0.5, 0.05 and 0.005 s whose loss factor, that is loss over
/// storage modulus, is nearly `loss_factor`: 0.95 ... 1.12 of it from 0.3 to 30 Hz up to 0.2, 0.92
/// ... 1.22 up to 0.4. The storage modulus grows with the frequency, as it must (Kramers, Kronig).
std::array<double, 3> loss_shares(double loss_factor);

/// The Prony branches over a step h:  H <- keep H + gain (S_new - S_old). Exact for S linear in
/// time.
struct PronyStep {
  int branches = 0;
  std::array<double, kMaxBranches> keep{}, gain{};
  double gains = 0;  ///< sum: stiffness of a step beyond the slow one
};
PronyStep make_prony(const EffectValues& effects, double h);
int prony_branches(const EffectValues& effects);

/// Whether a lane may have the anchor of `lane` in a scene of these effects: whether there are
/// anchor springs, and which nodes are detached, is part of the scene.
bool anchors_fit(const EffectValues& scene, const EffectValues& lane);

/// Secant stiffness of a cohesive spring, relative to a fresh one, whose longest stretch was
/// `longest`: 1 up to half of `limit`, 0 from `limit`.
double cohesive_share(double longest, double limit);

/// Part of a length of clamp edge around x_B that is detached, [0, 1].
double detached_share(const EffectValues& effects, double x, double half_width);

}  // namespace omentum
