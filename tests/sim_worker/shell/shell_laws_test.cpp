// Laws of elasticity of the shell in plane stress (shell_laws.inl) against their energies in three
// dimensions.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <vector>

#include "support/reference_scene.h"
#include "support/shell_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::ShellCase;

constexpr std::array<pb::ElasticLaw, 3> kLaws = {pb::LAW_COROTATED, pb::LAW_NEO_HOOKE,
                                                 pb::LAW_ST_VENANT_KIRCHHOFF};

std::shared_ptr<const ShellTissueModel> make_sheet(const ShellCase& c, pb::ElasticLaw law) {
  Scene scene = test::make_shell_scene(c);
  scene.config.mutable_tissue()->mutable_material()->set_law(law);
  std::vector<std::string> warnings;
  return make_shell_model(scene, 0.02, warnings);
}

/// Energy per volume of stretches in the plane and `through` it [Pa].
double energy(pb::ElasticLaw law, const Eigen::Matrix2d& C, double through, double mu,
              double lambda) {
  const double J = std::sqrt(C.determinant()) * through;
  if (law == pb::LAW_NEO_HOOKE) {
    const double trace = C.trace() + through * through;
    return 0.5 * mu * (trace - 3 - 2 * std::log(J)) + 0.5 * lambda * std::log(J) * std::log(J);
  }
  if (law == pb::LAW_ST_VENANT_KIRCHHOFF) {
    const Eigen::Matrix2d E = 0.5 * (C - Eigen::Matrix2d::Identity());
    const double E33 = 0.5 * (through * through - 1);
    const double trace = E.trace() + E33;
    return mu * (E.squaredNorm() + E33 * E33) + 0.5 * lambda * trace * trace;
  }
  const double sum = std::sqrt(C.trace() + 2 * std::sqrt(C.determinant()));  // of the stretches
  const double squares = C.trace() - 2 * sum + 2;
  const double trace = sum - 2 + through - 1;
  return mu * (squares + (through - 1) * (through - 1)) + 0.5 * lambda * trace * trace;
}

/// The least over the thickness, by thirds.
double plane_stress_energy(pb::ElasticLaw law, const Eigen::Matrix2d& C, double mu, double lambda) {
  double low = 0.3;
  double high = 3;
  for (int step = 0; step < 120; ++step) {
    const double a = low + (high - low) / 3;
    const double b = high - (high - low) / 3;
    (energy(law, C, a, mu, lambda) < energy(law, C, b, mu, lambda) ? high : low) =
        energy(law, C, a, mu, lambda) < energy(law, C, b, mu, lambda) ? b : a;
  }
  return energy(law, C, 0.5 * (low + high), mu, lambda);
}

TEST(ShellLaws, ForcesAreGradientsOfTheEnergyInPlaneStress) {
  ShellCase c;
  c.nx = c.ny = 5;
  c.poisson = 0.45;
  const double mu = c.young / (2 * (1 + c.poisson));
  const double lambda = 2 * mu * c.poisson / (1 - 2 * c.poisson);
  for (const pb::ElasticLaw law : kLaws) {
    const auto model = make_sheet(c, law);
    test::Random random;
    std::vector<Vector3d> x = model->body.particles;
    for (Vector3d& p : x) {  // stretched, sheared, and each node off by a tenth of a cell
      p = Vector3d(1.3 * p.x() + 0.2 * p.y(), 0.8 * p.y(), 0) +
          1e-1 * c.pitch * Vector3d(random.next(), random.next(), 0);
    }
    ShellTissue<double> tissue(model, f64x1());
    for (int i = 0; i < tissue.particles(); ++i) tissue.set_position(0, i, x[i]);
    for (int i = 0; i < tissue.particles(); ++i) x[i] = tissue.position(0, i);
    const auto whole = [&] {
      double sum = 0;
      for_each_triangle(*model, [&](int x0, int x1, int y0, int y1) {
        Eigen::Matrix<double, 3, 2> F;
        F << (x[x1] - x[x0]) / c.pitch, (x[y1] - x[y0]) / c.pitch;
        sum += 0.5 * c.pitch * c.pitch * c.thickness *
               plane_stress_energy(law, F.transpose() * F, mu, lambda);
      });
      return sum;
    };
    const std::vector<Vector3d> gradient = tissue.elastic_gradient(0);
    double largest = 0;
    double off = 0;
    for (int i = 0; i < tissue.particles(); ++i) {
      if (model->body.fixed[static_cast<std::size_t>(i)] != 0) continue;
      for (int axis = 0; axis < 2; ++axis) {
        constexpr double kStep = 1e-7;
        const double at = x[i][axis];
        x[i][axis] = at + kStep;
        const double above = whole();
        x[i][axis] = at - kStep;
        const double below = whole();
        x[i][axis] = at;
        const double expected = (above - below) / (2 * kStep);
        largest = std::max(largest, std::fabs(expected));
        off = std::max(off, std::fabs(gradient[static_cast<std::size_t>(i)][axis] - expected));
      }
    }
    EXPECT_LT(off, 1e-6 * largest) << pb::ElasticLaw_Name(law);
  }
}

/// Lifts a clamped sheet by 20 mm near its free edge.
template <typename Real>
std::unique_ptr<ShellTissue<Real>> lift_by_law(pb::ElasticLaw law, const LaneKernel<Real>& kernel) {
  ShellCase c;
  c.nx = c.ny = 16;
  c.anchor_max_y = -0.0224;  // the row at y_B = -22.5 mm
  c.young = 60e3;
  c.poisson = 0.45;
  auto tissue = std::make_unique<ShellTissue<Real>>(make_sheet(c, law), kernel);
  const auto lanes = static_cast<std::size_t>(tissue->lanes());
  Vector3d tip(0, 0.018, 0);
  for (int lane = 0; lane < tissue->lanes(); ++lane) tissue->hold(lane, tip, 0.005, false);
  for (int step = 0; step < 60; ++step) {
    const Vector3d next = tip + Vector3d(0, 0, step < 40 ? 5e-4 : 0.0);
    const std::vector<ToolMotion> motion(lanes, ToolMotion{tip, next});
    tissue->step(motion);
    tip = next;
  }
  return tissue;
}

TEST(ShellLaws, EveryLaneHasTheSameBits) {
  for (const pb::ElasticLaw law : {pb::LAW_NEO_HOOKE, pb::LAW_ST_VENANT_KIRCHHOFF}) {
    const auto one = lift_by_law<float>(law, f32x1());
    const auto eight = lift_by_law<float>(law, f32x8());
    ASSERT_TRUE(one->healthy(0));
    for (int lane = 0; lane < 8; ++lane) EXPECT_EQ(one->hash(0), eight->hash(lane));
  }
}

/// Stretched by 12 % the laws part: neo-Hooke yields where St. Venant-Kirchhoff stiffens.
TEST(ShellLaws, PartAsTheyStretch) {
  const auto force = [](pb::ElasticLaw law) {
    const auto tissue = lift_by_law<double>(law, f64x1());
    EXPECT_TRUE(tissue->healthy(0));
    return tissue->held_force(0).norm();
  };
  const double corotated = force(pb::LAW_COROTATED);
  const double neo_hooke = force(pb::LAW_NEO_HOOKE);
  const double st_venant = force(pb::LAW_ST_VENANT_KIRCHHOFF);
  std::printf("# corotated %.4f N, neo-Hooke %.4f N, St. Venant-Kirchhoff %.4f N\n", corotated,
              neo_hooke, st_venant);
  EXPECT_LT(neo_hooke, corotated);
  EXPECT_LT(corotated, st_venant);
}

}  // namespace
}  // namespace omentum
