#pragma once

// One small sheet for both elastic models, and the list of effects with an amplitude each.

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/models.h"
#include "sim_worker/reference/reference_tissue.h"
#include "support/shell_scene.h"

namespace omentum::test {

enum class Model { kElastic, kReference };

struct EffectCase : ShellCase {
  pb::TissueEffects effects;
  unsigned ex = 2, ey = 15;  ///< elements of the reference
};

inline Scene make_effect_scene(const EffectCase& c, Model model) {
  Scene scene = make_shell_scene(c);
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  *tissue.mutable_effects() = c.effects;
  tissue.set_anchor_max_y_m(c.anchor_max_y);
  for (std::size_t i = 0; i < scene.tissue.particles.size(); ++i) {
    scene.tissue.fixed[i] = scene.tissue.particles[i].y() <= c.anchor_max_y + 1e-9 ? 1 : 0;
  }
  if (model == Model::kReference) {
    tissue.set_model(pb::TISSUE_REFERENCE);
    tissue.mutable_reference()->set_elements_x(c.ex);
    tissue.mutable_reference()->set_elements_y(c.ey);
    tissue.mutable_reference()->set_elements_z(1);
  }
  return scene;
}

inline std::unique_ptr<Tissue<double>> make_effect_tissue(const EffectCase& c, Model model) {
  std::vector<std::string> warnings;
  return make_tissue_model(make_effect_scene(c, model), 0.02, warnings)->make_tissue(f64x1());
}

inline void rest(Tissue<double>& tissue, double seconds,
                 const Eigen::Vector3d& tip = Eigen::Vector3d(0, 0, 1)) {
  const ToolMotion still{tip, tip};
  for (int k = 0; k < static_cast<int>(seconds / 0.02 + 0.5); ++k) tissue.step({&still, 1});
}

/// Half-space whose surface the lower face of a sheet at z = 0 just misses.
inline RigidShape make_board(double below) {
  RigidShape board;
  board.kind = RigidShape::Kind::kHalfSpace;
  board.role = pb::ROLE_BOARD;
  board.X_WS.translation() = Eigen::Vector3d(0, 0, -below);
  return board;
}

/// The first inclusion, made where there is none.
inline pb::Inclusion* inclusion_of(pb::TissueEffects& effects) {
  return effects.inclusion_size() > 0 ? effects.mutable_inclusion(0) : effects.add_inclusion();
}

struct NamedEffect {
  const char* name;
  void (*set)(pb::TissueEffects& effects, double amplitude);
  bool needs_board = false;
};

/// Amplitude 1: plainly visible on the sheet of these tests.
inline std::span<const NamedEffect> all_effects() {
  using E = pb::TissueEffects;
  static const NamedEffect effects[] = {
      {"strain_stiffening", [](E& e, double a) { e.set_strain_stiffening(5 * a); }},
      {"exponential_stiffening", [](E& e, double a) { e.set_exponential_stiffening(20 * a); }},
      {"anisotropy",
       [](E& e, double a) {
         e.mutable_anisotropy()->set_fibre_ratio(a);
         e.mutable_anisotropy()->set_angle_deg(30);
       }},
      {"viscoelastic",
       [](E& e, double a) {
         auto* branch =
             e.viscoelastic_size() > 0 ? e.mutable_viscoelastic(0) : e.add_viscoelastic();
         branch->set_share(0.5 * a);
         branch->set_time_s(0.3);
       }},
      {"structural_damping", [](E& e, double a) { e.set_structural_damping(0.2 * a); }},
      {"plastic_set",
       [](E& e, double a) {
         e.mutable_plastic_set()->set_modulus_ratio(0.5 * a);
         e.mutable_plastic_set()->set_yield_strain(0.005);
       }},
      {"mullins",
       [](E& e, double a) {
         e.mutable_mullins()->set_softening(0.6 * a);
         e.mutable_mullins()->set_strain(0.01);
       }},
      {"inclusion",
       [](E& e, double a) {
         inclusion_of(e)->set_radius_m(0.006);
         inclusion_of(e)->set_stiffness_change(3 * a);
       }},
      {"soft_spot",
       [](E& e, double a) {
         inclusion_of(e)->set_radius_m(0.006);
         inclusion_of(e)->set_stiffness_change(-0.6 * a);
       }},
      {"density", [](E& e, double a) { e.set_density_change(0.3 * a); }},
      {"added_mass",
       [](E& e, double a) {
         e.mutable_added_mass()->set_mass_kg(2e-4 * a);
         e.mutable_added_mass()->set_y_m(0.004);
       }},
      {"local_force",
       [](E& e, double a) {
         auto& force = *e.mutable_local_force();
         force.set_strength(a);
         force.set_x_m(-0.004);
         force.set_y_m(0.002);
         force.set_radius_m(0.005);
         force.set_stiffness_n_per_m(0.5);
         force.set_slack_m(0.002);
         force.set_anchor_x_m(-0.004);
         force.set_anchor_y_m(0.002);
         force.set_anchor_z_m(0.006);
         force.set_damper_n_s_per_m(0.01);
         force.set_push_z_n(5e-4);
         force.set_decay_s(0.2);
       }},
      {"gravity_tilt",
       [](E& e, double a) {
         e.set_gravity_tilt_x_deg(3 * a);
         e.set_gravity_tilt_y_deg(-2 * a);
       }},
      {"poisson", [](E& e, double a) { e.set_poisson_change(-0.2 * a); }},
      {"bending_stiffness", [](E& e, double a) { e.set_bending_change(a); }},
      {"rest_shape",
       [](E& e, double a) {
         e.mutable_rest_shape()->set_curvature_x_per_m(3 * a);
         e.mutable_rest_shape()->set_curvature_y_per_m(5 * a);
         e.mutable_rest_shape()->set_twist_per_m(2 * a);
       }},
      {"pre_stretch", [](E& e, double a) { e.mutable_rest_shape()->set_stretch(-0.02 * a); }},
      {"thickness",
       [](E& e, double a) {
         e.mutable_thickness()->set_x_per_m(5 * a);
         e.mutable_thickness()->set_y_per_m(3 * a);
       }},
      {"adhesion", [](E& e, double a) { e.mutable_adhesion()->set_stiffness_pa_per_m(1e5 * a); },
       true},
      {"suction", [](E& e, double a) { e.mutable_suction()->set_drag_pa_s_per_m(1e4 * a); }, true},
      {"board_friction", [](E& e, double a) { e.set_friction_change(a); }, true},
      {"anchor_compliance",
       [](E& e, double a) { e.mutable_anchor()->set_compliance_m2_per_n(1e-3 * a); }},
      {"anchor_detachment",
       [](E& e, double a) {
         e.mutable_anchor()->set_free_from_m(0.001);
         e.mutable_anchor()->set_free_to_m(0.001 + 0.006 * a);
       }},
      {"grasp_offset",
       [](E& e, double a) {
         e.mutable_grasp_offset()->set_x_m(0.002 * a);
         e.mutable_grasp_offset()->set_y_m(-0.001 * a);
       }},
      {"grasp_slip",
       [](E& e, double a) {
         e.mutable_grasp_slip()->set_speed_m_per_s(0.01 * a);
         e.mutable_grasp_slip()->set_force_n(0.002);
       }},
      {"grasp_compliance", [](E& e, double a) { e.set_grasp_compliance_m_per_n(5e-3 * a); }},
      {"jaw_roll", [](E& e, double a) { e.set_jaw_roll_deg(10 * a); }},
      {"jaw_tilt", [](E& e, double a) { e.set_jaw_tilt_deg(10 * a); }},
      {"jaw_lean", [](E& e, double a) { e.set_jaw_lean_deg(10 * a); }},
      {"grasp_turn", [](E& e, double a) { e.set_grasp_turn_rad_per_n_m(20 * a); }},
      {"air_drag", [](E& e, double a) { e.set_air_drag(50 * a); }},
  };
  return effects;
}

/// Sheet of 24 mm, clamped along one side, that is taken at the opposite side and lifted.
inline EffectCase lift_case(bool board) {
  EffectCase c;
  c.nx = c.ny = 9;
  c.anchor_max_y = -0.012;
  c.young = 2e4;
  c.poisson = 0.4;
  c.static_friction = c.dynamic_friction = 0.3;
  c.ex = c.ey = 4;
  if (board) c.bodies = {make_board(0.00152)};
  return c;
}

/// Of two shapes with as many points [m].
inline double largest_distance(const std::vector<Eigen::Vector3d>& a,
                               const std::vector<Eigen::Vector3d>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, (a[i] - b[i]).norm());
  return largest;
}

inline void lift(Tissue<double>& tissue, int from, int to, double radius = 0.0045) {
  const Eigen::Vector3d start(0.001, 0.0095, 0);
  const auto tip = [&](int step) {
    return Eigen::Vector3d(start + step * Eigen::Vector3d(0.0001, -0.0001, 0.0005));
  };
  for (int step = from; step < to; ++step) {
    if (step == 0) tissue.hold(0, tip(step), radius, false);
    const ToolMotion motion{tip(step), tip(step + 1)};
    tissue.step({&motion, 1});
  }
}

}  // namespace omentum::test
