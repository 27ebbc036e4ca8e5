#include "sim_worker/reference/reference_model.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/machine_memory.h"
#include "sim_worker/reference/reference_mesh.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

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
  make_mesh(scene, pinches, mesh_of, *model);
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
