#include "sim_worker/reference/hexahedron.h"

#include "sim_worker/reference/tensor.h"

namespace omentum {
namespace {

constexpr int kPoints = kHexPoints;
constexpr double kGauss = 0.57735026918962576451;  // 1 / sqrt(3)

/// Of the shape functions of the nodes.
using Gradients = std::array<std::array<Pack, 3>, kHexNodes>;

constexpr double side(int node, int axis) { return ((node >> axis) & 1) != 0 ? 1.0 : -1.0; }

/// Gradients with respect to the box at a Gauss point.
void box_gradients_at(int point, const std::array<Pack, 3>& size, Gradients& g) {
  for (int a = 0; a < kHexNodes; ++a) {
    for (int axis = 0; axis < 3; ++axis) {
      double d = 0.125 * side(a, axis);
      for (int other = 0; other < 3; ++other) {
        if (other != axis) d *= 1 + side(a, other) * side(point, other) * kGauss;
      }
      g[a][axis] = Pack(2 * d) / size[axis];
    }
  }
}

/// The same with respect to the stress-free shape.
void gradients_at(const HexShape& shape, int point, Gradients& g) {
  box_gradients_at(point, shape.size, g);
  if (shape.effects == nullptr || shape.effects->rest == nullptr) return;
  const std::array<Pack, 9>& map = shape.effects->rest->map[point];
  for (int a = 0; a < kHexNodes; ++a) {
    const std::array<Pack, 3> box = g[a];
    for (int axis = 0; axis < 3; ++axis)
      g[a][axis] = fma(box[0], map[axis], fma(box[1], map[3 + axis], box[2] * map[6 + axis]));
  }
}

/// sum_a x_a grad_a^T.
PackTensor gradient_of(const std::array<Pack, 24>& x, const Gradients& g) {
  PackTensor F;
  for (int i = 0; i < 3; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      Pack sum = x[i] * g[0][axis];
      for (int a = 1; a < kHexNodes; ++a) sum = fma(x[3 * a + i], g[a][axis], sum);
      F[3 * i + axis] = sum;
    }
  }
  return F;
}

/// Kinematics of the element: F is linear in the nodes while the modes stay,
/// F = sum_a x_a (grad_a + G^T mean_a)^T.
struct Kinematics {
  std::array<Gradients, kPoints> gradient;  ///< of the nodes
  Gradients mean;                           ///< over the Gauss points
  PackTensor F0;                            ///< mean deformation gradient
  std::array<Pack, 9> scaled;               ///< G_iJ / xi_i
  std::array<Pack, 3> inverse;              ///< 2 / size
};

Kinematics make_kinematics(const HexShape& shape) {
  Kinematics k;
  for (int point = 0; point < kPoints; ++point) gradients_at(shape, point, k.gradient[point]);
  for (int a = 0; a < kHexNodes; ++a) {
    for (int axis = 0; axis < 3; ++axis) {
      Pack sum;
      for (const Gradients& g : k.gradient) sum = sum + g[a][axis];
      k.mean[a][axis] = Pack(1.0 / kPoints) * sum;
    }
  }
  k.F0 = gradient_of(shape.x, k.mean);
  for (int axis = 0; axis < 3; ++axis) k.inverse[axis] = Pack(2.0) / shape.size[axis];
  for (int m = 0; m < 9; ++m) k.scaled[m] = shape.mode[m] * k.inverse[m % 3];
  return k;
}

/// Local coordinate of a Gauss point.
constexpr double xi_at(int point, int axis) { return side(point, axis) * kGauss; }

/// grad_a + G^T mean_a at a Gauss point.
void enhanced_gradients(const Kinematics& k, int point, Gradients& g) {
  g = k.gradient[point];
  for (int a = 0; a < kHexNodes; ++a) {
    for (int i = 0; i < 3; ++i) {
      const Pack part = Pack(xi_at(point, i)) * k.mean[a][i];
      for (int axis = 0; axis < 3; ++axis)
        g[a][axis] = fma(part, k.scaled[3 * i + axis], g[a][axis]);
    }
  }
}

/// What the energy per volume at a point counts for: its volume at rest, times its stiffness.
Pack volume_at(const HexShape& shape, int point, Pack volume) {
  const bool mapped = shape.effects != nullptr && shape.effects->rest != nullptr;
  const Pack own = mapped ? volume * shape.effects->rest->volume[point] : volume;
  return shape.stiffness == nullptr ? own : own * (*shape.stiffness)[point];
}

Pack point_volume(const std::array<Pack, 3>& size) {
  return Pack(1.0 / kPoints) * size[0] * size[1] * size[2];
}

void add_node_force(const PackTensor& stress, const Gradients& g, Pack volume,
                    std::array<Pack, 24>& force) {
  for (int i = 0; i < 3; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const Pack P = volume * stress[3 * i + axis];
      for (int a = 0; a < kHexNodes; ++a) force[3 * a + i] = fma(P, g[a][axis], force[3 * a + i]);
    }
  }
}

/// d energy / d mode_iJ = volume xi_i 2 / size_J (F0^T P)_iJ.
void add_mode_force(const PackTensor& stress, const Kinematics& k, int point, Pack volume,
                    std::array<Pack, 9>& force) {
  const PackTensor pulled = product_transposed(k.F0, stress);
  for (int m = 0; m < 9; ++m) {
    const Pack scale = volume * Pack(xi_at(point, m / 3)) * k.inverse[m % 3];
    force[m] = fma(scale, pulled[m], force[m]);
  }
}

constexpr int block_index(int a, int b) { return 9 * (a * (a + 1) / 2 + b); }
constexpr int packed(int row, int column) { return row * (row + 1) / 2 + column; }

/// Second derivative by nodes and modes.
struct FullStiffness {
  std::array<Pack, 324> nodes{};  ///< as HexTangent::stiffness
  std::array<Pack, 216> mixed{};  ///< [mode][node, xyz]
  std::array<Pack, 45> modes{};   ///< lower triangle, row by row
};

/// Nodes: volume grad_a . A . grad_b for all a >= b; A_iJkL the tangent of the law.
void add_node_stiffness(const std::array<Pack, 81>& A, const Gradients& g, Pack volume,
                        std::array<Pack, 324>& K) {
  for (int b = 0; b < kHexNodes; ++b) {
    std::array<Pack, 27> T;  // volume A . grad_b, [iJ][k]
    for (int row = 0; row < 9; ++row) {
      for (int k = 0; k < 3; ++k) {
        const Pack* a = &A[9 * row + 3 * k];
        T[3 * row + k] = volume * fma(a[0], g[b][0], fma(a[1], g[b][1], a[2] * g[b][2]));
      }
    }
    for (int a = b; a < kHexNodes; ++a) {
      Pack* block = &K[block_index(a, b)];
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
          Pack sum = block[3 * i + k];
          for (int axis = 0; axis < 3; ++axis)
            sum = fma(g[a][axis], T[3 * (3 * i + axis) + k], sum);
          block[3 * i + k] = sum;
        }
      }
    }
  }
}

/// Modes with nodes and with each other. A change of mode iJ changes F by xi_i 2 / size_J f_i e_J^T
/// with f_i column i of F0; what it does to F0 itself adds the stress to the mixed part.
void add_mode_stiffness(const std::array<Pack, 81>& A, const PackTensor& stress,
                        const Kinematics& kin, const Gradients& g, int point, Pack volume,
                        FullStiffness& K) {
  for (int i = 0; i < 3; ++i) {
    for (int J = 0; J < 3; ++J) {
      const int m = 3 * i + J;
      const Pack scale = volume * Pack(xi_at(point, i)) * kin.inverse[J];
      std::array<Pack, 9> row;  // scale f_i . A_J
      for (int kL = 0; kL < 9; ++kL) {
        row[kL] = scale *
                  fma(kin.F0[i], A[9 * J + kL],
                      fma(kin.F0[3 + i], A[9 * (3 + J) + kL], kin.F0[6 + i] * A[9 * (6 + J) + kL]));
      }
      for (int a = 0; a < kHexNodes; ++a) {
        const Pack geometric = scale * kin.mean[a][i];
        for (int k = 0; k < 3; ++k) {
          Pack& entry = K.mixed[24 * m + 3 * a + k];
          entry = fma(geometric, stress[3 * k + J], entry);
          for (int L = 0; L < 3; ++L) entry = fma(row[3 * k + L], g[a][L], entry);
        }
      }
      for (int n = 0; n <= m; ++n) {
        const int other = n / 3;
        const int L = n % 3;
        const Pack along = fma(row[L], kin.F0[other],
                               fma(row[3 + L], kin.F0[3 + other], row[6 + L] * kin.F0[6 + other]));
        Pack& entry = K.modes[packed(m, n)];
        entry = fma(Pack(xi_at(point, other)) * kin.inverse[L], along, entry);
      }
    }
  }
}

/// Cholesky factor of the 9 x 9 block of the modes. In a crushed element it may not be positive
/// definite: pivots then count with their size, so that the step stays a descent direction.
/// (Held at a small fraction of its diagonal, one makes the next ones larger still.)
void factor_inner(const std::array<Pack, 45>& K, HexInner& inner) {
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c <= r; ++c) {
      Pack sum = K[packed(r, c)];
      for (int m = 0; m < c; ++m)
        sum = sum - inner.factor[packed(r, m)] * inner.factor[packed(c, m)];
      inner.factor[packed(r, c)] = r == c ? Pack(1.0) / root(at_least(size(sum), Pack(1e-300)))
                                          : sum * inner.factor[packed(c, c)];
    }
  }
}

}  // namespace

namespace {

/// Adds what each Gauss point does to the force that `out_of` names for it.
template <typename Function>
void add_point_forces(pb::ElasticLaw law, const HexShape& shape, Function&& out_of) {
  const Pack box = point_volume(shape.size);
  const Kinematics kinematics = make_kinematics(shape);
  Gradients g;
  ElasticResponse<Pack> response;
  for (int point = 0; point < kPoints; ++point) {
    HexForce& out = out_of(point);
    enhanced_gradients(kinematics, point, g);
    point_response(law, shape, point, gradient_of(shape.x, g), false, response);
    const Pack volume = volume_at(shape, point, box);
    out.energy = fma(volume, response.energy, out.energy);
    add_node_force(response.stress, g, volume, out.force);
    add_mode_force(response.stress, kinematics, point, volume, out.mode_force);
  }
}

}  // namespace

void hex_force(pb::ElasticLaw law, const HexShape& shape, HexForce& out) {
  out = {};
  add_point_forces(law, shape, [&](int) -> HexForce& { return out; });
}

void hex_point_forces(pb::ElasticLaw law, const HexShape& shape,
                      std::array<HexForce, kHexPoints>& out) {
  out = {};
  add_point_forces(law, shape, [&](int point) -> HexForce& { return out[point]; });
}

void hex_tangent(pb::ElasticLaw law, const HexShape& shape, HexTangent& out) {
  FullStiffness K;
  std::array<Pack, 9> mode_force{};
  const Pack box = point_volume(shape.size);
  const Kinematics kinematics = make_kinematics(shape);
  Gradients g;
  ElasticResponse<Pack> response;
  for (int point = 0; point < kPoints; ++point) {
    enhanced_gradients(kinematics, point, g);
    point_response(law, shape, point, gradient_of(shape.x, g), true, response);
    const Pack volume = volume_at(shape, point, box);
    add_mode_force(response.stress, kinematics, point, volume, mode_force);
    add_node_stiffness(response.tangent, g, volume, K.nodes);
    add_mode_stiffness(response.tangent, response.stress, kinematics, g, point, volume, K);
  }

  HexInner& inner = out.inner;
  factor_inner(K.modes, inner);
  hex_condense(mode_force, inner);
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c < 24; ++c) {
      Pack sum = K.mixed[24 * r + c];
      for (int m = 0; m < r; ++m)
        sum = sum - inner.factor[packed(r, m)] * inner.coupling[24 * m + c];
      inner.coupling[24 * r + c] = sum * inner.factor[packed(r, r)];
    }
  }
  for (int a = 0; a < kHexNodes; ++a) {
    for (int b = 0; b <= a; ++b) {
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
          const int entry = block_index(a, b) + 3 * i + k;
          Pack sum = K.nodes[entry];
          for (int r = 0; r < 9; ++r) {
            sum = sum - inner.coupling[24 * r + 3 * a + i] * inner.coupling[24 * r + 3 * b + k];
          }
          out.stiffness[entry] = sum;
        }
      }
    }
  }
}

void hex_remember(pb::ElasticLaw law, const HexShape& shape, const PronyStep& prony,
                  HexMemory& memory) {
  const Kinematics kinematics = make_kinematics(shape);
  Gradients g;
  for (int point = 0; point < kPoints; ++point) {
    enhanced_gradients(kinematics, point, g);
    remember_point(law, shape, point, gradient_of(shape.x, g), prony, memory);
  }
}

void hex_condense(const std::array<Pack, 9>& mode_force, HexInner& inner) {
  for (int r = 0; r < 9; ++r) {
    Pack rhs = mode_force[r];
    for (int m = 0; m < r; ++m) rhs = rhs - inner.factor[packed(r, m)] * inner.rhs[m];
    inner.rhs[r] = rhs * inner.factor[packed(r, r)];
  }
}

void hex_condense(const HexInner& inner, int lane, Eigen::Ref<Eigen::MatrixXd> mode_loads,
                  Eigen::MatrixXd& node_loads) {
  Eigen::Matrix<double, 9, 24> coupling;
  for (int r = 0; r < 9; ++r) {
    for (int m = 0; m < r; ++m)
      mode_loads.row(r) -= inner.factor[packed(r, m)].lane(lane) * mode_loads.row(m);
    mode_loads.row(r) *= inner.factor[packed(r, r)].lane(lane);
    for (int row = 0; row < 24; ++row) coupling(r, row) = inner.coupling[24 * r + row].lane(lane);
  }
  node_loads.noalias() = -coupling.transpose() * mode_loads;
}

void hex_recover(const HexInner& inner, const std::array<Pack, 24>& dx,
                 std::array<Pack, 9>& dmode) {
  std::array<Pack, 9> y;
  for (int r = 0; r < 9; ++r) {
    y[r] = inner.rhs[r];
    for (int c = 0; c < 24; ++c) y[r] = fma(inner.coupling[24 * r + c], dx[c], y[r]);
  }
  for (int r = 8; r >= 0; --r) {
    Pack sum = -y[r];
    for (int m = r + 1; m < 9; ++m) sum = sum - inner.factor[packed(m, r)] * dmode[m];
    dmode[r] = sum * inner.factor[packed(r, r)];
  }
}

}  // namespace omentum
