#include "mismatch/explain/candidates.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/constants.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {
namespace {

using Eigen::Vector2d;

constexpr double kBreak = 0.002;  // [m] of the columns of adhesion

/// The sheet in frame B: what is free of the clamp [m].
struct FreeSheet {
  Vector2d low, high;
};
FreeSheet free_sheet(const Scene& scene) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& p : scene.tissue.particles) box.extend(p);
  FreeSheet sheet{box.min().head<2>(), box.max().head<2>()};
  sheet.low.y() = std::max(sheet.low.y(), scene.config.tissue().anchor_max_y_m());
  return sheet;
}

/// Middles of so many cells along each side.
std::vector<Vector2d> places_on(const FreeSheet& sheet, int per_side) {
  std::vector<Vector2d> places;
  for (int i = 0; i < per_side; ++i) {
    for (int j = 0; j < per_side; ++j) {
      const Vector2d share((i + 0.5) / per_side, (j + 0.5) / per_side);
      places.emplace_back(sheet.low + share.cwiseProduct(sheet.high - sheet.low));
    }
  }
  return places;
}

class List {
 public:
  explicit List(const std::vector<std::string>& ruled_out) : ruled_out_(ruled_out) {}
  /// A number of the whole set-up, whose column has its name and these settings.
  void add(const std::string& number, const std::string& unit, double sd, bool one_sided = false,
           const std::string& settings = "", double setting = 0) {
    Candidate c;
    c.setting = setting;
    c.column = settings.empty() ? number : number + "@" + settings;
    c.key = c.column;
    c.effect = number.substr(0, number.find('.'));
    c.unit = unit;
    c.sd = sd;
    c.one_sided = one_sided;
    add(c);
  }
  void add(const Candidate& candidate) {
    if (std::ranges::count(ruled_out_, candidate.effect) == 0) list.push_back(candidate);
  }
  std::vector<Candidate> list;

 private:
  const std::vector<std::string>& ruled_out_;
};

/// On a square of that half side.
void add_adhesion(const Vector2d& place, double half_side, List& list) {
  Candidate c;
  c.effect = "adhesion";
  c.size = half_side;
  c.place = place;
  c.column = fmt::format("adhesion.k@break_m={:g}:x={:.6g}:y={:.6g}:half_x={:.6g}:half_y={:.6g}",
                         kBreak, place.x(), place.y(), half_side, half_side);
  c.key = c.column;
  c.unit = "N/m3";
  c.sd = 1e7;
  c.one_sided = true;
  list.add(c);
}

void add_places(const Scene& scene, List& list) {
  constexpr int kStiffness = 5, kAdhesion = 4, kPieces = 8;  // places along a side
  const FreeSheet sheet = free_sheet(scene);
  const Vector2d size = sheet.high - sheet.low;
  const double cell = size.minCoeff() / kStiffness;
  for (const Vector2d& p : places_on(sheet, kStiffness)) {
    Candidate c;
    c.effect = "inclusion";
    c.size = cell;
    c.place = p;
    c.column = fmt::format("inclusion.k@x={:.6g}:y={:.6g}:r={:.6g}", p.x(), p.y(), c.size);
    c.key = c.column;
    c.unit.assign(1, '1');
    c.sd = 10;
    list.add(c);
  }
  if (!scene.bodies.empty()) {
    for (const Vector2d& p : places_on(sheet, kAdhesion))
      add_adhesion(p, 0.5 * size.minCoeff() / kAdhesion, list);
    add_adhesion(0.5 * (sheet.low + sheet.high), 0.5 * size.maxCoeff(), list);  // everywhere
  }
  for (int k = 0; k < kPieces; ++k) {
    Candidate c;
    c.effect = "anchor_detachment";
    c.size = 0.5 * size.x() / kPieces;
    c.place = Vector2d(sheet.low.x() + size.x() * (k + 0.5) / kPieces, sheet.low.y());
    c.column = fmt::format("anchor_detachment.length@x={:.6g}", c.place->x());
    c.key = c.column;
    c.unit.assign(1, 'm');
    c.sd = 0.05;
    c.one_sided = true;
    list.add(c);
  }
}

/// "k" of "inclusion.k@x=...".
std::string number_name(const Candidate& c) {
  const std::string number = c.key.substr(0, c.key.find('@'));
  return number.substr(number.find('.') + 1);
}

constexpr double kObstacleRadius = 0.01;  // [m]

EffectNumber factor(const std::string& name, const std::string& unit, double start, double step,
                    double sd, double low, double high) {
  return {name, unit, true, std::clamp(start, low, high), step, sd, low, high};
}

std::vector<EffectNumber> place_numbers(const Vector2d& place, const FreeSheet& sheet) {
  constexpr double kStep = 0.002, kSd = 0.015;  // [m]
  return {{"x", "m", false, place.x(), kStep, kSd, sheet.low.x(), sheet.high.x()},
          {"y", "m", false, place.y(), kStep, kSd, sheet.low.y(), sheet.high.y()}};
}

/// Steps in which a difference of simulations is well above its rounding, and ranges.
EffectNumber amplitude_number(const Candidate& c, double amplitude) {
  struct Scale {
    const char* effect;
    double step, low, high;
  };
  static constexpr Scale kScales[] = {
      {"grasp_offset", 5e-4, -0.01, 0.01}, {"jaw_orientation", 0.1, -1, 1},
      {"tool_backlash", 3e-4, 0, 0.01},    {"tool_compliance", 1e-3, 0, 0.1},
      {"rest_shape", 1, -20, 20},          {"thickness", 1, -10, 10},
      {"actuation_delay", 0.02, 0, 0.25},  {"strain_stiffening", 0.5, -0.4, 50},
  };
  EffectNumber number{number_name(c), c.unit, false, 0, 0.2 * std::fabs(amplitude),
                      c.sd,           -1e9,   1e9};
  for (const Scale& scale : kScales) {
    if (c.effect != scale.effect) continue;
    number.step = std::max(scale.step, number.step);
    number.low = scale.low;
    number.high = scale.high;
  }
  number.start = std::clamp(amplitude, number.low, number.high);
  return number;
}

}  // namespace

std::vector<Candidate> candidates_of(const Scene& scene,
                                     const std::vector<std::string>& ruled_out) {
  List list(ruled_out);
  list.add("strain_stiffening.c2_over_mu", "1", 5);
  for (const int angle : {0, 45, 90, 135})
    list.add("anisotropy.Ef_over_E", "1", 10, true, fmt::format("angle_deg={}", angle),
             angle * kDegree);
  for (const double tau : {0.3, 2.0})
    list.add("viscoelastic.g", "1", 1, true, fmt::format("tau={}", tau), tau);
  for (const char* axis : {"x", "y"}) {
    Candidate c;
    c.effect = "grasp_offset";
    c.key = std::string("grasp_offset.") + axis;
    c.pinch_axis = axis[0] - 'x';
    c.unit.assign(1, 'm');
    c.sd = 0.02;
    list.add(c);
  }
  for (const char* angle : {"roll", "tilt", "lean"})
    list.add(std::string("jaw_orientation.") + angle, "rad", 1);
  for (const char* axis : {"b_x", "b_y", "b_z"})
    list.add(std::string("tool_backlash.") + axis, "m", 0.01, true);
  for (const char* axis : {"C_x", "C_y", "C_z"})
    list.add(std::string("tool_compliance.") + axis, "m/N", 0.05, true);
  list.add("actuation_delay.tau", "s", 0.5, true);
  for (const char* number : {"kappa_x", "kappa_y"})
    list.add(std::string("rest_shape.") + number, "1/m", 20);
  for (const char* number : {"a_x", "a_y"}) list.add(std::string("thickness.") + number, "1/m", 20);
  add_places(scene, list);
  return list.list;
}

std::vector<Candidate> with_companions(const Candidate& candidate,
                                       const std::vector<Candidate>& candidates) {
  if (candidate.place || candidate.setting != 0 || candidate.secant != 0) return {candidate};
  std::vector<Candidate> all;
  for (const Candidate& c : candidates) {
    if (c.effect == candidate.effect && !c.place && c.setting == 0 && c.secant == 0)
      all.push_back(c);
  }
  return all;
}

double EffectNumber::value(double searched) const {
  return std::clamp(log ? std::exp(searched) : searched, low, high);
}

double EffectNumber::searched(double value) const {
  const double inside = std::clamp(value, low, high);
  return log ? std::log(inside) : inside;
}

std::vector<EffectNumber> effect_numbers(const Candidate& c,
                                         const std::vector<Candidate>& candidates,
                                         const std::vector<double>& amplitudes,
                                         const std::optional<Vector2d>& place, const Scene& scene) {
  const FreeSheet sheet = free_sheet(scene);
  const double a = amplitudes.front();
  std::vector<EffectNumber> numbers;
  if (c.effect == "inclusion") {
    numbers.push_back(factor("k", "1", 1 + a, 0.25, 1.5, 0.06, 20));
  } else if (c.effect == "adhesion") {
    numbers.push_back(factor("k", "N/m3", a, 0.4, 3, 1e3, 1e8));
    numbers.push_back(factor("delta_c", "m", kBreak / std::sqrt(2.0), 0.3, 1, 1e-4, 0.02));
  } else if (c.effect == "anchor_detachment") {
    // By its ends: a piece at a corner stays there while it becomes shorter.
    constexpr double kStep = 0.002, kSd = 0.03;  // [m]
    const double left = sheet.low.x(), right = sheet.high.x();
    const double half = 0.5 * std::clamp(a, 0.002, right - left);
    for (const auto& [name, x] : {std::pair{"from", place->x() - half}, {"to", place->x() + half}})
      numbers.push_back({name, "m", false, std::clamp(x, left, right), kStep, kSd, left, right});
    return numbers;
  } else if (c.effect == "obstacle") {
    const double height = c.setting == 0 ? a : c.setting - a;
    numbers.push_back({"height", "m", false, height, 5e-4, 0.005, c.setting == 0 ? 0 : 1e-3, 0.1});
    numbers.push_back(factor("radius", "m", kObstacleRadius, 0.2, 0.4, 0.002, 0.05));
  } else if (c.effect == "anchor_compliance") {
    numbers.push_back(factor("K_per_length", "N/m2", 1 / std::max(a, 1e-6), 0.3, 3, 10, 1e6));
  } else if (c.effect == "anisotropy") {
    numbers.push_back({"Ef_over_E", "1", false, std::clamp(a, 0.0, 10.0), 0.15, 3, 0, 10});
    numbers.push_back({"angle", "rad", false, c.setting, 0.15, 0.8, -kPi, kPi});
  } else if (c.effect == "viscoelastic") {
    numbers.push_back({"g", "1", false, std::clamp(a, 0.02, 0.9), 0.05, 0.5, 0, 0.95});
    numbers.push_back(factor("tau", "s", c.setting, 0.3, 1, 0.02, 100));
  } else if (c.effect == "grasp_slip") {
    numbers.push_back(factor("v0", "m/s", 0.005, 0.4, 1.5, 1e-4, 0.5));
    numbers.push_back(factor("Fs", "N", c.setting, 0.15, 1, 1e-3, 10));
    numbers.push_back({"total", "m", false, std::max(a, 5e-4), 3e-4, 0.005, 0, 0.03});
  } else {
    const std::vector<Candidate> all = with_companions(c, candidates);
    for (std::size_t k = 0; k < all.size(); ++k)
      numbers.push_back(amplitude_number(all[k], amplitudes[k]));
  }
  if (!place) return numbers;
  const std::vector<EffectNumber> where = place_numbers(*place, sheet);
  numbers.insert(numbers.end(), where.begin(), where.end());
  if (c.effect == "inclusion") numbers.push_back(factor("r", "m", c.size, 0.2, 0.4, 0.002, 0.05));
  if (c.effect == "adhesion")
    numbers.push_back(factor("half_size", "m", c.size, 0.2, 0.5, 0.002, 0.1));
  return numbers;
}

NamedEffect effect_of(const Candidate& c, const std::vector<EffectNumber>& numbers,
                      const std::vector<double>& values, const Scene& scene) {
  NamedEffect effect{c.effect, {}, {}};
  const auto value = [&](const std::string& name) {
    return values[static_cast<std::size_t>(std::ranges::find(numbers, name, &EffectNumber::name) -
                                           numbers.begin())];
  };
  if (c.effect == "anchor_detachment") {
    const auto [from, to] = std::minmax({value("from"), value("to")});
    effect.where = {{"from", "m", from}, {"to", "m", to}};
    return effect;
  }
  if (c.effect == "obstacle") {
    // Its nearest point is so far above what the sheet lies on.
    const double lower = -0.5 * scene.config.tissue().thickness_m();
    const double radius = value("radius");
    const double middle = lower + value("height") + (c.setting == 0 ? -radius : radius);
    const Eigen::Vector3d p_W = to_pose(scene.config.tissue().pose(), "scene.tissue.pose") *
                                Eigen::Vector3d(value("x"), value("y"), middle);
    effect.parameters = {{"radius", "m", radius}};
    effect.where = {
        {"centre_x", "m", p_W.x()}, {"centre_y", "m", p_W.y()}, {"centre_z", "m", p_W.z()}};
    return effect;
  }
  if (c.effect == "inclusion" && value("k") < 1) effect.name = "soft_spot";
  for (std::size_t k = 0; k < numbers.size(); ++k) {
    const EffectNumber& number = numbers[k];
    if (number.name == "half_size") {
      effect.where.push_back({"half_x", "m", values[k]});
      effect.where.push_back({"half_y", "m", values[k]});
    } else if (c.place && (number.name == "x" || number.name == "y")) {
      effect.where.push_back({"centre_" + number.name, "m", values[k]});
    } else {
      effect.parameters.push_back({number.name, number.unit, values[k]});
    }
  }
  return effect;
}

NamedEffect secant_effect(const Candidate& c, const Scene& scene) {
  const std::vector<EffectNumber> numbers = effect_numbers(c, {c}, {c.secant}, c.place, scene);
  std::vector<double> values;
  for (const EffectNumber& number : numbers) values.push_back(number.start);
  return effect_of(c, numbers, values, scene);
}

}  // namespace omentum
