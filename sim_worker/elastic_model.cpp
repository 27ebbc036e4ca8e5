#include "sim_worker/elastic_model.h"

#include <Eigen/SparseCore>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "core/trig.h"
#include "sim_worker/elastic_tissue.h"
#include "sim_worker/grasp_patch.h"

namespace omentum {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kKeyRatio = 1.25;  // E/E0 in (0.8, 1]: settles and follows (tissue.md section 8)
constexpr int kDensityKeys = 1024;  // key = kDensityKeys x key of density + key of stiffness

struct KeyParts {
  int stiffness = 0, density = 0;
};

KeyParts split_key(int key) {
  KeyParts parts;
  for (; key > kDensityKeys / 2; key -= kDensityKeys) ++parts.density;
  for (; key < -kDensityKeys / 2; key += kDensityKeys) --parts.density;
  parts.stiffness = key;
  return parts;
}

double grid_value(int steps) {
  double value = 1;
  for (int k = 0; k < steps; ++k) value *= kKeyRatio;
  for (int k = 0; k > steps; --k) value /= kKeyRatio;
  return value;
}

double thickness_ratio(const ElasticTissueModel& model, const EffectValues& effects,
                       const Vector3d& p_B) {
  return model.body.thickness_map.at(p_B) * effects.thickness_at(p_B);
}

bool is_clamped(const ElasticTissueModel& model, int i) {
  const auto k = static_cast<std::size_t>(i);
  return model.body.fixed[k] != 0 || (!model.is_anchor.empty() && model.is_anchor[k] != 0);
}

/// E t^3 / 12 at a place of the sheet [N m].
double beam_at(const ElasticTissueModel& model, const EffectValues& effects, const Vector3d& p_B) {
  const double t = model.thickness * thickness_ratio(model, effects, p_B);
  return model.material.bending_scale() * (1 + effects.bending_change) * effects.stiffness_at(p_B) *
         model.material.young_modulus_pa() * t * t * t / 12;
}

/// Calls fn(x-leg tail, x-leg head, y-leg tail, y-leg head) for the two triangles of every cell, in
/// the order of elastic_kernel.inl.
template <typename Function>
void for_each_triangle(const ElasticTissueModel& model, Function&& fn) {
  for (int ix = 0; ix + 1 < model.count_x; ++ix) {
    for (int iy = 0; iy + 1 < model.count_y; ++iy) {
      const int a = model.count_y * ix + iy;
      const int b = a + model.count_y;
      const int c = b + 1;
      const int e = a + 1;
      if ((ix + iy) % 2 == 0) {
        fn(a, b, b, c);
        fn(e, c, a, e);
      } else {
        fn(a, b, a, e);
        fn(e, c, b, c);
      }
    }
  }
}

/// Triangles that share a factor of ElasticStructure::cell.
std::size_t cell_of(const ElasticTissueModel& model, std::size_t triangle) {
  return model.is_mesh() ? triangle : triangle / 2;
}

double triangle_area(const ElasticTissueModel& model, std::size_t triangle) {
  return model.is_mesh() ? model.mesh.triangles[triangle].area : 0.5 * model.pitch * model.pitch;
}

/// Adds a third of `of_triangle` for every triangle to each of its corners.
template <typename Function>
std::vector<double> lump(const ElasticTissueModel& model, Function&& of_triangle) {
  std::vector<double> sum(static_cast<std::size_t>(model.nodes()), 0.0);
  std::size_t next = 0;
  const auto add = [&](int a, int b, int c) {
    const double third = of_triangle(next++) / 3;
    for (const int i : {a, b, c}) sum[static_cast<std::size_t>(i)] += third;
  };
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    // The legs share the corner of the right angle: three of the four indices are different.
    add(x0, x1, y0 == x0 || y0 == x1 ? y1 : y0);
  });
  for (const SheetTriangle& t : model.mesh.triangles) add(t.node[0], t.node[1], t.node[2]);
  return sum;
}

/// Largest stiffness of a triangle against a change of F, per nominal stretch stiffness: 2 mu + 2
/// lambda = E / (1 - nu) for the area mode; the metric must not be softer than the material.
double metric_modulus(const ElasticStructure& structure) {
  return structure.shear + 2 * structure.area;
}

/// E t / 2: stiffness of one fibre direction per ratio [N/m].
double fibre_unit(const ElasticTissueModel& model) {
  return model.material.young_modulus_pa() * model.thickness / 2;
}

/// d F / d x_i of the three corners, times the pitch.
using ShapeGradients = std::array<Eigen::Vector2d, 3>;

ShapeGradients shape_gradients(const SheetTriangle& triangle, double pitch) {
  const Eigen::Vector2d one = pitch * triangle.inverse.row(0).transpose();
  const Eigen::Vector2d two = pitch * triangle.inverse.row(1).transpose();
  return {-(one + two), one, two};
}

using SparseMatrix = Eigen::SparseMatrix<double>;

/// A on the free nodes; `free_index` is -1 for fixed nodes.
SparseMatrix assemble(const ElasticTissueModel& model, double stiffness, double density,
                      const std::vector<int>& free_index, int free_count) {
  const ElasticStructure& structure = model.structure;
  std::vector<Eigen::Triplet<double>> entries;
  const auto add = [&](int i, int j, double value) {
    const int row = free_index[static_cast<std::size_t>(i)];
    const int column = free_index[static_cast<std::size_t>(j)];
    if (row >= 0 && column >= 0) entries.emplace_back(row, column, value);
  };
  const double inverse_step2 = 1 / (model.effective_step() * model.effective_step());
  for (int i = 0; i < model.nodes(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    add(i, i, density * structure.mass[k] * inverse_step2 + stiffness * model.anchor[k]);
    for (int m = structure.bending.begin[k]; m < structure.bending.begin[k + 1]; ++m) {
      const double value = stiffness * structure.bending.value[static_cast<std::size_t>(m)];
      add(i, structure.bending.node[static_cast<std::size_t>(m)], value);
      add(i, i, -value);
    }
  }
  const auto add_leg = [&](int i, int j, double leg) {
    add(i, i, leg);
    add(j, j, leg);
    add(i, j, -leg);
    add(j, i, -leg);
  };
  // Fibres along a: |a_x f_x + a_y f_y|^2 <= (a_x^2 + |a_x a_y|) |f_x|^2 + ...
  const trig::SinCos a = trig::sin_cos(model.effects.fibre_angle);
  const double fibre = model.effects.fibre_ratio * fibre_unit(model);
  const double both = std::fabs(a.sin * a.cos);
  const double along_x = metric_modulus(structure) + fibre * (a.cos * a.cos + both);
  const double along_y = metric_modulus(structure) + fibre * (a.sin * a.sin + both);
  int triangle = 0;
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    const double cell = stiffness * structure.cell[static_cast<std::size_t>(triangle++ / 2)];
    add_leg(x0, x1, cell * along_x);
    add_leg(y0, y1, cell * along_y);
  });
  for (std::size_t t = 0; t < model.mesh.triangles.size(); ++t) {
    const SheetTriangle& of_mesh = model.mesh.triangles[t];
    const double cell = stiffness * structure.cell[t];
    const ShapeGradients g = shape_gradients(of_mesh, model.pitch);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        add(of_mesh.node[i], of_mesh.node[j],
            cell * (along_x * g[i].x() * g[j].x() + along_y * g[i].y() * g[j].y()));
      }
    }
  }
  SparseMatrix matrix(free_count, free_count);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

/// Spring of a clamped node that carries `length` of the clamp [N/m]: its compliance, or, where a
/// part of its width is detached, E t where that part is one half.
double anchor_spring(const EffectValues& values, double membrane_stiffness, double x, double width,
                     double length) {
  const double detached = detached_share(values, x, 0.5 * width);
  if (values.anchor_compliance > 0) return (1 - detached) * length / values.anchor_compliance;
  return detached > 0 ? membrane_stiffness * (1 - detached) / detached : 0;
}

/// Stiffness of the step with memory over that without: Prony branches, slider, and the steepest
/// unloading of softened material.
double memory_tangent(const EffectValues& effects, double step) {
  return (1 + 3 * effects.softening) * (1 + make_prony(effects, step).gains) + effects.slider_ratio;
}

/// Rows of A: -1 for fixed nodes, and the node of each row.
struct FreeNodes {
  explicit FreeNodes(const ElasticTissueModel& model) {
    for (int i = 0; i < model.nodes(); ++i) {
      const bool fixed = model.body.fixed[static_cast<std::size_t>(i)] != 0;
      row.push_back(fixed ? -1 : count());
      if (!fixed) node.push_back(i);
    }
  }
  int count() const { return static_cast<int>(node.size()); }
  std::vector<int> row, node;
};

PanelFactor make_factor(const ElasticTissueModel& model, double stiffness, double density) {
  const FreeNodes free(model);
  const SparseMatrix matrix = assemble(model, stiffness, density, free.row, free.count());
  return factorize(matrix, free.node);
}

void make_metric(ElasticTissueModel& model) {
  const FreeNodes free(model);
  const SparseMatrix matrix =
      assemble(model, memory_tangent(model.effects, model.substep()), 1, free.row, free.count());
  const double inverse_step2 = 1 / (model.effective_step() * model.effective_step());
  const auto entry = [&](int i, int j) {
    const int row = free.row[static_cast<std::size_t>(i)];
    const int column = free.row[static_cast<std::size_t>(j)];
    return row < 0 || column < 0 ? 0.0 : matrix.coeff(row, column);
  };
  for (int i = 0; i < model.nodes(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    model.metric_diagonal.push_back(
        free.row[k] < 0 ? 0.0 : entry(i, i) - model.structure.mass[k] * inverse_step2);
    const NodeMatrix& bending = model.structure.bending;
    for (int m = bending.begin[k]; m < bending.begin[k + 1]; ++m) {
      model.metric.push_back(entry(i, bending.node[static_cast<std::size_t>(m)]));
    }
  }
}

}  // namespace

double ElasticTissueModel::effective_step() const {
  return parameters.integrator() == pb::INTEGRATOR_BDF2 ? 2 * substep() / 3 : substep();
}

int ElasticTissueModel::factor_key(double stiffness_scale) {
  // 1e-9: a scale that lies on the grid belongs to its own step whatever its rounding.
  int key = 0;
  double step = 1;
  while (step < stiffness_scale * (1 - 1e-9)) {
    step *= kKeyRatio;
    ++key;
  }
  while (step / kKeyRatio >= stiffness_scale * (1 - 1e-9)) {
    step /= kKeyRatio;
    --key;
  }
  return key;
}

int ElasticTissueModel::factor_key(double stiffness_scale, const EffectValues& lane,
                                   const ElasticStructure& lane_structure, double peak) const {
  // An effect may exceed the factor a little, as the step allows (up to 1.25): a small one then
  // changes the solution smoothly, without a jump to another factor.
  constexpr double kSlack = 1.12;
  double tangent = memory_tangent(lane, substep()) / memory_tangent(effects, substep());
  // In steps: a new factor now and then, not in every step. Steps of two showed as jumps of 0.09 mm
  // in a lift in motion.
  double level = 1;
  while (level * kSlack < peak && level < 4096) level *= kKeyRatio;
  tangent *= level;
  if (lane.fibre_ratio != effects.fibre_ratio || lane.fibre_angle != effects.fibre_angle) {
    tangent += lane.fibre_ratio;
  }
  double ratio = 1;
  if (!lane.same_structure(effects)) {
    const double modulus = metric_modulus(lane_structure) / metric_modulus(structure);
    for (std::size_t c = 0; c < structure.cell.size(); ++c) {
      ratio = std::max(ratio, modulus * lane_structure.cell[c] / structure.cell[c]);
    }
    for (std::size_t i = 0; i + 1 < structure.bending.begin.size(); ++i) {
      double own = 0;
      double base = 0;
      for (int m = structure.bending.begin[i]; m < structure.bending.begin[i + 1]; ++m) {
        own += std::fabs(lane_structure.bending.value[static_cast<std::size_t>(m)]);
        base += std::fabs(structure.bending.value[static_cast<std::size_t>(m)]);
      }
      if (base > 0) ratio = std::max(ratio, own / base);
    }
  }
  const double stretch = 1 / ((1 + lane.stretch) * (1 + lane.stretch));
  ratio *= std::max(1.0, stretch);
  if (lane.anchor_compliance > 0 && effects.anchor_compliance > 0) {
    ratio = std::max(ratio, effects.anchor_compliance / lane.anchor_compliance);
  }
  const double heavier = (1 + lane.density_change) / (1 + effects.density_change);
  const double thicker =
      lane.same_structure(effects)
          ? 1.0
          : *std::max_element(lane_structure.mass.begin(), lane_structure.mass.end()) /
                *std::max_element(structure.mass.begin(), structure.mass.end());
  const auto slack_key = [](double scale) {
    return scale > 1 / kSlack && scale < kSlack ? 0 : factor_key(std::max(1e-3, scale));
  };
  return kDensityKeys * slack_key(heavier * std::max(1.0, thicker)) +
         factor_key(stiffness_scale * std::max(1.0, tangent * ratio / kSlack));
}

double ElasticTissueModel::key_stiffness(int key) { return grid_value(split_key(key).stiffness); }

double ElasticTissueModel::key_density(int key) const {
  return (1 + effects.density_change) * grid_value(split_key(key).density);
}

std::shared_ptr<const PanelFactor> ElasticTissueModel::factor(int key) const {
  const std::lock_guard lock(mutex_);
  auto& factor = factors_[key];
  if (factor == nullptr) {
    const double stiffness = key_stiffness(key) * memory_tangent(effects, substep());
    factor = std::make_shared<const PanelFactor>(make_factor(*this, stiffness, key_density(key)));
  }
  return factor;
}

std::shared_ptr<const ElasticTissueModel> make_elastic_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>&) {
  const pb::Tissue& tissue = scene.config.tissue();
  if (tissue.material().law() != pb::LAW_COROTATED) {
    throw_error("scene.tissue.material.law: {}, allowed for the model elastic: LAW_COROTATED",
                pb::ElasticLaw_Name(tissue.material().law()));
  }
  if (!tissue.has_grid() && scene.sheet.triangles.empty()) {
    throw_error("scene.tissue: no grid, allowed for the shell of the model elastic: grid, sheet");
  }
  const int most_bodies = kMaxShapes - (scene.soft_body ? 2 : 1);
  if (static_cast<int>(scene.bodies.size()) > most_bodies) {
    throw_error("scene.rigid_body: {} bodies, allowed at most {}", scene.bodies.size(),
                most_bodies);
  }
  auto model = std::make_shared<ElasticTissueModel>();
  model->on_soft_body = scene.soft_body.has_value();
  model->body = scene.tissue;
  model->control_period = control_period;
  model->material = tissue.material();
  model->parameters = tissue.elastic();
  model->mesh = scene.sheet;
  if (model->is_mesh()) {
    model->pitch = model->mesh.edge;
  } else {
    model->count_x = static_cast<int>(tissue.grid().count_x());
    model->count_y = static_cast<int>(tissue.grid().count_y());
    model->pitch = tissue.grid().pitch_m();
    OMENTUM_CHECK(model->nodes() == model->count_x * model->count_y);
  }
  model->gravity = scene.gravity;
  model->static_friction = tissue.static_friction();
  model->dynamic_friction = tissue.dynamic_friction();
  model->contact_bodies = scene.bodies;
  const pb::Tool& tool = scene.config.tool();
  model->tool_contact = tool.contact();
  model->tool_radius = tool.shaft_radius_m();
  model->tool_start = tool.shaft_start_m() + tool.shaft_radius_m();
  model->tool_length = tool.shaft_length_m();
  model->thickness = model->body.thickness;
  model->density = tissue.density_kg_per_m3();
  model->effects =
      make_effects(tissue.effects(), tissue.material().poisson_ratio(), model->body.particles);
  if ((model->effects.adhesion > 0 || model->effects.suction > 0) &&
      model->contact_bodies.empty()) {
    throw_error("scene.tissue.effects.{}: nothing to stick to, needs a scene.rigid_body",
                model->effects.adhesion > 0 ? "adhesion" : "suction");
  }
  const IsClamped clamped = [&](std::int32_t i) { return is_clamped(*model, i); };
  const std::vector<Vector3d>& nodes = model->body.particles;
  model->stencils = model->is_mesh() ? mesh_stencils(model->mesh, nodes, clamped)
                                     : grid_stencils(nodes, model->count_x, model->count_y,
                                                     model->pitch, clamped);
  model->clamp_edge = model->sheet().min().y();
  for (std::size_t i = 0; i < model->body.particles.size(); ++i) {
    if (model->body.fixed[i] != 0)
      model->clamp_edge = std::max(model->clamp_edge, model->body.particles[i].y());
  }
  model->structure = model->make_structure(model->effects);
  model->node_area = lump(*model, [&](std::size_t t) { return triangle_area(*model, t); });
  model->anchor = model->make_anchor(model->effects);
  model->is_anchor.assign(model->anchor.size(), 0);
  for (int i = 0; model->effects.moves_anchor() && i < model->nodes(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    const bool rigid =
        model->effects.anchor_compliance == 0 &&
        detached_share(model->effects, model->body.particles[k].x(), 0.5 * model->pitch) == 0;
    if (model->body.fixed[k] == 0 || rigid) continue;
    model->body.fixed[k] = 0;
    model->is_anchor[k] = 1;
  }
  if (std::all_of(model->body.fixed.begin(), model->body.fixed.end(),
                  [](std::uint8_t fixed) { return fixed == 0; }) &&
      std::all_of(model->anchor.begin(), model->anchor.end(), [](double k) { return k == 0; })) {
    const bool was_free = std::all_of(scene.tissue.fixed.begin(), scene.tissue.fixed.end(),
                                      [](std::uint8_t fixed) { return fixed == 0; });
    if (!was_free) {
      throw_error("scene.tissue.effects.anchor: {} ... {} m detaches the whole clamp, allowed less",
                  model->effects.anchor_free_from, model->effects.anchor_free_to);
    }
  }
  make_metric(*model);
  return model;
}

bool ElasticTissueModel::can_hold(const Vector3d& centre, double radius) const {
  // 1e-5 m: with less the sphere of the jaws only grazes the sheet. 1 m: no sheet is larger.
  if (!(radius > 1e-5 && radius <= 1)) return false;
  if (is_mesh()) return radius > 0.05 * mesh.edge && (centre.cwiseAbs().array() <= 1).all();
  return sheet().contains(centre.head<2>()) && centre.y() > clamp_edge && centre.z() == 0;
}

Eigen::AlignedBox2d ElasticTissueModel::sheet() const {
  return {body.particles.front().head<2>(), body.particles.back().head<2>()};
}

ElasticTissueModel::Shares ElasticTissueModel::locate(const Vector2d& X) const {
  const Vector2d from = (X - body.particles.front().head<2>()) / pitch;
  const int ix = std::clamp(static_cast<int>(from.x()), 0, count_x - 2);
  const int iy = std::clamp(static_cast<int>(from.y()), 0, count_y - 2);
  const double u = from.x() - ix;
  const double v = from.y() - iy;
  const int i = count_y * ix + iy;
  return {{i, i + 1, i + count_y, i + count_y + 1},
          {(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v}};
}

SheetPatch ElasticTissueModel::make_patch(const Vector3d& centre, double radius) const {
  std::map<std::int32_t, Vector3d> rows;  // by node, so that the order is that of the nodes
  const auto add = [&](const auto& node, const auto& share, double weight, const Vector2d& arm) {
    for (std::size_t k = 0; k < node.size(); ++k) {
      rows.try_emplace(node[k], Vector3d::Zero()).first->second +=
          weight * share[k] * Vector3d(1, arm.x(), arm.y());
    }
  };
  if (is_mesh()) {
    for (const DiscPoint& point : sample_disc(mesh, body.particles, body.fixed, centre, radius))
      add(mesh.triangles[point.triangle].node, point.share, point.weight, point.arm);
  } else {
    const Eigen::AlignedBox2d free(Vector2d(sheet().min().x(), clamp_edge), sheet().max());
    const std::vector<PatchPoint> points = patch_points(free, centre.head<2>(), radius);
    Vector2d mean = Vector2d::Zero();
    for (const PatchPoint& point : points) mean += point.weight * point.p;
    for (const PatchPoint& point : points) {
      const Shares shares = locate(point.p);
      add(shares.node, shares.weight, point.weight, (point.p - mean) / radius);
    }
  }
  if (rows.empty()) return {};
  SheetPatch patch;
  patch.weight.resize(static_cast<Eigen::Index>(rows.size()), kPatchRows);
  for (const auto& [node, row] : rows) {
    patch.weight.row(static_cast<Eigen::Index>(patch.node.size())) = row.transpose();
    patch.node.push_back(node);
  }
  for (int r = 1; r < kPatchRows; ++r)
    patch.weight.col(r) /= patch.weight.col(r).cwiseAbs().maxCoeff();
  std::int32_t nearest = -1;
  double least = 0;
  for (std::int32_t i = 0; i < nodes(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    if (body.fixed[k] != 0) continue;
    const double distance = (body.particles[k] - centre).norm();
    if (distance <= radius) patch.inside.push_back(i);
    if (nearest < 0 || distance < least) {
      nearest = i;
      least = distance;
    }
  }
  if (patch.inside.empty()) patch.inside.push_back(nearest);
  return patch;
}

ElasticStructure ElasticTissueModel::make_structure(const EffectValues& values) const {
  ElasticStructure made;
  const double e = material.young_modulus_pa();
  const double nu = material.poisson_ratio() + values.poisson_change;
  // t a_T / pitch^2 = t / 2; mu and lambda of plane stress.
  made.shear = e / (1 + nu) * thickness / 2;
  made.area = e * nu / (1 - nu * nu) * thickness / 2;
  std::vector<double> thick;
  const auto add_cell = [&](const Vector3d& centre, double size) {
    thick.push_back(thickness_ratio(*this, values, centre));
    made.cell.push_back(thick.back() * values.stiffness_at(centre) * size);
    made.uniform = made.uniform && made.cell.back() == 1;
  };
  for (int ix = 0; ix + 1 < count_x; ++ix) {
    for (int iy = 0; iy + 1 < count_y; ++iy) {
      const auto low = static_cast<std::size_t>(count_y * ix + iy);
      const auto high = low + static_cast<std::size_t>(count_y) + 1;
      add_cell(0.5 * (body.particles[low] + body.particles[high]), 1);
    }
  }
  for (const SheetTriangle& triangle : mesh.triangles) {
    Vector3d centre = Vector3d::Zero();
    for (const std::int32_t i : triangle.node)
      centre += body.particles[static_cast<std::size_t>(i)] / 3;
    add_cell(centre, 2 * triangle.area / (pitch * pitch));
  }
  const double of_cell = density * thickness * 0.5 * pitch * pitch;
  made.mass = lump(*this, [&](std::size_t t) {
    const double mass = is_mesh() ? density * thickness * mesh.triangles[t].area : of_cell;
    return mass * thick[cell_of(*this, t)];
  });
  for (const PlateStencil& stencil : stencils) {
    made.plate.push_back(plate_stiffness(stencil, stencil.share.cwiseProduct(stencil.clamp),
                                         beam_at(*this, values, stencil.place), nu));
  }
  made.bending = plate_matrix(nodes(), stencils, made.plate);
  return made;
}

bool ElasticTissueModel::is_curved() const {
  // 1e-4: rounding in the vertices of a flat sheet.
  return std::any_of(stencils.begin(), stencils.end(), [this](const PlateStencil& stencil) {
    return stencil.rest.norm() * pitch > 1e-4;
  });
}

double ElasticTissueModel::node_size(int i) const {
  return is_mesh() ? std::sqrt(node_area[static_cast<std::size_t>(i)]) : pitch;
}

std::vector<Vector3d> ElasticTissueModel::make_rest_moments(const EffectValues& values) const {
  std::vector<Vector3d> moments;
  const double nu = material.poisson_ratio() + values.poisson_change;
  const Vector3d wanted(values.curvature_x, values.curvature_y, values.twist);
  for (const PlateStencil& stencil : stencils) {
    // The clamp holds the rest shape, so on its edge half of the change of curvature is seen; the
    // effect's curvature ends there, so half of it is.
    const double beam = beam_at(*this, values, stencil.place);
    const auto moment = [&](const Eigen::Vector4d& share, const Vector3d& of) {
      return plate_moments(plate_stiffness(stencil, share, beam, nu), of);
    };
    moments.emplace_back(moment(stencil.share.cwiseProduct(stencil.clamp), stencil.rest) +
                         moment(stencil.share, wanted));
  }
  return moments;
}

std::vector<double> ElasticTissueModel::make_anchor(const EffectValues& values) const {
  std::vector<double> spring(static_cast<std::size_t>(nodes()), 0.0);
  if (!values.moves_anchor()) return spring;
  if (is_mesh()) {
    // A node carries the share of the clamp's length, its extent along x_B, that it has of the
    // clamp's area.
    double area = 0;
    double low = 1e9;
    double high = -1e9;
    for (int i = 0; i < nodes(); ++i) {
      if (!is_clamped(*this, i)) continue;
      const auto k = static_cast<std::size_t>(i);
      area += node_area[k];
      low = std::min(low, body.particles[k].x());
      high = std::max(high, body.particles[k].x());
    }
    for (int i = 0; i < nodes(); ++i) {
      if (!is_clamped(*this, i)) continue;
      const auto k = static_cast<std::size_t>(i);
      spring[k] = anchor_spring(values, membrane_stiffness(), body.particles[k].x(), node_size(i),
                                (high - low) * node_area[k] / area);
    }
    return spring;
  }
  for (int ix = 0; ix < count_x; ++ix) {
    int rows = 0;
    const auto clamped = [&](int iy) { return is_clamped(*this, count_y * ix + iy); };
    for (int iy = 0; iy < count_y; ++iy) rows += clamped(iy) ? 1 : 0;
    for (int iy = 0; iy < count_y; ++iy) {
      if (!clamped(iy)) continue;
      const auto k = static_cast<std::size_t>(count_y * ix + iy);
      const double length = ix == 0 || ix + 1 == count_x ? 0.5 * pitch : pitch;
      spring[k] =
          anchor_spring(values, membrane_stiffness(), body.particles[k].x(), pitch, length / rows);
    }
  }
  return spring;
}

std::unique_ptr<Tissue<float>> ElasticTissueModel::make_tissue(const Kernel<float>& kernel) const {
  return std::make_unique<ElasticTissue<float>>(shared_from_this(), kernel);
}

std::unique_ptr<Tissue<double>> ElasticTissueModel::make_tissue(
    const Kernel<double>& kernel) const {
  return std::make_unique<ElasticTissue<double>>(shared_from_this(), kernel);
}

ElasticEnergy elastic_energy(const ElasticTissueModel& model, std::span<const Vector3d> p) {
  ElasticEnergy energy;
  // |F - R|^2 = tr C - 2 tr S + 2; shear and area carry t a_T / pitch^2.
  const auto add_membrane = [&](const Eigen::Matrix<double, 3, 2>& f, double cell) {
    const Eigen::Matrix2d c = f.transpose() * f;
    const double tau = std::sqrt(c.trace() + 2 * std::sqrt(c.determinant()));
    const double a = model.pitch * model.pitch * cell;
    energy.membrane += a * (0.5 * model.structure.shear * (c.trace() - 2 * tau + 2) +
                            0.5 * model.structure.area * (tau - 2) * (tau - 2));
  };
  const auto leg = [&](int from, int to) {
    return Vector3d(p[static_cast<std::size_t>(to)] - p[static_cast<std::size_t>(from)]);
  };
  Eigen::Matrix<double, 3, 2> f;
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    f << leg(x0, x1) / model.pitch, leg(y0, y1) / model.pitch;
    add_membrane(f, 1);
  });
  for (std::size_t t = 0; t < model.mesh.triangles.size(); ++t) {
    const SheetTriangle& triangle = model.mesh.triangles[t];
    f << leg(triangle.node[0], triangle.node[1]), leg(triangle.node[0], triangle.node[2]);
    add_membrane(f * triangle.inverse, model.structure.cell[t]);
  }
  const std::vector<Vector3d> rest = model.make_rest_moments(model.effects);
  for (std::size_t k = 0; k < model.stencils.size(); ++k) {
    const Vector3d bent = curvature(model.stencils[k].at, p);
    energy.bending += (0.5 * plate_moments(model.structure.plate[k], bent) - rest[k]).dot(bent);
  }
  return energy;
}

}  // namespace omentum
