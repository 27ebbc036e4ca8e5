#include "sim_worker/shell/shell_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "core/constants.h"
#include "sim_worker/scene/clamp_rows.h"
#include "sim_worker/shell/shell_tissue.h"
#include "sim_worker/tissue/effect_laws.h"
#include "sim_worker/tissue/grasp_patch.h"

namespace omentum {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

double thickness_ratio(const ShellTissueModel& model, const EffectValues& effects,
                       const Vector3d& p_B) {
  return model.body.thickness_map.at(p_B) * effects.thickness_at(p_B);
}

bool is_clamped(const ShellTissueModel& model, int i) {
  return model.body.fixed[i] != 0 || (!model.is_anchor.empty() && model.is_anchor[i] != 0);
}

/// E t^3 / 12 at a place of the sheet [N m].
double beam_at(const ShellTissueModel& model, const EffectValues& effects, const Vector3d& p_B) {
  const double t = model.thickness * thickness_ratio(model, effects, p_B);
  return model.material.bending_scale() * (1 + effects.bending_change) * effects.stiffness_at(p_B) *
         model.material.young_modulus_pa() * t * t * t / 12;
}

/// Triangles that share a factor of ShellStructure::cell.
std::size_t cell_of(const ShellTissueModel& model, std::size_t triangle) {
  return model.is_mesh() ? triangle : triangle / 2;
}

double triangle_area(const ShellTissueModel& model, std::size_t triangle) {
  return model.is_mesh() ? model.mesh.triangles[triangle].area : 0.5 * model.pitch * model.pitch;
}

/// Adds a third of `of_triangle` for every triangle to each of its corners.
template <typename Function>
std::vector<double> lump(const ShellTissueModel& model, Function&& of_triangle) {
  std::vector<double> sum(model.nodes(), 0.0);
  std::size_t next = 0;
  const auto add = [&](int a, int b, int c) {
    const double third = of_triangle(next++) / 3;
    for (const int i : {a, b, c}) sum[i] += third;
  };
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    // The legs share the corner of the right angle: three of the four indices are different.
    add(x0, x1, y0 == x0 || y0 == x1 ? y1 : y0);
  });
  for (const SheetTriangle& t : model.mesh.triangles) add(t.node[0], t.node[1], t.node[2]);
  return sum;
}

/// Rows of the clamped strip of a grid at this column of nodes, those next to its edge y_B = min.
int strip_rows(const ShellTissueModel& model, int ix) {
  int rows = 0;
  while (rows < model.count_y && is_clamped(model, model.count_y * ix + rows)) ++rows;
  return rows;
}

/// Width of the clamp that a column of nodes of a grid carries [m].
double carried_length(const ShellTissueModel& model, int ix) {
  return ix == 0 || ix + 1 == model.count_x ? 0.5 * model.pitch : model.pitch;
}

/// Spring of a clamped node that carries `length` of the clamp [N/m]: its compliance, or, where a
/// part of its width is detached, E t where that part is one half.
double anchor_spring(const EffectValues& values, double membrane_stiffness, double x, double width,
                     double length) {
  const double detached = detached_share(values, x, 0.5 * width);
  if (values.anchor_compliance > 0) return (1 - detached) * length / values.anchor_compliance;
  return detached > 0 ? membrane_stiffness * (1 - detached) / detached : 0;
}

}  // namespace

std::shared_ptr<const ShellTissueModel> make_shell_model(const Scene& scene, double control_period,
                                                         std::vector<std::string>&) {
  const pb::Tissue& tissue = scene.config.tissue();
  if (tissue.material().law() == pb::LAW_STABLE_NEO_HOOKE) {
    throw_error(
        "scene.tissue.material.law: LAW_STABLE_NEO_HOOKE, allowed for the shell of the model "
        "elastic: LAW_COROTATED, LAW_NEO_HOOKE, LAW_ST_VENANT_KIRCHHOFF");
  }
  if (!tissue.has_grid() && scene.sheet.triangles.empty()) {
    throw_error("scene.tissue: no grid, allowed for the shell of the model elastic: grid, sheet");
  }
  const int most_bodies = kMaxShapes - (scene.soft_body ? 2 : 1);
  if (static_cast<int>(scene.bodies.size()) > most_bodies) {
    throw_error("scene.rigid_body: {} bodies, allowed at most {}", scene.bodies.size(),
                most_bodies);
  }
  auto model = std::make_shared<ShellTissueModel>();
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
  model->surroundings = make_surroundings(scene);
  model->thickness = model->body.thickness;
  model->density = tissue.density_kg_per_m3();
  model->effects =
      make_effects(tissue.effects(), tissue.material().poisson_ratio(), model->body.particles);
  if ((model->effects.adhesion > 0 || model->effects.suction > 0) &&
      model->surroundings.bodies.empty()) {
    throw_error("scene.tissue.effects.{}: nothing to stick to, needs a scene.rigid_body",
                model->effects.adhesion > 0 ? "adhesion" : "suction");
  }
  const IsClamped clamped = [&](std::int32_t i) { return is_clamped(*model, i); };
  const std::vector<Vector3d>& nodes = model->body.particles;
  model->stencils = model->is_mesh() ? mesh_stencils(model->mesh, nodes, clamped)
                                     : grid_stencils(nodes, model->count_x, model->count_y,
                                                     model->pitch, clamped);
  model->clamp_edge = model->sheet().min().y();
  model->second_edge = model->sheet().max().y();
  for (std::size_t i = 0; i < model->body.particles.size(); ++i) {
    if (model->body.fixed[i] == 0) continue;
    const double y = model->body.particles[i].y();
    if (in_upper_clamp(tissue, y)) {
      model->second_edge = std::min(model->second_edge, y);
    } else {
      model->clamp_edge = std::max(model->clamp_edge, y);
    }
  }
  model->structure = model->make_structure(model->effects);
  model->node_area = lump(*model, [&](std::size_t t) { return triangle_area(*model, t); });
  if (const EffectValues& v = model->effects; v.added_mass > 0) {
    model->added_mass = disc_shares(model->body.particles, model->node_area, {v.added_x, v.added_y},
                                    v.added_radius);
    for (double& m : model->added_mass) m *= v.added_mass;
  }
  model->anchor = model->make_anchor(model->effects);
  model->anchor_turn = model->make_anchor_turn(model->effects);
  model->is_anchor.assign(model->anchor.size(), 0);
  for (int i = 0; model->effects.moves_anchor() && i < model->nodes(); ++i) {
    const bool rigid =
        model->effects.anchor_compliance == 0 &&
        detached_share(model->effects, model->body.particles[i].x(), 0.5 * model->pitch) == 0;
    if (model->body.fixed[i] == 0 || rigid) continue;
    model->body.fixed[i] = 0;
    model->is_anchor[i] = 1;
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
  model->make_preconditioner();
  return model;
}

bool ShellTissueModel::can_hold(const Vector3d& centre, double radius) const {
  // 1e-5 m: with less the sphere of the jaws only grazes the sheet. 1 m: no sheet is larger.
  if (!(radius > 1e-5 && radius <= 1)) return false;
  if (is_mesh()) return radius > 0.05 * mesh.edge && (centre.cwiseAbs().array() <= 1).all();
  // Of a sheet that lies free the end is an edge like the others.
  const bool lower = body.fixed.front() != 0 && centre.y() <= clamp_edge;
  const bool clamped = lower || (body.two_clamps && centre.y() >= second_edge);
  return sheet().contains(centre.head<2>()) && !clamped && centre.z() == 0;
}

Eigen::AlignedBox2d ShellTissueModel::sheet() const {
  return {body.particles.front().head<2>(), body.particles.back().head<2>()};
}

ShellTissueModel::NodeWeights ShellTissueModel::locate(const Vector2d& X) const {
  const Vector2d from = (X - body.particles.front().head<2>()) / pitch;
  const int ix = std::clamp(static_cast<int>(from.x()), 0, count_x - 2);
  const int iy = std::clamp(static_cast<int>(from.y()), 0, count_y - 2);
  const double u = from.x() - ix;
  const double v = from.y() - iy;
  const int i = count_y * ix + iy;
  return {{i, i + 1, i + count_y, i + count_y + 1},
          {(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v}};
}

SheetPatch ShellTissueModel::make_patch(const Vector3d& centre, double radius) const {
  std::map<std::int32_t, Vector3d> rows;  // by node, so that the order is that of the nodes
  const auto add = [&](const auto& node, const auto& part, double weight, const Vector2d& arm) {
    for (std::size_t k = 0; k < node.size(); ++k) {
      rows.try_emplace(node[k], Vector3d::Zero()).first->second +=
          weight * part[k] * Vector3d(1, arm.x(), arm.y());
    }
  };
  if (is_mesh()) {
    for (const DiscPoint& point : sample_disc(mesh, body.particles, body.fixed, centre, radius))
      add(mesh.triangles[point.triangle].node, point.share, point.weight, point.arm);
  } else {
    const Eigen::AlignedBox2d free(Vector2d(sheet().min().x(), clamp_edge),
                                   Vector2d(sheet().max().x(), second_edge));
    const std::vector<PatchPoint> points = patch_points(free, centre.head<2>(), radius);
    Vector2d mean = Vector2d::Zero();
    for (const PatchPoint& point : points) mean += point.weight * point.p;
    for (const PatchPoint& point : points) {
      const NodeWeights at = locate(point.p);
      add(at.node, at.weight, point.weight, (point.p - mean) / radius);
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
    if (body.fixed[i] != 0) continue;
    const double distance = (body.particles[i] - centre).norm();
    if (distance <= radius) patch.inside.push_back(i);
    if (nearest < 0 || distance < least) {
      nearest = i;
      least = distance;
    }
  }
  if (patch.inside.empty()) patch.inside.push_back(nearest);
  return patch;
}

SheetPatch ShellTissueModel::make_pad(const Vector3d& centre, double radius) const {
  constexpr double kLeastHold = 1e-3;
  const Grip& grip = surroundings.grip;
  const Vector2d across(-grip.axis.y(), grip.axis.x());
  SheetPatch pad;
  double whole = 0;
  std::size_t best = 0;
  for (std::int32_t i = 0; i < nodes(); ++i) {
    if (body.fixed[i] != 0) continue;
    const Vector2d from = (body.particles[i] - centre).head<2>();
    const Vector2d local(std::fabs(from.dot(grip.axis)), std::fabs(from.dot(across)));
    const double beyond = grip.rectangle ? (local - grip.half).cwiseMax(0.0).norm()
                                         : std::max(0.0, from.norm() - radius);
    const double hold = 1 - beyond / pitch;
    if (!(hold > kLeastHold)) continue;
    pad.node.push_back(i);
    pad.hold.push_back(hold);
    pad.area.push_back(hold * node_area[i]);
    whole += pad.area.back();
    if (hold > 0.5) pad.inside.push_back(i);
    if (hold > pad.hold[best]) best = pad.hold.size() - 1;
  }
  const double area = grip.rectangle ? 4 * grip.half.prod() : kPi * radius * radius;
  for (double& a : pad.area) a *= std::min(1.0, area / whole);
  if (pad.inside.empty() && !pad.node.empty()) pad.inside.push_back(pad.node[best]);
  return pad;
}

double ShellTissueModel::effective_step() const {
  return parameters.integrator() == pb::INTEGRATOR_BDF2 ? 2 * substep() / 3 : substep();
}

ShellStructure ShellTissueModel::make_structure(const EffectValues& values) const {
  ShellStructure made;
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
    for (const std::int32_t i : triangle.node) centre += body.particles[i] / 3;
    add_cell(centre, 2 * triangle.area / (pitch * pitch));
  }
  const double of_cell = density * thickness * 0.5 * pitch * pitch;
  made.mass = lump(*this, [&](std::size_t t) {
    const double mass = is_mesh() ? density * thickness * mesh.triangles[t].area : of_cell;
    return mass * thick[cell_of(*this, t)];
  });
  // Curvatures are taken per length before growth, g^2 times those of what has grown; energies
  // count per area before it, as those of the membrane and of the reference.
  const double growth = (1 + values.stretch) * (1 + values.stretch);
  for (const PlateStencil& stencil : stencils) {
    const Eigen::Vector4d fraction = stencil.fraction.cwiseProduct(clamp_factor(stencil, values));
    made.plate.push_back(plate_stiffness(
        stencil, fraction, beam_at(*this, values, stencil.place) / (growth * growth), nu));
  }
  made.bending = plate_matrix(nodes(), stencils, made.plate);
  return made;
}

ShellLaw ShellTissueModel::law() const {
  switch (material.law()) {
    case pb::LAW_NEO_HOOKE:
      return ShellLaw::kNeoHooke;
    case pb::LAW_ST_VENANT_KIRCHHOFF:
      return ShellLaw::kStVenant;
    default:
      return ShellLaw::kCorotated;
  }
}

bool ShellTissueModel::is_curved() const {
  // 1e-4: rounding in the vertices of a flat sheet.
  return std::any_of(stencils.begin(), stencils.end(), [this](const PlateStencil& stencil) {
    return stencil.rest.norm() * pitch > 1e-4;
  });
}

double ShellTissueModel::node_size(int i) const {
  return is_mesh() ? std::sqrt(node_area[i]) : pitch;
}

std::vector<Vector3d> ShellTissueModel::make_rest_moments(const EffectValues& values) const {
  std::vector<Vector3d> moments;
  const double nu = material.poisson_ratio() + values.poisson_change;
  const Vector3d wanted(values.curvature_x, values.curvature_y, values.twist);
  for (const PlateStencil& stencil : stencils) {
    // The clamp holds the rest shape, so on its edge half of the change of curvature is seen; the
    // effect's curvature ends there, so half of it is.
    const double beam = beam_at(*this, values, stencil.place);
    const auto moment = [&](const Eigen::Vector4d& fraction, const Vector3d& of) {
      return plate_moments(plate_stiffness(stencil, fraction, beam, nu), of);
    };
    moments.emplace_back(
        moment(stencil.fraction.cwiseProduct(clamp_factor(stencil, values)), stencil.rest) +
        moment(stencil.fraction, wanted));
  }
  return moments;
}

std::vector<double> ShellTissueModel::make_anchor(const EffectValues& values) const {
  std::vector<double> spring(nodes(), 0.0);
  if (!values.moves_anchor()) return spring;
  if (is_mesh()) {
    // A node carries the part of the clamp's length, its extent along x_B, that it has of the
    // clamp's area.
    double area = 0;
    double low = 1e9;
    double high = -1e9;
    for (int i = 0; i < nodes(); ++i) {
      if (!is_clamped(*this, i)) continue;
      area += node_area[i];
      low = std::min(low, body.particles[i].x());
      high = std::max(high, body.particles[i].x());
    }
    for (int i = 0; i < nodes(); ++i) {
      if (!is_clamped(*this, i)) continue;
      spring[i] = anchor_spring(values, membrane_stiffness(), body.particles[i].x(), node_size(i),
                                (high - low) * node_area[i] / area);
    }
    return spring;
  }
  for (int ix = 0; ix < count_x; ++ix) {
    const int rows = strip_rows(*this, ix);
    const double length = carried_length(*this, ix) / std::max(1, rows - 1);
    for (int iy = 0; iy < rows; ++iy) {
      const auto k = static_cast<std::size_t>(count_y * ix + iy);
      const double share = rows > 1 && (iy == 0 || iy + 1 == rows) ? 0.5 : 1;
      spring[k] =
          anchor_spring(values, membrane_stiffness(), body.particles[k].x(), pitch, share * length);
    }
  }
  return spring;
}

std::vector<double> ShellTissueModel::make_anchor_turn(const EffectValues& values) const {
  std::vector<double> turn(nodes(), 0.0);
  if (!(values.anchor_compliance > 0) || is_mesh()) return turn;
  const double thick = thickness / pitch;
  for (int ix = 0; ix < count_x; ++ix) {
    const int rows = strip_rows(*this, ix);
    for (int iy = 0; iy + 1 < rows; ++iy) {
      const auto k = static_cast<std::size_t>(count_y * ix + iy);
      const double held = anchor_spring(values, membrane_stiffness(), body.particles[k].x(), pitch,
                                        carried_length(*this, ix) / (rows - 1));
      turn[k] = held * (thick * thick - 2) / 12;
    }
  }
  return turn;
}

Eigen::Vector4d ShellTissueModel::clamp_factor(const PlateStencil& stencil,
                                               const EffectValues& values) const {
  if (!values.moves_anchor() || is_mesh() || (stencil.clamp.array() == 1).all())
    return stencil.clamp;
  // On a bed the sheet bends on the clamped side too: over half a cell where the bed is soft, and
  // as a beam on it does, over the length 1 / k, where it is stiff.
  const double left = 1 - detached_share(values, stencil.place.x(), 0.5 * pitch);
  const double half = 0.5 * pitch;
  double more = left;  // than once
  if (values.anchor_compliance > 0) {
    const int rows = strip_rows(*this, stencil.at.base / count_y);
    const double bed = left / (values.anchor_compliance * pitch * (rows - 1));  // [N/m^3]
    const double nu = material.poisson_ratio() + values.poisson_change;
    const double plate = beam_at(*this, values, stencil.place) / (1 - nu * nu);
    const double reach = half / (1 + half * std::sqrt(std::sqrt(bed / (4 * plate))));
    more = (half - reach) / (half + reach);
  }
  return Eigen::Vector4d::Ones() + more * (stencil.clamp - Eigen::Vector4d::Ones());
}

std::unique_ptr<Tissue<float>> ShellTissueModel::make_tissue(
    const LaneKernel<float>& kernel) const {
  return std::make_unique<ShellTissue<float>>(shared_from_this(), kernel);
}

std::unique_ptr<Tissue<double>> ShellTissueModel::make_tissue(
    const LaneKernel<double>& kernel) const {
  return std::make_unique<ShellTissue<double>>(shared_from_this(), kernel);
}

}  // namespace omentum
