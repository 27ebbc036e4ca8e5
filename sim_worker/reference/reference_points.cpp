// Points of the reference solid: shape functions, location of a point, the patch of a grasp.
#include <algorithm>
#include <map>

#include "core/check.h"
#include "sim_worker/reference/reference_model.h"
#include "sim_worker/tissue/grasp_patch.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

/// Cells of a row of grid lines that touch the coordinate: one, or two if it lies on a line.
std::vector<int> cells_at(const std::vector<double>& lines, double value) {
  std::vector<int> cells;
  for (int k = 0; k + 1 < static_cast<int>(lines.size()); ++k) {
    if (value >= lines[k] - kSameLine && value <= lines[k + 1] + kSameLine) cells.push_back(k);
  }
  OMENTUM_CHECK(!cells.empty() && cells.size() <= 2, "coordinate {}", value);
  return cells;
}

double local_coordinate(const std::vector<double>& lines, int cell, double value) {
  const double t = 2 * (value - lines[cell]) / (lines[cell + 1] - lines[cell]) - 1;
  return std::clamp(t, -1.0, 1.0);
}

/// Deformation gradient in the middle of an element.
Matrix3d middle_gradient(const Vector3d& size, const std::array<Vector3d, 8>& x) {
  Matrix3d F = Matrix3d::Zero();
  for (int a = 0; a < kHexNodes; ++a) {
    for (int axis = 0; axis < 3; ++axis)
      F.col(axis) += (((a >> axis) & 1) != 0 ? 0.25 : -0.25) / size[axis] * x[a];
  }
  return F;
}

/// Column k: (2 / size_J) m_kJ, by xi_k the part of G in row k.
Matrix3d mode_slopes(const Vector3d& size, const std::array<double, 9>& mode) {
  const Eigen::Map<const Matrix3d> m(mode.data());
  return (2 * size.cwiseInverse()).asDiagonal() * m;
}

}  // namespace

std::array<double, 8> hex_functions(const Vector3d& xi) {
  std::array<double, 8> N{};
  for (int a = 0; a < 8; ++a) {
    N[a] = 0.125;
    for (int axis = 0; axis < 3; ++axis)
      N[a] *= ((a >> axis) & 1) != 0 ? 1 + xi[axis] : 1 - xi[axis];
  }
  return N;
}

HexBow::HexBow(const Vector3d& size, const std::array<Vector3d, 8>& x,
               const std::array<double, 9>& mode, const Vector3d& xi)
    : size_(size),
      xi_(xi),
      F_(middle_gradient(size, x)),
      across_(F_.inverse().transpose()),
      slopes_(mode_slopes(size, mode)),
      value_(Vector3d::Zero()) {
  for (int k = 0; k < 3; ++k) value_ += parabola(k) * direction(k);
}

double HexBow::parabola(int k) const { return -0.25 * size_[k] * (1 - xi_[k] * xi_[k]); }

Vector3d HexBow::direction(int k) const {
  const Vector3d a = F_.col(k);
  const Vector3d b = across_.col(k);
  const Vector3d n = across_ * slopes_.col(k);
  const double square = b.squaredNorm();
  return (n + n.dot(b) * (a - b / square)) / square;
}

Vector3d HexBow::rate(const std::array<Vector3d, 8>& dx, const std::array<double, 9>& dmode) const {
  const Matrix3d dF = middle_gradient(size_, dx);
  const Matrix3d dslopes = mode_slopes(size_, dmode);
  const Matrix3d dacross = -across_ * dF.transpose() * across_;
  Vector3d sum = Vector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    const Vector3d a = F_.col(k);
    const Vector3d b = across_.col(k);
    const Vector3d db = dacross.col(k);
    const Vector3d n = across_ * slopes_.col(k);
    const Vector3d dn = dacross * slopes_.col(k) + across_ * dslopes.col(k);
    const double square = b.squaredNorm();
    const double dsquare = 2 * b.dot(db);
    const Vector3d part = dn + (dn.dot(b) + n.dot(db)) * (a - b / square) +
                          n.dot(b) * (dF.col(k) - (db - b * (dsquare / square)) / square);
    sum += parabola(k) * (part - dsquare * direction(k)) / square;
  }
  return sum;
}

BodyPoint ReferenceTissueModel::locate(const Vector3d& p_B) const {
  BodyPoint point;
  for (const int iy : cells_at(lines[1], p_B.y())) {
    for (const int ix : cells_at(lines[0], p_B.x())) {
      for (const int iz : cells_at(lines[2], p_B.z())) {
        point.locations.push_back(
            {element_index(ix, iy, iz),
             {local_coordinate(lines[0], ix, p_B.x()), local_coordinate(lines[1], iy, p_B.y()),
              local_coordinate(lines[2], iz, p_B.z())}});
      }
    }
  }
  return point;
}

Eigen::AlignedBox2d ReferenceTissueModel::node_box(std::size_t node) const {
  const std::size_t column = node / lines[2].size();
  const std::array<std::size_t, 2> at = {column % lines[0].size(), column / lines[0].size()};
  Eigen::AlignedBox2d box;
  for (int axis = 0; axis < 2; ++axis) {
    const std::vector<double>& line = lines[axis];
    const std::size_t k = at[axis];
    box.min()[axis] = k > 0 ? 0.5 * (line[k - 1] + line[k]) : line[k];
    box.max()[axis] = k + 1 < line.size() ? 0.5 * (line[k] + line[k + 1]) : line[k];
  }
  return box;
}

Vector3d ReferenceTissueModel::gauss_point(const ReferenceElement& element, int point) const {
  constexpr double kGauss = 0.57735026918962576451;
  const auto side = [point](int axis) { return ((point >> axis) & 1) != 0 ? kGauss : -kGauss; };
  const std::array<double, 8> N = hex_functions({side(0), side(1), side(2)});
  Vector3d p = Vector3d::Zero();
  for (int a = 0; a < kHexNodes; ++a) p += N[a] * nodes[element.node[a]];
  return p;
}

GraspPatch ReferenceTissueModel::make_patch(const Vector2d& centre, double radius) const {
  const std::vector<PatchPoint> points = patch_points(free_sheet(), centre, radius);
  Vector2d mean = Vector2d::Zero();
  for (const PatchPoint& point : points) mean += point.weight * point.p;

  const double half = 0.5 * body.thickness;
  std::map<int, Eigen::Vector4d> rows;  // by node
  for (const PatchPoint& point : points) {
    const int ix = cells_at(lines[0], point.p.x()).front();
    const int iy = cells_at(lines[1], point.p.y()).front();
    for (int iz = 0; iz < cells(2); ++iz) {
      const double share = (lines[2][iz + 1] - lines[2][iz]) / (lines[2].back() - lines[2].front());
      for (const double zeta : {-0.57735026918962576, 0.57735026918962576}) {  // Gauss
        const Vector3d xi(local_coordinate(lines[0], ix, point.p.x()),
                          local_coordinate(lines[1], iy, point.p.y()), zeta);
        const double z = 0.5 * (lines[2][iz] * (1 - zeta) + lines[2][iz + 1] * (1 + zeta));
        const Eigen::Vector4d row = 0.5 * share * point.weight *
                                    Eigen::Vector4d(1, (point.p.x() - mean.x()) / radius,
                                                    (point.p.y() - mean.y()) / radius, z / half);
        const std::array<double, 8> N = hex_functions(xi);
        const ReferenceElement& element = elements[element_index(ix, iy, iz)];
        for (int a = 0; a < 8; ++a)
          rows.try_emplace(element.node[a], Eigen::Vector4d::Zero()).first->second += N[a] * row;
      }
    }
  }
  GraspPatch patch;
  patch.weight.resize(static_cast<Eigen::Index>(rows.size()), GraspPatch::kRows);
  for (const auto& [node, row] : rows) {
    patch.weight.row(static_cast<Eigen::Index>(patch.node.size())) = row.transpose();
    patch.node.push_back(node);
  }
  int nearest = -1;
  double least = 0;
  for (int i = 0; i < static_cast<int>(body.particles.size()); ++i) {
    if (body.fixed[i] != 0) continue;
    const double distance = (body.particles[i].head<2>() - centre).norm();
    if (distance <= radius) patch.particles.push_back(i);
    if (nearest < 0 || distance < least) {
      nearest = i;
      least = distance;
    }
  }
  if (patch.particles.empty()) patch.particles.push_back(nearest);
  return patch;
}

GraspPad ReferenceTissueModel::make_pad(const Vector2d& centre, double radius) const {
  const Grip& grip = surroundings.grip;
  // Area of the pad at the nodes of the face, by samples.
  constexpr int kSamples = 64;
  const Eigen::AlignedBox2d free = free_sheet();
  const Vector2d half = grip.rectangle ? grip.half : Vector2d::Constant(radius);
  const Vector2d across(-grip.axis.y(), grip.axis.x());
  const double part = 4 * half.prod() / (kSamples * kSamples);
  std::map<std::pair<int, int>, double> areas;  // by ix, iy
  double total = 0;
  for (int i = 0; i < kSamples; ++i) {
    for (int k = 0; k < kSamples; ++k) {
      const Vector2d local =
          half.cwiseProduct(Vector2d(2 * i + 1, 2 * k + 1) / kSamples - Vector2d::Ones());
      const Vector2d from_centre = local.x() * grip.axis + local.y() * across;
      const Vector2d p = centre + from_centre;
      if (!grip.covers(from_centre, radius) || !free.contains(p)) continue;
      total += part;
      const int ix = cells_at(lines[0], p.x()).front();
      const int iy = cells_at(lines[1], p.y()).front();
      const double u = 0.5 + 0.5 * local_coordinate(lines[0], ix, p.x());
      const double v = 0.5 + 0.5 * local_coordinate(lines[1], iy, p.y());
      areas[{ix, iy}] += part * (1 - u) * (1 - v);
      areas[{ix + 1, iy}] += part * u * (1 - v);
      areas[{ix, iy + 1}] += part * (1 - u) * v;
      areas[{ix + 1, iy + 1}] += part * u * v;
    }
  }
  // Nodes beside the pad are free: those under it bear what cells across its rim give them.
  const auto add = [&](int ix, int iy, double area, GraspPad& pad) {
    pad.lower.push_back(node_index(ix, iy, 0));
    pad.upper.push_back(node_index(ix, iy, cells(2)));
    pad.area.push_back(area);
  };
  GraspPad pad;
  double borne = 0;
  std::pair<int, int> nearest;
  double least = -1;
  for (const auto& [at, area] : areas) {
    if (unknown[node_index(at.first, at.second, 0)] < 0) continue;
    const Vector2d off = Vector2d(lines[0][at.first], lines[1][at.second]) - centre;
    if (least < 0 || off.norm() < least) {
      least = off.norm();
      nearest = at;
    }
    if (!grip.covers(off, radius)) continue;
    add(at.first, at.second, area, pad);
    borne += area;
  }
  if (pad.area.empty() && least >= 0) {
    add(nearest.first, nearest.second, total, pad);
    borne = total;
  }
  for (double& area : pad.area) area *= total / borne;
  for (int i = 0; i < static_cast<int>(body.particles.size()); ++i) {
    if (body.fixed[i] == 0 && grip.covers(body.particles[i].head<2>() - centre, radius))
      pad.particles.push_back(i);
  }
  if (pad.particles.empty()) pad.particles = make_patch(centre, radius).particles;
  return pad;
}

}  // namespace omentum
