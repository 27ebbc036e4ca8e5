#include "mismatch/explain/candidates.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/constants.h"

namespace omentum {
namespace {

using Eigen::Vector2d;

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
           const std::string& settings = "") {
    Candidate c;
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
    for (const Vector2d& p : places_on(sheet, kAdhesion)) {
      Candidate c;
      c.effect = "adhesion";
      c.size = 0.5 * size.minCoeff() / kAdhesion;
      c.place = p;
      c.column =
          fmt::format("adhesion.k@break_m=0.002:x={:.6g}:y={:.6g}:half_x={:.6g}:half_y={:.6g}",
                      p.x(), p.y(), c.size, c.size);
      c.key = c.column;
      c.unit = "N/m3";
      c.sd = 1e7;
      c.one_sided = true;
      list.add(c);
    }
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

}  // namespace

std::vector<Candidate> candidates_of(const Scene& scene,
                                     const std::vector<std::string>& ruled_out) {
  List list(ruled_out);
  list.add("strain_stiffening.c2_over_mu", "1", 5);
  for (const int angle : {0, 45, 90, 135})
    list.add("anisotropy.Ef_over_E", "1", 10, false, fmt::format("angle_deg={}", angle));
  for (const double tau : {0.3, 2.0})
    list.add("viscoelastic.g", "1", 1, true, fmt::format("tau={}", tau));
  list.add("anchor_compliance.inverse_K", "m2/N", 0.01, true);
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
  list.add("camera_bias.scale", "1", 0.1);
  add_places(scene, list);
  return list.list;
}

NamedEffect effect_of(const Candidate& c, double amplitude, const std::optional<Vector2d>& place,
                      const Scene& scene) {
  NamedEffect effect{c.effect, {}, {}};
  const std::string number = c.key.substr(0, c.key.find('@'));
  const std::string name = number.substr(number.find('.') + 1);
  const double a = c.one_sided ? std::max(amplitude, 0.0) : amplitude;
  if (c.effect == "inclusion") {
    const double k = std::max(1 + a, 0.05);
    effect.name = k < 1 ? "soft_spot" : "inclusion";
    effect.parameters = {{"k", "1", k}, {"r", "m", c.size}};
    effect.where = {{"centre_x", "m", place->x()}, {"centre_y", "m", place->y()}};
  } else if (c.effect == "adhesion") {
    constexpr double kBreak = 0.002;  // [m]
    effect.parameters = {{"k", "N/m3", a}, {"delta_c", "m", kBreak / std::sqrt(2.0)}};
    effect.where = {{"centre_x", "m", place->x()},
                    {"centre_y", "m", place->y()},
                    {"half_x", "m", c.size},
                    {"half_y", "m", c.size}};
  } else if (c.effect == "anchor_detachment") {
    const FreeSheet sheet = free_sheet(scene);
    effect.where = {{"from", "m", std::max(place->x() - 0.5 * a, sheet.low.x())},
                    {"to", "m", std::min(place->x() + 0.5 * a, sheet.high.x())}};
  } else if (c.effect == "anchor_compliance") {
    effect.parameters = {{"K_per_length", "N/m2", 1 / std::max(a, 1e-9)}};
  } else if (c.effect == "anisotropy") {
    const double angle = std::stod(c.key.substr(c.key.find('=') + 1));
    effect.parameters = {{"Ef_over_E", "1", a}, {"angle", "rad", angle * kDegree}};
  } else if (c.effect == "viscoelastic") {
    const double tau = std::stod(c.key.substr(c.key.find('=') + 1));
    effect.parameters = {{"g", "1", std::min(a, 0.95)}, {"tau", "s", tau}};
  } else {
    effect.parameters = {{name, c.unit, a}};
  }
  return effect;
}

}  // namespace omentum
