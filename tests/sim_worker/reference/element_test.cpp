// Laws of elasticity and the brick of the converged solid (docs/tissue.md 12).

#include <gtest/gtest.h>

#include <Eigen/SVD>
#include <cmath>
#include <cstdio>

#include "sim_worker/reference/hexahedron.h"
#include "sim_worker/reference/hyperelastic_law.h"
#include "sim_worker/reference/reference_model.h"
#include "support/reference_scene.h"

namespace omentum {
namespace {

using namespace test;  // NOLINT(google-build-using-namespace)

constexpr std::array<pb::ElasticLaw, 3> kLaws = {pb::LAW_COROTATED, pb::LAW_NEO_HOOKE,
                                                 pb::LAW_ST_VENANT_KIRCHHOFF};

std::array<double, 9> random_gradient(Random& random, double size) {
  std::array<double, 9> F{};
  for (int k = 0; k < 9; ++k) F[k] = (k % 4 == 0 ? 1.0 : 0.0) + size * random.next();
  return F;
}

TEST(ElasticLaw, StressIsDerivativeOfEnergyAndTangentOfStress) {
  Random random;
  const Lame lame = make_lame(1, 0.4);
  for (const pb::ElasticLaw law : kLaws) {
    for (int sample = 0; sample < 20; ++sample) {
      const std::array<double, 9> F = random_gradient(random, 0.3);
      ElasticResponse<double> at;
      elastic_response(law, F, lame.mu, lame.lambda, true, at);
      constexpr double kStep = 1e-5;  // second-order differences: 1e-10 of the third derivative
      for (int k = 0; k < 9; ++k) {
        std::array<double, 9> low = F;
        std::array<double, 9> high = F;
        low[k] -= kStep;
        high[k] += kStep;
        ElasticResponse<double> below;
        ElasticResponse<double> above;
        elastic_response(law, low, lame.mu, lame.lambda, false, below);
        elastic_response(law, high, lame.mu, lame.lambda, false, above);
        EXPECT_NEAR(at.stress[k], (above.energy - below.energy) / (2 * kStep), 1e-7) << law;
        for (int row = 0; row < 9; ++row) {
          EXPECT_NEAR(at.tangent[9 * row + k],
                      (above.stress[row] - below.stress[row]) / (2 * kStep), 1e-6)
              << law;
        }
      }
    }
  }
}

TEST(ElasticLaw, OwnLogarithmIsThatOfTheCLibrary) {
  Random random;
  for (int sample = 0; sample < 2000; ++sample) {
    const double a = std::exp(sample % 2 == 0 ? 0.5 * random.next() : 600 * random.next());
    EXPECT_NEAR(logarithm(a), std::log(a), 4.5e-16 * std::fabs(std::log(a))) << a;
    // Next to one, where the strain energies live, it is as exact relative to the strain.
    const double near = 1 + 1e-9 * random.next();
    EXPECT_NEAR(logarithm(near), std::log(near), 4.5e-16 * std::fabs(std::log(near)));
  }
  EXPECT_EQ(logarithm(1.0), 0);
  EXPECT_TRUE(std::isnan(logarithm(0.0)));
  EXPECT_TRUE(std::isnan(logarithm(-1.0)));
}

TEST(ElasticLaw, CorotatedEnergyIsThatOfThePolarDecomposition) {
  Random random;
  const Lame lame = make_lame(1, 0.4);
  for (int sample = 0; sample < 20; ++sample) {
    const std::array<double, 9> F = random_gradient(random, 0.3);
    ElasticResponse<double> at;
    elastic_response(pb::LAW_COROTATED, F, lame.mu, lame.lambda, false, at);
    const Matrix3d f = Eigen::Map<const Matrix3d>(F.data()).transpose();
    const Vector3d stretch = Eigen::JacobiSVD<Matrix3d>(f).singularValues();
    const double expected = lame.mu * (stretch - Vector3d::Ones()).squaredNorm() +
                            0.5 * lame.lambda * std::pow(stretch.sum() - 3, 2);
    EXPECT_NEAR(at.energy, expected, 1e-13);
  }
}

TEST(ElasticLaw, SmallStrainIsHooke) {
  const double young = 5e4;
  for (const double poisson : {0.0, 0.3, 0.49}) {
    const Lame lame = make_lame(young, poisson);
    for (const pb::ElasticLaw law : kLaws) {
      // Uniaxial stress: stretch e along x, -nu e across.
      constexpr double kStrain = 1e-6;
      std::array<double, 9> F = {1 + kStrain,          0, 0, 0, 1 - poisson * kStrain, 0, 0, 0,
                                 1 - poisson * kStrain};
      ElasticResponse<double> at;
      elastic_response(law, F, lame.mu, lame.lambda, false, at);
      EXPECT_NEAR(at.stress[0] / (young * kStrain), 1, 1e-4);  // 1e-6 strain, lambda 16 mu
      EXPECT_NEAR(at.stress[4] / (young * kStrain), 0, 1e-4);
      F = {1, kStrain, 0, 0, 1, 0, 0, 0, 1};
      elastic_response(law, F, lame.mu, lame.lambda, false, at);
      EXPECT_NEAR(at.stress[1] / (lame.mu * kStrain), 1, 1e-5);
    }
  }
}

TEST(ElasticLaw, RotationGivesNoStress) {
  const Matrix3d R = Eigen::AngleAxisd(2.5, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  std::array<double, 9> F{};
  for (int k = 0; k < 9; ++k) F[k] = R(k / 3, k % 3);
  for (const pb::ElasticLaw law : kLaws) {
    ElasticResponse<double> at;
    elastic_response(law, F, 1.0, 10.0, false, at);
    EXPECT_NEAR(at.energy, 0, 1e-14) << law;
    for (const double stress : at.stress) EXPECT_NEAR(stress, 0, 1e-13) << law;
  }
}

TEST(ElasticLaw, FourSideBySideEqualOne) {
  Random random;
  for (const pb::ElasticLaw law : kLaws) {
    std::array<std::array<double, 9>, Pack::kLanes> F{};
    std::array<Pack, 9> side_by_side;
    for (int lane = 0; lane < Pack::kLanes; ++lane) {
      F[lane] = random_gradient(random, 0.3);
      for (int k = 0; k < 9; ++k) side_by_side[k].set_lane(lane, F[lane][k]);
    }
    ElasticResponse<Pack> packed;
    elastic_response(law, side_by_side, Pack(1.0), Pack(4.0), true, packed);
    for (int lane = 0; lane < Pack::kLanes; ++lane) {
      ElasticResponse<double> one;
      elastic_response(law, F[lane], 1.0, 4.0, true, one);
      EXPECT_EQ(packed.energy.lane(lane), one.energy);
      for (int k = 0; k < 9; ++k) EXPECT_EQ(packed.stress[k].lane(lane), one.stress[k]);
      for (int k = 0; k < 81; ++k) EXPECT_EQ(packed.tangent[k].lane(lane), one.tangent[k]);
    }
  }
}

HexShape make_shape(const Vector3d& size, const std::function<Vector3d(const Vector3d&)>& at) {
  HexShape shape;
  for (int a = 0; a < kHexNodes; ++a) {
    const Vector3d X(size.x() * (a & 1), size.y() * ((a >> 1) & 1), size.z() * (a >> 2));
    const Vector3d x = at(X);
    for (int axis = 0; axis < 3; ++axis) shape.x[3 * a + axis] = Pack(x[axis]);
  }
  for (int axis = 0; axis < 3; ++axis) shape.size[axis] = Pack(size[axis]);
  const Lame lame = make_lame(1e4, 0.45);
  shape.mu = Pack(lame.mu);
  shape.lambda = Pack(lame.lambda);
  return shape;
}

TEST(Hexahedron, ForceIsDerivativeOfEnergy) {
  Random random;
  for (const pb::ElasticLaw law : kLaws) {
    HexShape shape = make_shape(Vector3d(0.003, 0.004, 0.003), [&](const Vector3d& X) {
      return Vector3d(X + 3e-4 * Vector3d(random.next(), random.next(), random.next()));
    });
    for (Pack& b : shape.mode) b = Pack(1e-4 * random.next());
    HexForce at;
    hex_force(law, shape, at);
    constexpr double kStep = 1e-8;  // [m]
    const auto difference = [&](Pack& of) {
      const Pack kept = of;
      HexForce below;
      HexForce above;
      of = kept - Pack(kStep);
      hex_force(law, shape, below);
      of = kept + Pack(kStep);
      hex_force(law, shape, above);
      of = kept;
      return (above.energy.lane(0) - below.energy.lane(0)) / (2 * kStep);
    };
    // Forces are about E A strain = 1e4 * 1e-5 * 0.1 = 1e-2 N.
    for (int k = 0; k < 24; ++k)
      EXPECT_NEAR(at.force[k].lane(0), difference(shape.x[k]), 1e-8) << law;
    for (int k = 0; k < 9; ++k)
      EXPECT_NEAR(at.mode_force[k].lane(0), difference(shape.mode[k]), 1e-8) << law;
  }
}

TEST(Hexahedron, TangentIsDerivativeOfForceAtRelaxedParabolas) {
  Random random;
  for (const pb::ElasticLaw law : kLaws) {
    HexShape shape = make_shape(Vector3d(0.003, 0.004, 0.003), [&](const Vector3d& X) {
      return Vector3d(X + 2e-4 * Vector3d(random.next(), random.next(), random.next()));
    });
    HexTangent tangent;
    const auto relax = [&](HexShape& s) {
      std::array<Pack, 9> d;
      for (int iteration = 0; iteration < 12; ++iteration) {
        hex_tangent(law, s, tangent);
        hex_recover(tangent.inner, {}, d);
        for (int k = 0; k < 9; ++k) s.mode[k] = s.mode[k] + d[k];
      }
    };
    relax(shape);
    const HexTangent at = tangent;
    constexpr double kStep = 1e-8;  // [m]
    for (int column = 0; column < 24; ++column) {
      std::array<HexForce, 2> side;
      for (int s = 0; s < 2; ++s) {
        HexShape moved = shape;
        moved.x[column] = moved.x[column] + Pack(s == 0 ? -kStep : kStep);
        relax(moved);
        hex_force(law, moved, side[s]);
      }
      for (int row = 3 * (column / 3); row < 24; ++row) {
        const int a = row / 3;
        const int b = column / 3;
        const double expected =
            (side[1].force[row].lane(0) - side[0].force[row].lane(0)) / (2 * kStep);
        const int entry = 9 * (a * (a + 1) / 2 + b) + 3 * (row % 3) + column % 3;
        EXPECT_NEAR(at.stiffness[entry].lane(0), expected, 2e-4) << law;  // entries up to 100 N/m
      }
    }
  }
}

TEST(Hexahedron, PureBendingNeedsNoShear) {
  // A beam bent to a circle: with the parabolas one element stores exactly E I kappa^2 L / 2 at
  // nu = 0; without them it locks, here by 1 + (L / t)^2 / 2 = 33.
  const Vector3d size(0.003, 0.024, 0.003);
  constexpr double kCurvature = 1e-3;  // [1/m]: linear
  HexShape shape = make_shape(size, [&](const Vector3d& X) {
    const double z = X.z() - 0.5 * size.z();
    return Vector3d(X + Vector3d(0, -kCurvature * X.y() * z, 0.5 * kCurvature * X.y() * X.y()));
  });
  const Lame lame = make_lame(1e4, 0);
  shape.mu = Pack(lame.mu);
  shape.lambda = Pack(lame.lambda);
  HexTangent tangent;
  std::array<Pack, 9> d;
  for (int iteration = 0; iteration < 3; ++iteration) {
    hex_tangent(pb::LAW_COROTATED, shape, tangent);
    hex_recover(tangent.inner, {}, d);
    for (int k = 0; k < 9; ++k) shape.mode[k] = shape.mode[k] + d[k];
  }
  HexForce force;
  hex_force(pb::LAW_COROTATED, shape, force);
  const double exact =
      0.5 * 1e4 * size.x() * std::pow(size.z(), 3) / 12 * kCurvature * kCurvature * size.y();
  EXPECT_NEAR(force.energy.lane(0) / exact, 1, 1e-4);  // 1e-3 m^-1 over 24 mm turns by 2.4e-5
}

/// A box with a uniform deformation gradient F and modes, both of the size `strain`.
struct BowedBox {
  BowedBox(Random& random, double strain) {
    const std::array<double, 9> gradient = random_gradient(random, strain);
    F = Eigen::Map<const Eigen::Matrix3d>(gradient.data()).transpose();
    for (int a = 0; a < kHexNodes; ++a) {
      const Vector3d sign((a & 1) != 0 ? 1 : -1, (a & 2) != 0 ? 1 : -1, (a & 4) != 0 ? 1 : -1);
      x[a] = F * (0.5 * sign.cwiseProduct(size));
    }
    for (double& value : mode) value = strain * random.next();
  }
  Vector3d bow(const Vector3d& xi) const { return HexBow(size, x, mode, xi).value(); }

  Vector3d size{0.002, 0.001, 0.003};
  Eigen::Matrix3d F;
  std::array<Vector3d, 8> x;
  std::array<double, 9> mode{};
};

TEST(HexBow, AtSmallStrainItIsTheParabolaOfWilsonsModes) {
  Random random;
  const BowedBox box(random, 1e-6);
  const Vector3d xi(0.3, -0.6, 0.8);
  Vector3d wilson = Vector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    for (int j = 0; j < 3; ++j) {
      wilson[j] -= (1 - xi[k] * xi[k]) * box.mode[3 * k + j] * box.size[k] / (2 * box.size[j]);
    }
  }
  EXPECT_LT((box.bow(xi) - wilson).norm(), 1e-5 * wilson.norm());
}

TEST(HexBow, ItsStrainIsTheNearestToThatOfTheModes) {
  Random random;
  for (int sample = 0; sample < 10; ++sample) {
    const BowedBox box(random, 0.3);
    const Eigen::Matrix3d inverse = box.F.inverse();
    for (int k = 0; k < 3; ++k) {
      // Alone along xi_k: the strain is linear in it, so that of the slope at xi_k = 1 will do.
      Vector3d elsewhere = Vector3d::Ones();
      elsewhere[k] = 0;
      const Vector3d u = box.bow(elsewhere);
      Eigen::Matrix3d parabola = Eigen::Matrix3d::Zero();
      parabola.col(k) = -4 / box.size[k] * u;
      Eigen::Matrix3d modes = Eigen::Matrix3d::Zero();
      for (int j = 0; j < 3; ++j) modes(k, j) = 2 / box.size[j] * box.mode[3 * k + j];
      const Eigen::Matrix3d apart = (parabola - box.F * modes) * inverse;
      const Eigen::Matrix3d strain = 0.5 * (apart + apart.transpose());
      // The strain of every other parabola w is sym(w b^T): none of them is left in the difference.
      const Vector3d b = inverse.row(k);
      EXPECT_LT((strain * b).norm(), 1e-12 * (box.F * modes).norm() * b.norm());
    }
  }
}

TEST(HexBow, ItsRateIsItsDifference) {
  Random random;
  const BowedBox box(random, 0.3);
  const BowedBox way(random, 0.3);
  const Vector3d xi(0.3, -0.6, 0.8);
  constexpr double kStep = 1e-6;
  const auto moved = [&](double step) {
    BowedBox at = box;
    for (int a = 0; a < kHexNodes; ++a) at.x[a] += step * way.x[a];
    for (int m = 0; m < 9; ++m) at.mode[m] += step * way.mode[m];
    return at.bow(xi);
  };
  const Vector3d rate = HexBow(box.size, box.x, box.mode, xi).rate(way.x, way.mode);
  const Vector3d difference = (moved(kStep) - moved(-kStep)) / (2 * kStep);
  EXPECT_LT((rate - difference).norm(), 1e-8 * rate.norm());
}

}  // namespace
}  // namespace omentum
