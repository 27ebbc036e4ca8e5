#pragma once

#include <Eigen/Core>
#include <cmath>
#include <span>
#include <vector>

#include "sim_worker/shell/shell_model.h"
#include "sim_worker/solid/solid_model.h"

namespace omentum {

/// Elastic energy of node positions p [m] at nominal stiffness [J]: membrane and bending apart, of
/// a sheet curved at rest less a constant. The forces of a shell are its gradient.
struct ShellEnergy {
  double membrane = 0, bending = 0;
};
inline ShellEnergy shell_energy(const ShellTissueModel& model, std::span<const Eigen::Vector3d> p) {
  ShellEnergy energy;
  // |F - R|^2 = tr C - 2 tr S + 2; shear and area carry t a_T / pitch^2.
  const auto add_membrane = [&](const Eigen::Matrix<double, 3, 2>& f, double cell) {
    const Eigen::Matrix2d c = f.transpose() * f;
    const double tau = std::sqrt(c.trace() + 2 * std::sqrt(c.determinant()));
    const double a = model.pitch * model.pitch * cell;
    energy.membrane += a * (0.5 * model.structure.shear * (c.trace() - 2 * tau + 2) +
                            0.5 * model.structure.area * (tau - 2) * (tau - 2));
  };
  const auto leg = [&](int from, int to) { return Eigen::Vector3d(p[to] - p[from]); };
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
  const std::vector<Eigen::Vector3d> rest = model.make_rest_moments(model.effects);
  for (std::size_t k = 0; k < model.stencils.size(); ++k) {
    const Eigen::Vector3d bent = curvature(model.stencils[k].at, p);
    energy.bending += (0.5 * plate_moments(model.structure.plate[k], bent) - rest[k]).dot(bent);
  }
  return energy;
}

/// Elastic energy of node positions p [m] of a solid at nominal stiffness, zero at rest [J].
inline double solid_energy(const SolidTissueModel& model, std::span<const Eigen::Vector3d> p) {
  using Eigen::Matrix3d;
  const SolidLaw& law = model.law;
  const auto density = [&](const Matrix3d& f) {
    const double i = f.squaredNorm();
    const double off = f.determinant() - law.alpha;
    return law.mu / 2 * (i - 3) + law.lambda / 2 * off * off - law.mu / 2 * std::log(i + 1);
  };
  const double rest = density(Matrix3d::Identity());
  double energy = 0;
  for (std::size_t t = 0; t < model.volume.size(); ++t) {
    const Eigen::Map<const Eigen::Matrix<double, 4, 3, Eigen::RowMajor>> g(&model.gradient[12 * t]);
    const auto at = [&](int k) { return p[model.mesh.tetrahedra[t][k]]; };
    double mean = 0;
    for (int q = 0; q < 4; ++q) {
      // Volume coordinates of the point: (5 + 3 sqrt 5) / 20 at its corner, (5 - sqrt 5) / 20 else.
      const double root = std::sqrt(5.0);
      const auto L = [&](int a) { return a == q ? (5 + 3 * root) / 20 : (5 - root) / 20; };
      Matrix3d f = Matrix3d::Zero();
      for (int a = 0; a < 4; ++a) f += at(a) * ((4 * L(a) - 1) * g.row(a));
      for (int k = 0; k < 6; ++k) {
        const int a = kSolidEdge[k][0];
        const int b = kSolidEdge[k][1];
        f += at(4 + k) * (4 * (L(a) * g.row(b) + L(b) * g.row(a)));
      }
      energy += model.volume[t] / 4 * (density(f) - rest);
      mean += f.determinant() / 4;
    }
    energy += model.volume[t] * law.bulk / 2 * (mean - 1) * (mean - 1);
  }
  return energy;
}

}  // namespace omentum
