#include "sim_worker/reference/reference_model.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>

#include "core/check.h"
#include "core/constants.h"
#include "core/machine_memory.h"
#include "core/trig.h"
#include "sim_worker/reference/reference_clamp.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/scene/clamp_rows.h"
#include "sim_worker/tissue/effect_laws.h"

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
  std::vector<double> integral = {0};  // of the density, at even steps
  const double step = (to - from) / kSamples;
  for (int k = 0; k < kSamples; ++k)
    integral.push_back(integral.back() + step * line_density(kinks, from + (k + 0.5) * step));
  if (count == 0) count = static_cast<int>(std::ceil(integral.back() / size));
  const auto line_number = [&](double x) {  // of `count` in all, fractional
    const double t = (x - from) / step;
    const int k = std::min(static_cast<int>(t), kSamples - 1);
    return count * (integral[k] + (t - k) * (integral[k + 1] - integral[k])) / integral.back();
  };
  const auto place = [&](double number) {
    const double wanted = number / count * integral.back();
    const auto above = std::upper_bound(integral.begin() + 1, integral.end() - 1, wanted);
    const auto k = static_cast<int>(above - integral.begin()) - 1;
    return from + step * (k + (wanted - integral[k]) / (integral[k + 1] - integral[k]));
  };
  // Kinks inside take the line nearest to them; the others are spread evenly between these.
  std::map<int, double> fixed = {{0, from}, {count, to}};
  for (const Kink& kink : kinks) {
    if (kink.at > from + kSameLine && kink.at < to - kSameLine)
      fixed.try_emplace(static_cast<int>(std::lround(line_number(kink.at))), kink.at);
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

/// Map from the box to the stress-free shape at every Gauss point (HexRest): that of the thickness
/// and that of growth, where a rest curvature k makes a layer at height z shorter by z k.
void make_rest(ReferenceTissueModel& model) {
  const EffectValues& fx = model.effects;
  const bool curved = fx.curvature_x != 0 || fx.curvature_y != 0 || fx.twist != 0;
  const bool thick =
      fx.thickness_x != 0 || fx.thickness_y != 0 || model.body.thickness_map.count_x > 0;
  if (!curved && fx.stretch == 0 && !thick) return;
  constexpr double kGauss = 0.57735026918962576451;
  model.rest.resize(model.batches());
  for (std::size_t batch = 0; batch < model.rest.size(); ++batch) {
    for (int lane = 0; lane < Pack::kLanes; ++lane) {
      const ReferenceElement& element =
          model.elements[std::min(Pack::kLanes * batch + lane, model.elements.size() - 1)];
      for (int point = 0; point < kHexPoints; ++point) {
        const auto sign = [](int corner, int axis) {
          return ((corner >> axis) & 1) != 0 ? 1.0 : -1.0;
        };
        Eigen::Matrix3d box_to_rest = Eigen::Matrix3d::Zero();
        double z = 0;
        for (int a = 0; a < 8; ++a) {
          Vector3d gradient;
          double N = 0.125;
          for (int axis = 0; axis < 3; ++axis) {
            double d = 0.125 * sign(a, axis) * 2 / element.size[axis];
            for (int other = 0; other < 3; ++other) {
              if (other != axis) d *= 1 + sign(a, other) * sign(point, other) * kGauss;
            }
            gradient[axis] = d;
            N *= 1 + sign(a, axis) * sign(point, axis) * kGauss;
          }
          const Vector3d& X = model.nodes[element.node[a]];
          box_to_rest += X * gradient.transpose();
          z += N * X.z();
        }
        Eigen::Matrix3d growth = Eigen::Matrix3d::Identity();
        growth.topLeftCorner<2, 2>() *= 1 + fx.stretch;
        growth(0, 0) -= z * fx.curvature_x;
        growth(1, 1) -= z * fx.curvature_y;
        growth(0, 1) -= z * fx.twist;
        growth(1, 0) -= z * fx.twist;
        const Eigen::Matrix3d map = box_to_rest.inverse() * growth.inverse();
        HexRest& rest = model.rest[batch];
        for (int k = 0; k < 9; ++k) rest.map[point][k].set_lane(lane, map(k / 3, k % 3));
        rest.volume[point].set_lane(lane, box_to_rest.determinant());
      }
    }
  }
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

/// Cells that meet a tolerance, measured on droops and lifts of sheets of 10 to 200 kPa
/// (docs/results.md): about 0.05 mm with cells of 0.7 of the thickness and three layers, of the
/// thickness and two where the clamp is not resolved. The cell follows the root 3/8 of the error,
/// and, from one thickness down to a half, the length within which a soft sheet bends.
struct MeshSize {
  double along = 0, across = 0;  ///< edges of the cells away from kinks, y and x [m]
  int layers = 0;
};
MeshSize mesh_size(double tolerance, double thickness, double length, double width, double cell,
                   int layers) {
  const double fourth_root = std::sqrt(std::sqrt(tolerance / 5e-5));
  const double scale = fourth_root * std::sqrt(fourth_root);
  MeshSize size;
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

void make_lines(const Scene& scene, std::span<const PinchCircle> pinches,
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
  std::vector<double> edges;
  if (clamped) edges.push_back(model.clamp_edge);
  if (model.body.two_clamps) edges.push_back(model.second_edge);
  std::array<std::vector<Kink>, 2> kinks;
  const double thickness =
      n.graded_thickness_m() > 0 ? n.graded_thickness_m() : scene.tissue.thickness;
  // A stated number of cells is spread more evenly: few of them would all lie at the clamp.
  const bool bears_singularity = model.material.law() == pb::LAW_NEO_HOOKE && n.elements_y() == 0;
  for (const double edge : edges) {
    kinks[1].push_back(bears_singularity ? Kink{edge, thickness / 15, kDenserAtSingularClamp, true}
                                         : Kink{edge, thickness, kDenserAtClamp});
  }
  const bool bears_rims =
      model.surroundings.grip.pad && !pinches.empty() && n.elements_x() == 0 && n.elements_y() == 0;
  for (const PinchCircle& pinch : pinches) {
    const Eigen::Vector2d half = model.surroundings.grip.box(pinch.radius);
    for (int axis = 0; axis < 2; ++axis) {
      for (const double side : {-half[axis], half[axis]}) {
        const double at = pinch.centre[axis] + side;
        kinks[axis].push_back(bears_rims ? Kink{at, thickness / 3, kDenserAtPad}
                                         : Kink{at, half[axis], kDenserAtPinch});
      }
    }
  }
  const double length = model.second_edge - model.clamp_edge;
  const double bend = bending_length(scene, thickness, length);
  const bool soft = bears_singularity && bend < kSoft * thickness;
  // St. Venant-Kirchhoff bears small cells, but not at a pad's rim besides.
  const bool small =
      bears_singularity || (model.material.law() == pb::LAW_ST_VENANT_KIRCHHOFF && !bears_rims);
  const int layers_meant = !small ? 2 : bears_singularity && (bears_rims || soft) ? 5 : 3;
  const double cell =
      (small ? 0.7 : 1) * (bears_singularity ? std::clamp(bend / thickness, 0.5, 1.0) : 1);
  const MeshSize size =
      mesh_size(n.tolerance_m(), thickness, length, max.x() - min.x(), cell, layers_meant);
  model.lines[0] =
      graded_lines(min.x(), max.x(), static_cast<int>(n.elements_x()), size.across, kinks[0]);
  model.lines[1] = graded_lines(model.clamp_edge, model.second_edge,
                                static_cast<int>(n.elements_y()), size.along, kinks[1]);
  // A clamped strip is rigid: one row of elements, for the positions of its particles. On a bed it
  // bends and shears.
  const bool bends = model.effects.anchor_compliance > 0 && n.elements_y() == 0;
  const auto strip = [&](double from, double to) {
    return graded_lines(from, to, bends ? 0 : 1, size.along, kinks[1]);
  };
  std::vector<double>& ys = model.lines[1];
  if (model.clamp_edge > min.y() + kSameLine) {
    const std::vector<double> rows = strip(min.y(), model.clamp_edge);
    ys.insert(ys.begin(), rows.begin(), rows.end() - 1);
  }
  if (model.second_edge < max.y() - kSameLine) {
    const std::vector<double> rows = strip(model.second_edge, max.y());
    ys.insert(ys.end(), rows.begin() + 1, rows.end());
  }
  int layers = n.elements_z() > 0 ? static_cast<int>(n.elements_z()) : size.layers;
  if (mesh_of != nullptr) {
    model.lines = mesh_of->lines;
    layers = mesh_of->cells(2);
  }
  const double half = 0.5 * model.body.thickness;
  model.lines[2] = !bears_singularity ? even_lines(-half, half, layers)
                   : soft             ? crowded_layers(half, layers, size.along / thickness)
                                      : sine_layers(half, layers);
  for (const double y : model.lines[1]) {
    for (const double x : model.lines[0]) {
      const double h =
          model.body.thickness_map.at({x, y, 0}) * model.effects.thickness_at({x, y, 0});
      for (const double z : model.lines[2]) {
        const bool flat = tissue.flat_lower_face();
        model.nodes.emplace_back(x, y, flat ? h * (z + half) - half : h * z);
      }
    }
  }
  model.unknown.assign(model.nodes.size(), 0);
  for (std::size_t i = 0; i < model.nodes.size(); ++i) {
    const double y = model.nodes[i].y();
    const bool second = model.body.two_clamps && y >= model.second_edge - kSameLine;
    if (second || (clamped && y <= model.clamp_edge + kSameLine)) model.unknown[i] = -1;
  }
  release_anchors(model);
}

void make_elements(double density, ReferenceTissueModel& model) {
  model.mass.assign(model.nodes.size(), 0);
  model.node_area.assign(model.nodes.size(), 0);
  const int nz = model.cells(2);
  std::vector<double>& area = model.face_area;
  area.assign(model.nodes.size(), 0);
  for (int iy = 0; iy < model.cells(1); ++iy) {
    for (int ix = 0; ix < model.cells(0); ++ix) {
      for (int iz = 0; iz < nz; ++iz) {
        ReferenceElement element;
        for (int a = 0; a < 8; ++a)
          element.node[a] = model.node_index(ix + (a & 1), iy + ((a >> 1) & 1), iz + (a >> 2));
        element.size = {model.lines[0][ix + 1] - model.lines[0][ix],
                        model.lines[1][iy + 1] - model.lines[1][iy],
                        model.lines[2][iz + 1] - model.lines[2][iz]};
        const Vector3d centre = 0.5 * (model.nodes[element.node[7]] + model.nodes[element.node[0]]);
        const double thick =
            model.body.thickness_map.at(centre) * model.effects.thickness_at(centre);
        const double mass = density * thick * element.size.prod() / 8;
        for (const int node : element.node) {
          model.mass[node] += mass;
          model.node_area[node] += 0.125 / nz * element.size.x() * element.size.y();
        }
        for (int a = 0; a < 8; ++a) {
          const bool lower = iz == 0 && a < 4;
          const bool upper = iz == nz - 1 && a >= 4;
          if (lower || upper) area[element.node[a]] += 0.25 * element.size.x() * element.size.y();
        }
        model.elements.push_back(element);
      }
    }
  }
  if (const EffectValues& v = model.effects; v.added_mass > 0) {
    model.added_mass =
        disc_shares(model.nodes, model.node_area, {v.added_x, v.added_y}, v.added_radius);
    for (std::size_t i = 0; i < model.mass.size(); ++i)
      model.mass[i] += model.added_mass[i] *= v.added_mass;
  }
  for (const double m : model.mass) model.total_mass += m;
  for (int i = 0; i < static_cast<int>(area.size()); ++i) {
    if (area[i] > 0 && model.unknown[i] >= 0) model.face_nodes.push_back({i, area[i]});
  }
}

/// Stiffness at the Gauss points, where it is not the same everywhere.
void make_stiffness(ReferenceTissueModel& model) {
  if (!model.effects.has_inclusion()) return;
  model.stiffness.resize(model.batches());
  for (std::size_t batch = 0; batch < model.stiffness.size(); ++batch) {
    for (int lane = 0; lane < Pack::kLanes; ++lane) {
      const ReferenceElement& element =
          model.elements[std::min(Pack::kLanes * batch + lane, model.elements.size() - 1)];
      for (int point = 0; point < kHexPoints; ++point) {
        model.stiffness[batch][point].set_lane(
            lane, model.effects.stiffness_at(model.gauss_point(element, point)));
      }
    }
  }
}

/// Refuses what the machine has no room for: the matrix and its factor are the largest part by far.
/// Their places are numbers of 31 bits besides.
void check_memory(const ReferenceTissueModel& model) {
  constexpr double kEntry = 2 * sizeof(double);
  const double needed = kEntry * static_cast<double>(model.order.entries);
  const double allowed = std::min(machine_memory(), kEntry * std::numeric_limits<int>::max());
  if (needed <= allowed) return;
  throw_error(
      "scene.tissue.reference: {} x {} x {} elements need {:.3g} GB of memory, allowed {:.3g} GB",
      model.cells(0), model.free_cells_y(), model.cells(2), needed / 1e9, allowed / 1e9);
}

/// Numbers the unknowns in the order of elimination, nodes above one another together.
void number_unknowns(ReferenceTissueModel& model) {
  const std::size_t nz = model.lines[2].size();
  std::vector<int> count(model.nodes.size() / nz, 0);
  for (std::size_t i = 0; i < model.nodes.size(); ++i) {
    if (model.unknown[i] >= 0) count[i / nz] += 3;
  }
  model.order = dissect(static_cast<int>(model.lines[0].size()),
                        static_cast<int>(model.lines[1].size()), count);
  check_memory(model);
  model.unknowns = model.order.size;
  std::vector<int> next = model.order.first_unknown;
  for (std::size_t i = 0; i < model.nodes.size(); ++i) {
    if (model.unknown[i] < 0) continue;
    model.unknown[i] = next[i / nz];
    next[i / nz] += 3;
  }
}

/// Entry (i, k) of the block of nodes a and b.
BlockPlace place_block(const ReferenceTissueModel& model, int a, int b) {
  const int row = model.unknown[a];
  const int column = model.unknown[b];
  if (row < 0 || column < 0) return {};
  if (row < column) {  // the matrix is symmetric: only the lower triangle is stored
    const BlockPlace mirrored = place_block(model, b, a);
    return {mirrored.at, mirrored.across, mirrored.down};
  }
  return {static_cast<int>(model.order.index(row, column)), 1, model.order.stride(column)};
}

void place_blocks(ReferenceTissueModel& model) {
  for (int i = 0; i < static_cast<int>(model.nodes.size()); ++i)
    model.node_blocks.push_back(place_block(model, i, i));
  for (const ReferenceElement& element : model.elements) {
    auto place = model.element_blocks.emplace_back().begin();
    for (int a = 0; a < kHexNodes; ++a) {
      for (int b = 0; b <= a; ++b) *place++ = place_block(model, element.node[a], element.node[b]);
    }
  }
  for (const BedPoint& point : model.bed) {
    auto place = model.bed_blocks.emplace_back().begin();
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b <= a; ++b) *place++ = place_block(model, point.node[a], point.node[b]);
    }
  }
}

/// The point of a face above or below p, at the height z_B of the sheet's own thickness: a changed
/// bending gives the mesh another one, so that it may lie inside the mesh or a little outside.
BodyPoint face_point(const ReferenceTissueModel& model, const Vector3d& p, double z) {
  const std::vector<double>& lines = model.lines[2];
  const double inside = std::clamp(z, lines.front(), lines.back());
  BodyPoint point = model.locate({p.x(), p.y(), inside});
  const double cell = z > 0 ? lines.back() - lines[lines.size() - 2] : lines[1] - lines.front();
  for (BodyPoint::Location& at : point.locations) at.xi.z() += 2 * (z - inside) / cell;
  return point;
}

}  // namespace

std::unique_ptr<Tissue<float>> ReferenceTissueModel::make_tissue(const LaneKernel<float>&) const {
  throw_error(
      "scene.tissue.model: TISSUE_REFERENCE runs in double precision, one environment, for "
      "mismatch only; allowed here: TISSUE_CLUSTER, TISSUE_ELASTIC");
}

std::unique_ptr<Tissue<double>> ReferenceTissueModel::make_tissue(
    const LaneKernel<double>& kernel) const {
  if (kernel.lanes != 1)
    throw_error("scene.tissue.model: TISSUE_REFERENCE runs one environment, not {}", kernel.lanes);
  return std::make_unique<ReferenceTissue>(shared_from_this());
}

std::shared_ptr<const ReferenceTissueModel> make_reference_model(
    const Scene& scene, double control_period, std::vector<std::string>& warnings,
    std::span<const PinchCircle> pinches, const ReferenceTissueModel* mesh_of) {
  const pb::Tissue& config = scene.config.tissue();
  if (!scene.tissue.surface_is_particles || config.has_sheet())
    throw_error("scene.tissue: TISSUE_REFERENCE takes a rectangular sheet, give grid");
  if (config.material().law() == pb::LAW_STABLE_NEO_HOOKE) {
    throw_error(
        "scene.tissue.material.law: LAW_STABLE_NEO_HOOKE, allowed for TISSUE_REFERENCE: "
        "LAW_COROTATED, LAW_NEO_HOOKE, LAW_ST_VENANT_KIRCHHOFF");
  }
  auto model = std::make_shared<ReferenceTissueModel>();
  model->body = scene.tissue;
  model->control_period = control_period;
  model->numerics = config.reference();
  model->material = config.material();
  model->effects =
      make_effects(config.effects(), config.material().poisson_ratio(), model->body.particles);
  if ((model->effects.adhesion > 0 || model->effects.suction > 0) && scene.bodies.empty()) {
    throw_error("scene.tissue.effects.{}: nothing to stick to, needs a scene.rigid_body",
                model->effects.adhesion > 0 ? "adhesion" : "suction");
  }
  const double thicker = std::sqrt(1 + model->effects.bending_change);
  model->body.thickness = scene.tissue.thickness * thicker;
  model->face_inset = 0.5 * (model->body.thickness - scene.tissue.thickness);
  model->lame = make_lame(config.material().young_modulus_pa() / thicker,
                          config.material().poisson_ratio() + model->effects.poisson_change);
  model->surroundings = make_surroundings(scene);
  make_lines(scene, pinches, mesh_of, *model);
  make_elements(config.density_kg_per_m3() * (1 + model->effects.density_change) / thicker, *model);
  make_rest(*model);
  make_stiffness(*model);
  number_unknowns(*model);
  place_blocks(*model);
  for (std::size_t i = 0; i < model->body.particles.size(); ++i) {
    model->particle_points.push_back(model->locate(model->body.particles[i]));
    model->particle_points.back().fixed = model->body.fixed[i] != 0;
    const Vector3d& p = model->body.particles[i];
    model->upper_points.push_back(face_point(*model, p, 0.5 * scene.tissue.thickness));
    model->lower_points.push_back(face_point(*model, p, -0.5 * scene.tissue.thickness));
  }
  const double lift = model->body.particle_radius - 0.5 * scene.tissue.thickness;
  if (!model->surroundings.bodies.empty() && std::fabs(lift) > 1e-6) {  // [m]
    warnings.push_back(fmt::format(
        "tissue.particle_radius_m: {} m does not apply to TISSUE_REFERENCE, whose faces "
        "lie thickness_m / 2 = {} m from the particles",
        model->body.particle_radius, 0.5 * scene.tissue.thickness));
  }
  return model;
}

}  // namespace omentum
