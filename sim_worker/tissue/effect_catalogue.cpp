#include "sim_worker/tissue/effect_catalogue.h"

#include <fmt/ranges.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "core/check.h"
#include "core/trig.h"
#include "proto/knob.pb.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;
using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kDegree = 3.14159265358979323846 / 180;
constexpr std::array<double, 3> kLossTimes = {0.5, 0.05, 0.005};  // [s]: 0.3 ... 30 Hz
// Loss of an endless row of equal branches a factor r apart, sum over k of 1 / (2 cosh(ln(w r^k))):
// its mean is pi / (2 ln r), and about it swing 2 / cosh(pi^2 / ln r) to first order (Poisson's
// sum). Largest at w = 1 / t. For r = 10:
constexpr double kLossRipple = 0.055;

Matrix3d turn(double angle, const Vector3d& axis) {
  const trig::SinCos a = trig::sin_cos(angle);
  Matrix3d cross;
  cross << 0, -axis.z(), axis.y(), axis.z(), 0, -axis.x(), -axis.y(), axis.x(), 0;
  return Matrix3d::Identity() + a.sin * cross + (1 - a.cos) * cross * cross;
}

/// Numbers with default zero are the switches of an effect; the others are scales of a switch.
bool is_on(const protobuf::Message& message) {
  const auto* reflection = message.GetReflection();
  std::vector<const protobuf::FieldDescriptor*> fields;
  reflection->ListFields(message, &fields);
  return std::any_of(fields.begin(), fields.end(), [&](const auto* field) {
    return field->cpp_type() == protobuf::FieldDescriptor::CPPTYPE_DOUBLE &&
           field->default_value_double() == 0 && reflection->GetDouble(message, field) != 0;
  });
}

}  // namespace

double decay(double x) {
  if (x > 64) return 0;
  // exp(-x) = (exp(-x/64))^64; 20 terms leave 1e-20 for x <= 64.
  const double y = x / 64;
  double value = 1;
  for (int k = 20; k >= 1; --k) value = 1 - y / k * value;
  for (int k = 0; k < 6; ++k) value *= value;
  return value;
}

bool EffectValues::same_structure(const EffectValues& o) const {
  return inclusion_x == o.inclusion_x && inclusion_y == o.inclusion_y &&
         inclusion_radius == o.inclusion_radius && inclusion_change == o.inclusion_change &&
         poisson_change == o.poisson_change && bending_change == o.bending_change &&
         thickness_x == o.thickness_x && thickness_y == o.thickness_y;
}

bool EffectValues::has_memory() const {
  return share[0] > 0 || share[1] > 0 || share[2] > 0 || loss_factor > 0 || slider_ratio > 0 ||
         softening > 0;
}

double EffectValues::stiffness_at(const Vector3d& p) const {
  if (inclusion_change == 0) return 1;
  const double dx = p.x() - inclusion_x;
  const double dy = p.y() - inclusion_y;
  const double u = std::sqrt(dx * dx + dy * dy) / inclusion_radius;
  const double t = std::clamp((1.25 - u) / 0.5, 0.0, 1.0);
  return 1 + inclusion_change * t * t * (3 - 2 * t);
}

double EffectValues::thickness_at(const Vector3d& p) const {
  return 1 + thickness_x * p.x() + thickness_y * p.y();
}

EffectValues make_effects(const pb::TissueEffects& e, double poisson_ratio,
                          std::span<const Vector3d> particles) {
  EffectValues v;
  v.stiffening = e.strain_stiffening();
  v.fibre_ratio = e.anisotropy().fibre_ratio();
  v.fibre_angle = e.anisotropy().angle_deg() * kDegree;
  if (e.viscoelastic_size() > static_cast<int>(v.share.size())) {
    throw_error("scene.tissue.effects.viscoelastic: {} branches, allowed at most {}",
                e.viscoelastic_size(), v.share.size());
  }
  for (int k = 0; k < e.viscoelastic_size(); ++k) {
    v.share[static_cast<std::size_t>(k)] = e.viscoelastic(k).share();
    v.time[static_cast<std::size_t>(k)] = e.viscoelastic(k).time_s();
  }
  v.loss_factor = e.structural_damping();
  v.slider_ratio = e.plastic_set().modulus_ratio();
  v.slider_yield = e.plastic_set().yield_strain();
  v.inclusion_x = e.inclusion().x_m();
  v.inclusion_y = e.inclusion().y_m();
  v.inclusion_radius = e.inclusion().radius_m();
  v.inclusion_change = e.inclusion().stiffness_change();
  v.density_change = e.density_change();
  v.tilt_x = e.gravity_tilt_x_deg() * kDegree;
  v.tilt_y = e.gravity_tilt_y_deg() * kDegree;
  v.poisson_change = e.poisson_change();
  v.bending_change = e.bending_change();
  v.curvature_x = e.rest_shape().curvature_x_per_m();
  v.curvature_y = e.rest_shape().curvature_y_per_m();
  v.twist = e.rest_shape().twist_per_m();
  v.stretch = e.rest_shape().stretch();
  v.thickness_x = e.thickness().x_per_m();
  v.thickness_y = e.thickness().y_per_m();
  v.adhesion = e.adhesion().stiffness_pa_per_m();
  v.adhesion_break = e.adhesion().break_m();
  v.suction = e.suction().drag_pa_s_per_m();
  v.suction_reach = e.suction().reach_m();
  v.friction_change = e.friction_change();
  v.anchor_compliance = e.anchor().compliance_m2_per_n();
  v.anchor_free_from = e.anchor().free_from_m();
  v.anchor_free_to = e.anchor().free_to_m();
  v.anchor_break = e.anchor().break_m();
  v.grasp_x = e.grasp_offset().x_m();
  v.grasp_y = e.grasp_offset().y_m();
  v.grasp_radius = e.grasp_offset().radius_m();
  v.slip_speed = e.grasp_slip().speed_m_per_s();
  v.slip_force = e.grasp_slip().force_n();
  v.slip_loss = e.grasp_slip().loss_m();
  v.grasp_compliance = e.grasp_compliance_m_per_n();
  v.jaw_roll = e.jaw_roll_deg() * kDegree;
  v.jaw_tilt = e.jaw_tilt_deg() * kDegree;
  v.air_drag = e.air_drag();
  v.softening = e.mullins().softening();
  v.softening_strain = e.mullins().strain();

  const EffectValues off;
  if (v.fibre_ratio == 0) v.fibre_angle = 0;
  for (std::size_t k = 0; k < v.share.size(); ++k) {
    if (v.share[k] == 0) v.time[k] = off.time[k];
  }
  if (v.slider_ratio == 0) v.slider_yield = off.slider_yield;
  if (v.inclusion_change == 0) {
    v.inclusion_x = v.inclusion_y = 0;
    v.inclusion_radius = off.inclusion_radius;
  }
  if (v.adhesion == 0) v.adhesion_break = off.adhesion_break;
  if (v.suction == 0) v.suction_reach = off.suction_reach;
  if (v.slip_speed == 0) {
    v.slip_force = off.slip_force;
    v.slip_loss = 0;
  }
  if (v.softening == 0) v.softening_strain = off.softening_strain;
  if (v.anchor_free_from == v.anchor_free_to) v.anchor_free_from = v.anchor_free_to = 0;

  const double nu = poisson_ratio + v.poisson_change;
  if (v.poisson_change != 0 && !(nu >= 0 && nu <= 0.49)) {
    throw_error(
        "scene.tissue.effects.poisson_change: {} makes Poisson's ratio {}, allowed 0 ... 0.49",
        v.poisson_change, nu);
  }
  for (const Vector3d& p : particles) {
    const double h = v.thickness_at(p);
    if (!(h >= 0.2 && h <= 5)) {
      throw_error(
          "scene.tissue.effects.thickness: ({}, {}) 1/m makes {} of the thickness at ({}, {}) m, "
          "allowed 0.2 ... 5",
          v.thickness_x, v.thickness_y, h, p.x(), p.y());
    }
  }
  if (v.anchor_free_from > v.anchor_free_to) {
    throw_error("scene.tissue.effects.anchor.free_to_m: {}, allowed from free_from_m {}",
                v.anchor_free_to, v.anchor_free_from);
  }
  if (v.anchor_break > 0 && !(v.anchor_compliance > 0)) {
    throw_error("scene.tissue.effects.anchor.break_m: {} m without compliance_m2_per_n, allowed 0",
                v.anchor_break);
  }
  return v;
}

bool usable(const EffectValues& v, double poisson_ratio, std::span<const Vector3d> particles) {
  static_assert(sizeof(EffectValues) % sizeof(double) == 0);
  const auto* values = reinterpret_cast<const double*>(&v);
  const std::span<const double> all(values, sizeof v / sizeof(double));
  // 1e8 and 1e-5: the widest knob, and the smallest scale that something is divided by.
  const auto scale = [](double x) { return x >= 1e-5; };
  const auto share = [](double x) { return x >= 0; };
  const double nu = poisson_ratio + v.poisson_change;
  return std::all_of(all.begin(), all.end(), [](double x) { return std::fabs(x) <= 1e8; }) &&
         std::all_of(v.share.begin(), v.share.end(), share) &&
         std::all_of(v.time.begin(), v.time.end(), scale) && share(v.loss_factor) &&
         share(v.slider_ratio) && share(v.fibre_ratio) && share(v.adhesion) && share(v.suction) &&
         share(v.anchor_compliance) && share(v.grasp_compliance) && share(v.slip_speed) &&
         scale(v.slider_yield) && scale(v.inclusion_radius) && scale(v.adhesion_break) &&
         scale(v.suction_reach) && scale(v.slip_force) && share(v.softening) &&
         v.softening <= 0.9 && scale(v.softening_strain) && v.inclusion_change >= -0.95 &&
         v.density_change >= -0.9 && v.density_change <= 4 && v.bending_change >= -0.95 &&
         v.stiffening >= -0.5 && std::fabs(v.stretch) <= 0.3 && nu >= 0 && nu <= 0.49 &&
         std::all_of(particles.begin(), particles.end(), [&](const Vector3d& p) {
           return v.thickness_at(p) >= 0.2 && v.thickness_at(p) <= 5;
         });
}

void refuse_effects(const pb::TissueEffects& effects, const std::string& model,
                    std::span<const char* const> allowed) {
  const auto* reflection = effects.GetReflection();
  std::vector<const protobuf::FieldDescriptor*> fields;
  reflection->ListFields(effects, &fields);
  for (const auto* field : fields) {
    bool on = false;
    if (field->is_repeated()) {
      for (int k = 0; k < reflection->FieldSize(effects, field); ++k) {
        on = on || is_on(reflection->GetRepeatedMessage(effects, field, k));
      }
    } else if (field->cpp_type() == protobuf::FieldDescriptor::CPPTYPE_MESSAGE) {
      on = is_on(reflection->GetMessage(effects, field));
    } else {
      on = reflection->GetDouble(effects, field) != 0;
    }
    const bool can = std::any_of(allowed.begin(), allowed.end(),
                                 [&](const char* name) { return field->name() == name; });
    if (!on || can) continue;
    throw_error("scene.tissue.effects.{}: not possible with {}, allowed there: {}", field->name(),
                model, fmt::join(allowed, ", "));
  }
}

void set_effect(pb::TissueEffects& effects, const std::string& path, double value) {
  protobuf::Message* message = &effects;
  std::size_t begin = 0;
  while (true) {
    const std::size_t dot = path.find('.', begin);
    std::string name = path.substr(begin, dot == std::string::npos ? dot : dot - begin);
    int index = 0;
    if (const std::size_t bracket = name.find('['); bracket != std::string::npos) {
      index = std::atoi(name.c_str() + bracket + 1);
      name.resize(bracket);
    }
    const auto* field = message->GetDescriptor()->FindFieldByName(name);
    const auto* reflection = message->GetReflection();
    const bool last = dot == std::string::npos;
    const bool is_message =
        field != nullptr && field->cpp_type() == protobuf::FieldDescriptor::CPPTYPE_MESSAGE;
    if (field == nullptr || is_message == last || index < 0 || index > 2) {
      std::string names;
      for (int k = 0; k < message->GetDescriptor()->field_count(); ++k) {
        names += (k == 0 ? "" : ", ") + message->GetDescriptor()->field(k)->name();
      }
      throw_error("tissue.effects.{}: no effect of that name, allowed at \"{}\": {}", path, name,
                  names);
    }
    if (last) {
      const pb::Knob& knob = field->options().GetExtension(pb::knob);
      if (!(value >= knob.min() && value <= knob.max())) {
        throw_error("tissue.effects.{}: {}, allowed {} ... {}", path, value, knob.min(),
                    knob.max());
      }
      reflection->SetDouble(message, field, value);
      return;
    }
    if (field->is_repeated()) {
      while (reflection->FieldSize(*message, field) <= index)
        reflection->AddMessage(message, field);
      message = reflection->MutableRepeatedMessage(message, field, index);
    } else {
      message = reflection->MutableMessage(message, field);
    }
    begin = dot + 1;
  }
}

Vector3d tilted_gravity(const EffectValues& effects, const Vector3d& gravity) {
  if (effects.tilt_x == 0 && effects.tilt_y == 0) return gravity;
  return turn(effects.tilt_y, Vector3d::UnitY()) *
         (turn(effects.tilt_x, Vector3d::UnitX()) * gravity);
}

Matrix3d jaw_turn(const EffectValues& effects, const Vector3d& shaft_axis) {
  if (effects.jaw_roll == 0 && effects.jaw_tilt == 0) return Matrix3d::Identity();
  return turn(effects.jaw_tilt, Vector3d::UnitX()) * turn(effects.jaw_roll, shaft_axis);
}

// F' = -stiffness v0 (F / Fs - 1) has the solution F - Fs ~ exp(-stiffness v0 t / Fs).
Vector3d slip_of(const EffectValues& effects, const Vector3d& force, double stiffness, double dt) {
  const double size = force.norm();
  if (!(effects.slip_speed > 0) || !(size > effects.slip_force)) return Vector3d::Zero();
  const double share = 1 - decay(stiffness * effects.slip_speed * dt / effects.slip_force);
  return share * (size - effects.slip_force) / stiffness / size * force;
}

// The loss factor at w = 1 / t of each branch: sum g (x - eta x^2) / (1 + x^2) = eta, x = w t.
std::array<double, 3> loss_shares(double loss_factor) {
  const double eta = loss_factor * (1 + kLossRipple);
  Matrix3d at;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      const double x =
          kLossTimes[static_cast<std::size_t>(k)] / kLossTimes[static_cast<std::size_t>(i)];
      at(i, k) = (x - eta * x * x) / (1 + x * x);
    }
  }
  const Vector3d share = at.inverse() * Vector3d::Constant(eta);
  return {share[0], share[1], share[2]};
}

PronyStep make_prony(const EffectValues& effects, double h) {
  PronyStep step;
  const auto add = [&](double share, double time) {
    if (!(share > 0)) return;
    const auto k = static_cast<std::size_t>(step.branches++);
    const double x = h / time;
    step.keep[k] = decay(x);
    // (1 - exp(-x)) / x loses digits for slow branches.
    step.gain[k] = share * (x < 1e-4 ? 1 - x / 2 + x * x / 6 : (1 - step.keep[k]) / x);
    step.gains += step.gain[k];
  };
  for (std::size_t k = 0; k < effects.share.size(); ++k) add(effects.share[k], effects.time[k]);
  const std::array<double, 3> loss = loss_shares(effects.loss_factor);
  for (std::size_t k = 0; k < loss.size(); ++k) add(loss[k], kLossTimes[k]);
  return step;
}

int prony_branches(const EffectValues& effects) { return make_prony(effects, 1).branches; }

bool anchors_fit(const EffectValues& scene, const EffectValues& lane) {
  if (scene.anchor_compliance > 0) return lane.anchor_compliance > 0;
  return lane.anchor_compliance == 0 && lane.anchor_free_from == scene.anchor_free_from &&
         lane.anchor_free_to == scene.anchor_free_to;
}

double cohesive_share(double longest, double limit) {
  if (!(longest > limit / 2)) return 1;
  return longest < limit ? (limit - longest) / longest : 0;
}

double detached_share(const EffectValues& effects, double x, double half_width) {
  if (effects.anchor_free_from == effects.anchor_free_to) return 0;
  const double low = std::max(effects.anchor_free_from, x - half_width);
  const double high = std::min(effects.anchor_free_to, x + half_width);
  const double share = std::clamp((high - low) / (2 * half_width), 0.0, 1.0);
  return share > 1 - 1e-9 ? 1 : share;  // rounding must not leave a thread
}

}  // namespace omentum
