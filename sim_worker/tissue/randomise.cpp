#include "sim_worker/tissue/randomise.h"

#include <algorithm>
#include <string>
#include <string_view>

#include "core/check.h"
#include "sim_worker/instrument/arm.h"
#include "sim_worker/instrument/jaw.h"

namespace omentum {
namespace {

constexpr std::string_view kEffectPrefix = "tissue.effects.";
constexpr std::string_view kArmPrefix = "arm.";

bool is_effect(const pb::Randomise& r) { return r.parameter().starts_with(kEffectPrefix); }
bool is_arm(const pb::Randomise& r) { return r.parameter().starts_with(kArmPrefix); }

std::string effect_path(const pb::Randomise& r) {
  return r.parameter().substr(kEffectPrefix.size());
}
std::string arm_path(const pb::Randomise& r) { return r.parameter().substr(kArmPrefix.size()); }

/// Both ends of the range have to be possible in the scene, with its model.
void check_drawn_effect(const pb::Randomise& r, const Scene& scene) {
  const std::string path = effect_path(r);
  const pb::Tissue& tissue = scene.config.tissue();
  if (path.rfind("obstacle.", 0) == 0 || path.rfind("added_mass.", 0) == 0 ||
      (path.rfind("anchor.", 0) == 0 && !(tissue.effects().anchor().compliance_m2_per_n() > 0))) {
    throw_error("randomise.parameter: {} is part of the scene, allowed: {}", r.parameter(),
                path.rfind("anchor.", 0) != 0 ? "the other effects"
                                              : "with anchor.compliance_m2_per_n above 0");
  }
  if (!(r.min() <= r.max()))
    throw_error("randomise {}: {} ... {}, allowed min <= max", r.parameter(), r.min(), r.max());
  for (const double value : {r.min(), r.max()}) {
    pb::TissueEffects effects = tissue.effects();
    set_effect(effects, path, value);
    make_effects(effects, tissue.material().poisson_ratio(), scene.tissue.particles);
    if (tissue.model() == pb::TISSUE_CLUSTER)
      refuse_effects(effects, kClusterModel, "TISSUE_CLUSTER");
    if (tissue.model() == pb::TISSUE_ELASTIC && tissue.has_volume())
      refuse_effects(effects, kSolidModel, "TISSUE_ELASTIC with a volume");
    if (path.rfind("anchor.", 0) == 0 && !(effects.anchor().compliance_m2_per_n() > 0))
      throw_error("randomise {}: {}, allowed above 0", r.parameter(), value);
    const bool sticks =
        effects.adhesion().stiffness_pa_per_m() > 0 || effects.suction().drag_pa_s_per_m() > 0;
    if (sticks && scene.bodies.empty())
      throw_error("randomise {}: nothing to stick to, needs a scene.rigid_body", r.parameter());
    if (sticks && tissue.model() == pb::TISSUE_CLUSTER && tissue.has_volume())
      throw_error("randomise {}: TISSUE_CLUSTER with a volume, allowed with a sheet",
                  r.parameter());
  }
}

/// Clusters alone have their thickness per lane; the jaw has to open around the thickest sheet.
void check_drawn_thickness(const pb::Randomise& r, const pb::Config& config, const Scene& scene) {
  const pb::Tissue& tissue = scene.config.tissue();
  if (tissue.model() != pb::TISSUE_CLUSTER || tissue.has_volume()) {
    throw_error("randomise {}: {}, allowed with a sheet of TISSUE_CLUSTER", r.parameter(),
                pb::TissueModelKind_Name(tissue.model()));
  }
  const pb::Grasp& grasp = config.grasp();
  const double needed_deg = jaw_contact_deg(grasp, r.max() * scene.tissue.thickness);
  if (grasp.jaw_open_deg() > 0 && grasp.jaw_open_deg() < needed_deg) {
    throw_error("randomise {}: {} ... {}: the jaw opens by {} deg and needs {:.4g}", r.parameter(),
                r.min(), r.max(), grasp.jaw_open_deg(), needed_deg);
  }
}

/// Both ends of the range have to be an arm.
void check_drawn_arm(const pb::Randomise& r, const Scene& scene, double control_period) {
  if (!(r.min() <= r.max()))
    throw_error("randomise {}: {} ... {}, allowed min <= max", r.parameter(), r.min(), r.max());
  for (const double value : {r.min(), r.max()}) {
    pb::ArmEffects effects = scene.config.arm();
    try {
      set_effect(effects, arm_path(r), value);
      Arm(effects, scene_tool_mount(scene), control_period);
    } catch (const Error& error) {
      throw_error("randomise {}: {} ... {}: {}", r.parameter(), r.min(), r.max(), error.what());
    }
  }
}

}  // namespace

void check_randomise(const pb::Config& config, const Scene& scene) {
  for (const pb::Randomise& r : config.randomise()) {
    if (is_effect(r)) {
      check_drawn_effect(r, scene);
      continue;
    }
    if (is_arm(r)) {
      check_drawn_arm(r, scene, config.task().control_period_s());
      continue;
    }
    static const char* const names[] = {"tissue.stiffness_scale", "tissue.gravity_scale",
                                        "tissue.damping_scale",   "tissue.friction_scale",
                                        "tissue.thickness_scale", "tissue.offset_x_m",
                                        "tissue.offset_y_m",      "tissue.offset_z_m"};
    if (std::none_of(std::begin(names), std::end(names),
                     [&](const char* n) { return r.parameter() == n; })) {
      throw_error(
          "randomise.parameter: {}, allowed: tissue.stiffness_scale, tissue.gravity_scale, "
          "tissue.damping_scale, tissue.friction_scale, tissue.thickness_scale, "
          "tissue.offset_x_m, tissue.offset_y_m, tissue.offset_z_m, tissue.effects.*, arm.*",
          r.parameter());
    }
    const bool is_thickness = r.parameter() == "tissue.thickness_scale";
    const bool is_scale = r.parameter().find("scale") != std::string::npos;
    const bool is_stiffness = r.parameter() == "tissue.stiffness_scale";
    // As usable() has it: tissue without stiffness has no shape.
    const double low = is_thickness ? 0.2 : is_stiffness ? 1e-3 : is_scale ? 0 : -0.02;
    const double high = is_thickness ? 5 : is_scale ? 10 : 0.02;
    if (!(r.min() >= low && r.max() <= high && r.min() <= r.max())) {
      throw_error("randomise {}: {} ... {}, allowed within {} ... {}", r.parameter(), r.min(),
                  r.max(), low, high);
    }
    if (is_thickness) check_drawn_thickness(r, config, scene);
  }
  // Effects that are drawn together have to be possible together.
  for (const bool highest : {false, true}) {
    pb::TissueEffects effects = scene.config.tissue().effects();
    for (const pb::Randomise& r : config.randomise()) {
      if (is_effect(r)) set_effect(effects, effect_path(r), highest ? r.max() : r.min());
    }
    make_effects(effects, scene.config.tissue().material().poisson_ratio(), scene.tissue.particles);
  }
}

bool draws_arm(const pb::Config& config) { return std::ranges::any_of(config.randomise(), is_arm); }

DrawnParameters not_drawn(const Scene& scene) {
  DrawnParameters drawn;
  drawn.arm = scene.config.arm();
  return drawn;
}

DrawnParameters draw_randomised(const pb::Config& config, const Scene& scene, const DrawKey& key) {
  DrawnParameters drawn = not_drawn(scene);
  LaneParameters& parameters = drawn.parameters;
  pb::TissueEffects effects = scene.config.tissue().effects();
  bool draws_effects = false;
  for (int i = 0; i < config.randomise_size(); ++i) {
    const pb::Randomise& r = config.randomise(i);
    if (!is_drawn(key, i)) continue;
    const double value = drawn_value(config, i, key);
    if (r.parameter() == "tissue.stiffness_scale") parameters.stiffness_scale = value;
    if (r.parameter() == "tissue.gravity_scale") parameters.gravity_scale = value;
    if (r.parameter() == "tissue.damping_scale") parameters.damping_scale = value;
    if (r.parameter() == "tissue.friction_scale") parameters.friction_scale = value;
    if (r.parameter() == "tissue.thickness_scale") parameters.thickness_scale = value;
    if (r.parameter() == "tissue.offset_x_m") drawn.offset.x() = value;
    if (r.parameter() == "tissue.offset_y_m") drawn.offset.y() = value;
    if (r.parameter() == "tissue.offset_z_m") drawn.offset.z() = value;
    if (is_arm(r)) set_effect(drawn.arm, arm_path(r), value);
    if (!is_effect(r)) continue;
    set_effect(effects, effect_path(r), value);
    draws_effects = true;
  }
  if (draws_effects) {
    parameters.effects = make_effects(effects, scene.config.tissue().material().poisson_ratio(),
                                      scene.tissue.particles);
  }
  return drawn;
}

}  // namespace omentum
