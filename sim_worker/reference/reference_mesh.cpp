#include "sim_worker/reference/reference_mesh.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>

#include "core/constants.h"
#include "core/trig.h"
#include "sim_worker/reference/reference_clamp.h"
#include "sim_worker/scene/clamp_rows.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

std::vector<double> even_lines(double from, double to, int count) {
  std::vector<double> lines;
  for (int k = 0; k <= count; ++k) lines.push_back(from + (to - from) * k / count);
  return lines;
}

/// Somewhere along an axis where the solution has a kink.
struct Kink {
  double at = 0;          ///< [m]
  double reach = 0;       ///< over which cells grow to full size [m]
  double denser = 0;      ///< times as many lines there in addition
  bool singular = false;  ///< cells as long as they are far from it, down to the reach
  double displaced = 0;   ///< from where its line is counted off (PinchCircle) [m]
};

// Singular lines (docs/decisions/0013, 0030): at the clamp the stress grows without bound. Where
// the law bears it, cells shrink with the distance; the other laws lose ellipticity in cells that
// small. At a pinch the curvature jumps, which a few smaller cells resolve; at the rim of a pad the
// stress is singular again.
constexpr double kDenserAtSingularClamp = 60;
constexpr double kDenserAtClamp = 4;
constexpr double kDenserAtPinch = 2;
constexpr double kDenserAtPad = 8;  // 16 on half the reach fails at 10 kPa
constexpr double kSoft = 1.5;  // bending length over thickness; 10 kPa needs the layers, 30 not

/// Relative number of lines per length at x.
double line_density(const std::vector<Kink>& kinks, double x) {
  double value = 1;
  for (const Kink& kink : kinks) {
    const double u = std::fabs(x - kink.at) / kink.reach;
    value = std::max(value, 1 + kink.denser / (1 + (kink.singular ? u : u * u)));
  }
  return value;
}

/// Lines denser at kinks, with a line on each. A density of lines, so that twice the count halves
/// every cell (docs/tissue.md 13). Kinks outside are ignored. `count` 0: cells of `size` away from
/// kinks.
std::vector<double> graded_lines(double from, double to, int count, double size,
                                 const std::vector<Kink>& kinks) {
  constexpr int kSamples = 4000;
  const double step = (to - from) / kSamples;
  const auto integrate = [&](const std::vector<Kink>& over) {  // the density, at even steps
    std::vector<double> sums = {0};
    for (int k = 0; k < kSamples; ++k)
      sums.push_back(sums.back() + step * line_density(over, from + (k + 0.5) * step));
    return sums;
  };
  const std::vector<double> integral = integrate(kinks);
  if (count == 0) count = static_cast<int>(std::ceil(integral.back() / size));
  const auto number_in = [&](const std::vector<double>& sums, double x) {  // of `count`, fractional
    const double t = (x - from) / step;
    const int k = std::min(static_cast<int>(t), kSamples - 1);
    return count * (sums[k] + (t - k) * (sums[k + 1] - sums[k])) / sums.back();
  };
  const auto line_number = [&](double x) { return number_in(integral, x); };
  const auto place = [&](double number) {
    const double wanted = number / count * integral.back();
    const auto above = std::upper_bound(integral.begin() + 1, integral.end() - 1, wanted);
    const auto k = static_cast<int>(above - integral.begin()) - 1;
    return from + step * (k + (wanted - integral[k]) / (integral[k + 1] - integral[k]));
  };
  // Kinks inside take the line nearest to them; the others are spread evenly between these.
  std::map<int, double> fixed = {{0, from}, {count, to}};
  const auto inside = [&](double x) { return x > from + kSameLine && x < to - kSameLine; };
  std::vector<Kink> counted = kinks;
  for (Kink& kink : counted) kink.at -= kink.displaced;
  const bool moved = std::ranges::any_of(kinks, [](const Kink& k) { return k.displaced != 0; });
  const std::vector<double> counted_integral = moved ? integrate(counted) : integral;
  for (std::size_t k = 0; k < kinks.size(); ++k) {
    if (!inside(kinks[k].at) || !inside(counted[k].at)) continue;
    const double number = number_in(counted_integral, counted[k].at);
    fixed.try_emplace(static_cast<int>(std::lround(number)), kinks[k].at);
  }
  const auto falls = [](const auto& one, const auto& next) { return next.second <= one.second; };
  if (moved && std::ranges::adjacent_find(fixed, falls) != fixed.end()) {
    // Displaced over another kink: its lines are counted off where it is.
    std::vector<Kink> here = kinks;
    for (Kink& kink : here) kink.displaced = 0;
    return graded_lines(from, to, count, size, here);
  }
  std::vector<double> lines;
  for (auto next = std::next(fixed.begin()); next != fixed.end(); ++next) {
    const auto last = std::prev(next);
    const double low = line_number(last->second);
    const double high = line_number(next->second);
    const int cells = next->first - last->first;
    lines.push_back(last->second);
    for (int k = 1; k < cells; ++k) lines.push_back(place(low + (high - low) * k / cells));
  }
  lines.push_back(to);
  return lines;
}

/// Length [m] within which a sheet that droops bends at its clamp: sqrt(D / (w L)) with the bending
/// stiffness of a plate, its weight per area and its free length.
double bending_length(const Scene& scene, double t, double length) {
  const pb::Tissue& tissue = scene.config.tissue();
  const double weight = tissue.density_kg_per_m3() * scene.gravity.norm() * t;
  const double nu = tissue.material().poisson_ratio();
  const double plate = tissue.material().young_modulus_pa() * t * t * t / (12 * (1 - nu * nu));
  return std::sqrt(plate / (weight * length));
}

/// Which singular lines the mesh resolves. A stated number of cells is spread more evenly: few of
/// them would all lie at the clamp.
struct Singular {
  bool clamp = false, rims = false;
};

/// Cells that meet a tolerance, measured on droops and lifts of sheets of 5 to 200 kPa
/// (docs/results/tissue.md): about 0.05 mm with cells of 0.7 of the thickness and three layers, of
/// the thickness and two where the clamp is not resolved. The cell follows the root 3/8 of the
/// error, and, from one thickness down to a half, the length within which a soft sheet bends.
struct MeshSize {
  double along = 0, across = 0;  ///< edges of the cells away from kinks, y and x [m]
  int layers = 0;
  bool soft = false;  ///< bends within so short a length that its layers are crowded at the faces
};
MeshSize mesh_size(const Scene& scene, const ReferenceTissueModel& model, double thickness,
                   double width, Singular singular) {
  const double length = model.second_edge - model.clamp_edge;
  const double bend = bending_length(scene, thickness, length);
  MeshSize size;
  size.soft = singular.clamp && bend < kSoft * thickness;
  // St. Venant-Kirchhoff bears small cells, but not at a pad's rim besides.
  const bool small =
      singular.clamp || (model.material.law() == pb::LAW_ST_VENANT_KIRCHHOFF && !singular.rims);
  const double cell =
      (small ? 0.7 : 1) * (singular.clamp ? std::clamp(bend / thickness, 0.5, 1.0) : 1);
  const int layers = !small ? 2 : singular.clamp && (singular.rims || size.soft) ? 5 : 3;
  const double fourth_root = std::sqrt(std::sqrt(model.numerics.tolerance_m() / 5e-5));
  const double scale = fourth_root * std::sqrt(fourth_root);
  size.along = cell * scale * std::min(thickness, length / 24);
  size.across = std::min(size.along, cell * scale * width / 4);
  size.layers = static_cast<int>(
      std::ceil(std::max(std::round(layers / scale), thickness / size.along - 1e-9)));
  return size;
}

/// Layers that are thin at the faces, where the clamp ends.
std::vector<double> sine_layers(double half, int layers) {
  std::vector<double> lines = even_lines(-half, half, layers);
  for (int k = 1; k < layers; ++k) lines[k] = half * trig::sin_cos(0.5 * kPi * lines[k] / half).sin;
  return lines;
}

/// Those of a soft sheet: the distance from a face goes with a power of the layer's number between
/// three and four, the outer layer grows with the cell, `cell` thicknesses long.
std::vector<double> crowded_layers(double half, int layers, double cell) {
  const double outer = 0.0256 * cell / 0.7;  // of half the thickness, (2 / 5)^4 in the default mesh
  const double t = 2.0 / std::max(3, layers);  // fewer are not crowded
  const double fourth = std::clamp((t * t * t - outer) / (t * t * t * (1 - t)), 0.0, 1.0);
  std::vector<double> lines = even_lines(-half, half, layers);
  for (int k = 1; k < layers; ++k) {
    const double to_face = 1 - std::fabs(lines[k]) / half;
    const double power = to_face * to_face * to_face * (1 - fourth + fourth * to_face);
    lines[k] = std::copysign(half * (1 - power), lines[k]);
  }
  return lines;
}

/// Along x and y: the edges of the clamps, the sides of the pinches.
std::array<std::vector<Kink>, 2> mesh_kinks(const ReferenceTissueModel& model, bool clamped,
                                            std::span<const PinchCircle> pinches, double thickness,
                                            Singular singular) {
  std::array<std::vector<Kink>, 2> kinks;
  const auto add_edge = [&](double at) {
    kinks[1].push_back(singular.clamp ? Kink{at, thickness / 15, kDenserAtSingularClamp, true}
                                      : Kink{at, thickness, kDenserAtClamp});
  };
  if (clamped) add_edge(model.clamp_edge);
  if (model.body.two_clamps) add_edge(model.second_edge);
  for (const PinchCircle& pinch : pinches) {
    const Eigen::Vector2d half = model.surroundings.grip.box(pinch.radius);
    for (int axis = 0; axis < 2; ++axis) {
      for (const double side : {-half[axis], half[axis]}) {
        const double at = pinch.centre[axis] + side;
        kinks[axis].push_back(singular.rims ? Kink{at, thickness / 3, kDenserAtPad}
                                            : Kink{at, half[axis], kDenserAtPinch});
        kinks[axis].back().displaced = pinch.displaced[axis];
      }
    }
  }
  return kinks;
}

/// Lines along y from clamp to clamp and, beyond them, those of the strips. A clamped strip is
/// rigid: one row of elements, for the positions of its particles. On a bed it bends and shears.
std::vector<double> lines_along(const ReferenceTissueModel& model, double low, double high,
                                int count, double size, const std::vector<Kink>& kinks) {
  std::vector<double> ys = graded_lines(model.clamp_edge, model.second_edge, count, size, kinks);
  const bool bends = model.effects.anchor_compliance > 0 && count == 0;
  const auto strip = [&](double from, double to) {
    return graded_lines(from, to, bends ? 0 : 1, size, kinks);
  };
  if (model.clamp_edge > low + kSameLine) {
    const std::vector<double> rows = strip(low, model.clamp_edge);
    ys.insert(ys.begin(), rows.begin(), rows.end() - 1);
  }
  if (model.second_edge < high - kSameLine) {
    const std::vector<double> rows = strip(model.second_edge, high);
    ys.insert(ys.end(), rows.begin() + 1, rows.end());
  }
  return ys;
}

/// Nodes on the lines, between the faces of a sheet whose thickness differs from place to place.
void make_nodes(bool flat_lower_face, ReferenceTissueModel& model) {
  const double half = 0.5 * model.body.thickness;
  for (const double y : model.lines[1]) {
    for (const double x : model.lines[0]) {
      const double h =
          model.body.thickness_map.at({x, y, 0}) * model.effects.thickness_at({x, y, 0});
      for (const double z : model.lines[2])
        model.nodes.emplace_back(x, y, flat_lower_face ? h * (z + half) - half : h * z);
    }
  }
}

}  // namespace

void make_mesh(const Scene& scene, std::span<const PinchCircle> pinches,
               const ReferenceTissueModel* mesh_of, ReferenceTissueModel& model) {
  Eigen::AlignedBox3d box;
  for (const Vector3d& p : model.body.particles) box.extend(p);
  const Vector3d min = box.min();
  const Vector3d max = box.max();
  const pb::Tissue& tissue = scene.config.tissue();
  const pb::ReferenceModel& n = model.numerics;
  const bool clamped = in_lower_clamp(tissue, min.y());
  model.clamp_edge = clamped ? std::max(tissue.anchor_max_y_m(), min.y()) : min.y();
  model.second_edge = model.body.two_clamps ? std::min(tissue.anchor_min_y_m(), max.y()) : max.y();

  const Singular singular = {
      .clamp = model.material.law() == pb::LAW_NEO_HOOKE && n.elements_y() == 0,
      .rims = model.surroundings.grip.pad && !pinches.empty() && n.elements_x() == 0 &&
              n.elements_y() == 0};
  const double thickness =
      n.graded_thickness_m() > 0 ? n.graded_thickness_m() : scene.tissue.thickness;
  const MeshSize size = mesh_size(scene, model, thickness, max.x() - min.x(), singular);
  int layers = n.elements_z() > 0 ? static_cast<int>(n.elements_z()) : size.layers;
  if (mesh_of != nullptr) {
    model.lines = mesh_of->lines;
    layers = mesh_of->cells(2);
  } else {
    const auto kinks = mesh_kinks(model, clamped, pinches, thickness, singular);
    model.lines[0] =
        graded_lines(min.x(), max.x(), static_cast<int>(n.elements_x()), size.across, kinks[0]);
    model.lines[1] = lines_along(model, min.y(), max.y(), static_cast<int>(n.elements_y()),
                                 size.along, kinks[1]);
  }
  const double half = 0.5 * model.body.thickness;
  model.lines[2] = !singular.clamp ? even_lines(-half, half, layers)
                   : size.soft     ? crowded_layers(half, layers, size.along / thickness)
                                   : sine_layers(half, layers);
  make_nodes(tissue.flat_lower_face(), model);
  model.unknown.assign(model.nodes.size(), 0);
  for (std::size_t i = 0; i < model.nodes.size(); ++i) {
    const double y = model.nodes[i].y();
    const bool second = model.body.two_clamps && y >= model.second_edge - kSameLine;
    if (second || (clamped && y <= model.clamp_edge + kSameLine)) model.unknown[i] = -1;
  }
  release_anchors(model);
}

}  // namespace omentum
