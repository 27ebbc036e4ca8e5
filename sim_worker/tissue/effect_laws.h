#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <span>
#include <vector>

#include "sim_worker/tissue/effect_catalogue.h"

namespace omentum {

// Formulas of effects that several models use.

/// Branches of the Prony series at most: three of viscoelastic, three of structural_damping.
inline constexpr int kMaxBranches = 6;

/// Gravity of a tilted board.
Eigen::Vector3d tilted_gravity(const EffectValues& effects, const Eigen::Vector3d& gravity);

/// Turn of the held patch: roll about the shaft, then tilt about x_W, then lean about y_W.
Eigen::Matrix3d jaw_rotation(const EffectValues& effects, const Eigen::Vector3d& shaft_axis);

/// Way that a held patch slips along the force F on the tool within dt [m], for tissue whose force
/// falls by `stiffness` per metre of slip [N/m]: it does not overshoot the force at which slip
/// ends, nor the whole way that the patch may slip, of which it has gone `slipped` [m].
/// Precondition: stiffness > 0.
Eigen::Vector3d slip_of(const EffectValues& effects, const Eigen::Vector3d& force, double stiffness,
                        double slipped, double dt);

/// Weight of a place at a distance from its centre in radii: 1 inside, falling smoothly from 3/4 to
/// 5/4.
double place_weight(double distance_over_radius);

/// Shares, sum 1, of the nodes p_B in what lies on a disc of the sheet, by place_weight() and the
/// `measure` of each node (area or mass); a disc between nodes is all of the nearest one's.
/// Precondition: as many of both, one and more, and radius > 0.
std::vector<double> disc_shares(std::span<const Eigen::Vector3d> nodes,
                                std::span<const double> measure, const Eigen::Vector2d& centre,
                                double radius);

/// Share of a rectangle of the sheet (x_B, y_B) that sticks; it must have an area.
double sticking_share(const EffectValues& effects, const Eigen::AlignedBox2d& part);

/// Shares of three branches with times 0.5, 0.05 and 0.005 s whose loss factor, that is loss over
/// storage modulus, is nearly `loss_factor`: 0.95 ... 1.12 of it from 0.3 to 30 Hz up to 0.2, 0.92
/// ... 1.22 up to 0.4. The storage modulus grows with the frequency, as it must (Kramers, Kronig).
std::array<double, 3> loss_branches(double loss_factor);

/// The Prony branches over a step h > 0 [s]:  H <- keep H + gain (S_new - S_old). Exact for S
/// linear in time.
struct PronyStep {
  int branches = 0;
  std::array<double, kMaxBranches> keep{}, gain{};
  double gains = 0;  ///< sum: stiffness of a step beyond the slow one
};
PronyStep make_prony(const EffectValues& effects, double h);
int prony_branches(const EffectValues& effects);

/// Secant stiffness of a cohesive spring, relative to a fresh one, whose longest stretch was
/// `longest`: 1 up to half of `limit`, 0 from `limit`.
double cohesive_share(double longest, double limit);

/// Part of a length of clamp edge, x_B +- half_width [m] > 0, that is detached, [0, 1].
double detached_share(const EffectValues& effects, double x, double half_width);

}  // namespace omentum
