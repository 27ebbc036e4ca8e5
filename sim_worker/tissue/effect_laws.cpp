#include "sim_worker/tissue/effect_laws.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr std::array<double, 3> kLossTimes = {0.5, 0.05, 0.005};  // [s]: 0.3 ... 30 Hz
// Loss of an endless row of equal branches a factor r apart, sum over k of 1 / (2 cosh(ln(w r^k))):
// its mean is pi / (2 ln r), and about it swing 2 / cosh(pi^2 / ln r) to first order (Poisson's
// sum). Largest at w = 1 / t. For r = 10:
constexpr double kLossRipple = 0.055;

Matrix3d rotation(double angle, const Vector3d& axis) {
  const trig::SinCos a = trig::sin_cos(angle);
  Matrix3d cross;
  cross << 0, -axis.z(), axis.y(), axis.z(), 0, -axis.x(), -axis.y(), axis.x(), 0;
  return Matrix3d::Identity() + a.sin * cross + (1 - a.cos) * cross * cross;
}

}  // namespace

Vector3d tilted_gravity(const EffectValues& effects, const Vector3d& gravity) {
  if (effects.tilt_x == 0 && effects.tilt_y == 0) return gravity;
  return rotation(effects.tilt_y, Vector3d::UnitY()) *
         (rotation(effects.tilt_x, Vector3d::UnitX()) * gravity);
}

Matrix3d jaw_rotation(const EffectValues& effects, const Vector3d& shaft_axis) {
  if (!effects.turns_jaw()) return Matrix3d::Identity();
  const Matrix3d turn =
      rotation(effects.jaw_tilt, Vector3d::UnitX()) * rotation(effects.jaw_roll, shaft_axis);
  if (effects.jaw_lean == 0) return turn;
  return rotation(effects.jaw_lean, Vector3d::UnitY()) * turn;
}

// F' = -stiffness v0 (F / Fs - 1) has the solution F - Fs ~ exp(-stiffness v0 t / Fs).
Vector3d slip_of(const EffectValues& effects, const Vector3d& force, double stiffness,
                 double slipped, double dt) {
  const double size = force.norm();
  if (!(effects.slip_speed > 0) || !(size > effects.slip_force)) return Vector3d::Zero();
  const double fraction = 1 - trig::decay(stiffness * effects.slip_speed * dt / effects.slip_force);
  const double way = fraction * (size - effects.slip_force) / stiffness;
  const double left = effects.slip_total - slipped;
  if (!(effects.slip_total > 0) || way < left) return way / size * force;
  return std::max(left, 0.0) / size * force;
}

double place_weight(double distance_over_radius) {
  const double t = std::clamp((1.25 - distance_over_radius) / 0.5, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

std::vector<double> disc_shares(std::span<const Vector3d> nodes, std::span<const double> measure,
                                const Eigen::Vector2d& centre, double radius) {
  std::vector<double> share(nodes.size(), 0.0);
  double whole = 0;
  std::size_t nearest = 0;
  double least = -1;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const double distance = (nodes[i].head<2>() - centre).norm();
    share[i] = place_weight(distance / radius) * measure[i];
    whole += share[i];
    if (measure[i] > 0 && (least < 0 || distance < least)) {
      least = distance;
      nearest = i;
    }
  }
  if (!(whole > 0)) {
    share[nearest] = 1;
    return share;
  }
  for (double& s : share) s /= whole;
  return share;
}

double sticking_share(const EffectValues& effects, const Eigen::AlignedBox2d& part) {
  if (effects.sticks_everywhere()) return 1;
  const Eigen::Vector2d centre(effects.adhesion_x, effects.adhesion_y);
  const Eigen::Vector2d half(effects.adhesion_half_x, effects.adhesion_half_y);
  const Eigen::AlignedBox2d common =
      part.intersection(Eigen::AlignedBox2d(centre - half, centre + half));
  return common.isEmpty() ? 0 : common.volume() / part.volume();
}

// The loss factor at w = 1 / t of each branch: sum g (x - eta x^2) / (1 + x^2) = eta, x = w t.
std::array<double, 3> loss_branches(double loss_factor) {
  const double eta = loss_factor * (1 + kLossRipple);
  Matrix3d at;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      const double x = kLossTimes[k] / kLossTimes[i];
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
    step.keep[k] = trig::decay(x);
    // (1 - exp(-x)) / x loses digits for slow branches.
    step.gain[k] = share * (x < 1e-4 ? 1 - x / 2 + x * x / 6 : (1 - step.keep[k]) / x);
    step.gains += step.gain[k];
  };
  for (std::size_t k = 0; k < effects.share.size(); ++k) add(effects.share[k], effects.time[k]);
  const std::array<double, 3> loss = loss_branches(effects.loss_factor);
  for (std::size_t k = 0; k < loss.size(); ++k) add(loss[k], kLossTimes[k]);
  return step;
}

int prony_branches(const EffectValues& effects) { return make_prony(effects, 1).branches; }

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
