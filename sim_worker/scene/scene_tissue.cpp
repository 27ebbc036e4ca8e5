// The tissue of a scene: particles of a grid, a sheet or a volume.
#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/rng.h"
#include "sim_worker/scene/clamp_rows.h"
#include "sim_worker/scene/particles.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// Area-weighted random points of a surface, from our counter-based generator (volume maker,
/// surface sampling).
std::vector<Vector3d> sample_surface(const TriangleMesh& mesh, double surface_sampling) {
  std::vector<Vector3d> samples;
  if (!(surface_sampling > 0)) return samples;
  samples = mesh.vertices;
  std::vector<double> cumulative;
  double total = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Vector3d& a = mesh.vertices[static_cast<std::size_t>(t[0])];
    const Vector3d& b = mesh.vertices[static_cast<std::size_t>(t[1])];
    const Vector3d& c = mesh.vertices[static_cast<std::size_t>(t[2])];
    total += 0.5 * (b - a).cross(c - a).norm();
    cumulative.push_back(total);
  }
  const auto count = static_cast<std::uint32_t>(50000 * surface_sampling);
  for (std::uint32_t i = 0; i < count; ++i) {
    const PhiloxWords words = philox({i, 0, 0, 0}, {0, 0});
    const double where = static_cast<double>(words[0]) * 0x1p-32 * total;
    const auto k = static_cast<std::size_t>(std::min<std::ptrdiff_t>(
        std::upper_bound(cumulative.begin(), cumulative.end(), where) - cumulative.begin(),
        static_cast<std::ptrdiff_t>(cumulative.size()) - 1));
    double u = static_cast<double>(words[1]) * 0x1p-32;
    double v = static_cast<double>(words[2]) * 0x1p-32;
    if (u + v > 1) {
      u = 1 - u;
      v = 1 - v;
    }
    const Eigen::Vector3i& t = mesh.triangles[k];
    const Vector3d& a = mesh.vertices[static_cast<std::size_t>(t[0])];
    samples.emplace_back(a + u * (mesh.vertices[static_cast<std::size_t>(t[1])] - a) +
                         v * (mesh.vertices[static_cast<std::size_t>(t[2])] - a));
  }
  return samples;
}

void make_grid_tissue(const pb::GridMaker& grid, const pb::Tissue& config, TissueBody& body) {
  body.particles = make_grid_particles(grid);
  body.surface_is_particles = true;
  const auto ny = static_cast<int>(grid.count_y());
  for (int ix = 0; ix + 1 < static_cast<int>(grid.count_x()); ++ix) {
    for (int iy = 0; iy + 1 < ny; ++iy) {
      const int a = ix * ny + iy;
      const int b = a + ny;
      // Alternating diagonals, so that no direction of the sheet is preferred.
      if ((ix + iy) % 2 == 0) {
        body.surface_triangles.emplace_back(a, b, b + 1);
        body.surface_triangles.emplace_back(a, b + 1, a + 1);
      } else {
        body.surface_triangles.emplace_back(a, b, a + 1);
        body.surface_triangles.emplace_back(b, b + 1, a + 1);
      }
    }
  }
  const double area = static_cast<double>((grid.count_x() - 1) * (grid.count_y() - 1)) *
                      grid.pitch_m() * grid.pitch_m();
  body.particle_mass = config.density_kg_per_m3() * config.thickness_m() * area /
                       static_cast<double>(body.particles.size());
}

void make_sheet_tissue(const pb::SheetMaker& maker, const std::string& directory,
                       const pb::Tissue& config, TissueBody& body, SheetGeometry& sheet) {
  const std::string path = mesh_path(maker.mesh(), directory, "scene.tissue.sheet.mesh");
  TriangleMesh mesh = load_mesh(path, maker.mesh().unit_m(), maker.mesh().sha256());
  require_sheet(path, mesh);
  body.particles = mesh.vertices;
  body.surface_triangles = mesh.triangles;
  body.surface_is_particles = true;
  sheet = measure_sheet(path, mesh.vertices, mesh.triangles);
  double area = 0;
  for (const SheetTriangle& triangle : sheet.triangles) area += triangle.area;
  body.particle_mass = config.density_kg_per_m3() * config.thickness_m() * area /
                       static_cast<double>(body.particles.size());
}

ThicknessMap make_thickness_map(const pb::ThicknessMap& config, const TissueBody& body) {
  ThicknessMap map;
  map.count_x = static_cast<int>(config.count_x());
  map.count_y = static_cast<int>(config.count_y());
  map.ratio.assign(config.ratio().begin(), config.ratio().end());
  if (config.ratio_size() != map.count_x * map.count_y) {
    throw_error("scene.tissue.thickness_map.ratio: {} values, allowed count_x count_y = {}",
                config.ratio_size(), map.count_x * map.count_y);
  }
  for (std::size_t k = 0; k < map.ratio.size(); ++k) {
    if (map.ratio[k] >= 0.2 && map.ratio[k] <= 5) continue;
    throw_error("scene.tissue.thickness_map.ratio[{}]: {}, allowed 0.2 ... 5", k, map.ratio[k]);
  }
  map.low = map.high = body.particles.front().head<2>();
  for (const Vector3d& p : body.particles) {
    map.low = map.low.cwiseMin(p.head<2>());
    map.high = map.high.cwiseMax(p.head<2>());
  }
  return map;
}

void make_volume_tissue(const pb::VolumeMaker& maker, const std::string& directory,
                        const pb::Tissue& config, TissueBody& body, SolidMesh& solid) {
  TriangleMesh mesh;
  Vector3d min;
  Vector3d max;
  std::function<std::vector<bool>(std::span<const Vector3d>)> inside;
  if (maker.has_mesh()) {
    mesh = load_scene_mesh(maker.mesh(), directory, "scene.tissue.volume.mesh");
    min = max = mesh.vertices.front();
    for (const Vector3d& v : mesh.vertices) {
      min = min.cwiseMin(v);
      max = max.cwiseMax(v);
    }
    inside = [&mesh](std::span<const Vector3d> points) { return points_inside(mesh, points); };
  } else if (maker.has_box_m()) {
    const Vector3d half = 0.5 * to_vector(maker.box_m());
    if (!(half.minCoeff() >= 1e-4))
      throw_error("scene.tissue.volume.box_m: an edge below 0.0002 m");
    mesh = make_box_mesh(half);
    min = -half;
    max = half;
    inside = [half](std::span<const Vector3d> points) {
      std::vector<bool> result;
      for (const Vector3d& p : points)
        result.push_back((p.cwiseAbs().array() < half.array()).all());
      return result;
    };
  } else {
    throw_error("scene.tissue.volume: give box_m or mesh");
  }
  if (config.model() == pb::TISSUE_ELASTIC) {
    solid = fill_mesh(mesh, "scene.tissue.volume", maker.edge_length_m());
    body.particles = solid.nodes;
    body.surface_triangles = solid.surface;
    body.particle_mass = config.density_kg_per_m3() * signed_volume(mesh) /
                         static_cast<double>(body.particles.size());
    return;
  }
  body.particles = make_volume_particles(maker, min, max, inside,
                                         sample_surface(mesh, maker.surface_sampling()));
  if (body.particles.size() < 4) {
    throw_error("scene.tissue.volume.particle_spacing_m: {} makes {} particles, allowed at least 4",
                maker.particle_spacing_m(), body.particles.size());
  }
  body.surface_is_particles = false;
  body.surface_vertices = mesh.vertices;
  body.surface_triangles = mesh.triangles;
  body.particle_mass =
      config.density_kg_per_m3() * signed_volume(mesh) / static_cast<double>(body.particles.size());
}

}  // namespace

TissueBody make_tissue_body(const pb::Tissue& config, const std::string& directory,
                            SolidMesh& solid, SheetGeometry& sheet) {
  TissueBody body;
  body.X_WB = to_pose(config.pose(), "scene.tissue.pose");
  body.particle_radius = config.particle_radius_m();
  body.thickness = config.thickness_m();
  if (config.has_grid()) {
    make_grid_tissue(config.grid(), config, body);
  } else if (config.has_volume()) {
    make_volume_tissue(config.volume(), directory, config, body, solid);
  } else if (config.has_sheet()) {
    make_sheet_tissue(config.sheet(), directory, config, body, sheet);
  } else {
    throw_error("scene.tissue: give grid, sheet or volume");
  }
  if (config.has_thickness_map()) {
    if (config.has_volume() || config.model() == pb::TISSUE_CLUSTER) {
      throw_error(
          "scene.tissue.thickness_map: allowed for a sheet of the models elastic and reference");
    }
    body.thickness_map = make_thickness_map(config.thickness_map(), body);
  }
  std::size_t fixed = 0;
  for (const Vector3d& p : body.particles) {
    const bool second = in_upper_clamp(config, p.y());
    body.fixed.push_back(second || in_lower_clamp(config, p.y()) ? 1 : 0);
    body.two_clamps = body.two_clamps || second;
    fixed += body.fixed.back();
  }
  // The sheet of clusters is that of the paper, which is anchored.
  const std::size_t least = config.model() == pb::TISSUE_CLUSTER ? 1 : 0;
  if (fixed < least || fixed == body.particles.size()) {
    throw_error(
        "scene.tissue.anchor_max_y_m: {} and anchor_min_y_m {} fix {} of {} particles, allowed {} "
        "... {}",
        config.anchor_max_y_m(), config.anchor_min_y_m(), fixed, body.particles.size(), least,
        body.particles.size() - 1);
  }
  const pb::Anchor& anchor = config.effects().anchor();
  if (body.two_clamps &&
      (anchor.compliance_m2_per_n() > 0 || anchor.free_from_m() != anchor.free_to_m())) {
    throw_error("scene.tissue.effects.anchor: allowed with one clamp, anchor_min_y_m {} makes two",
                config.anchor_min_y_m());
  }
  return body;
}

}  // namespace omentum
