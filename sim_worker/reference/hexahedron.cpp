#include "sim_worker/reference/hexahedron.h"

namespace omentum {
namespace {

constexpr int kFunctions = kHexNodes + 3;  // eight nodes, three parabolas
constexpr int kPoints = kHexPoints;
constexpr double kGauss = 0.57735026918962576451;  // 1 / sqrt(3)

using Gradients = std::array<std::array<Pack, 3>, kFunctions>;

constexpr double side(int node, int axis) { return ((node >> axis) & 1) != 0 ? 1.0 : -1.0; }

/// Gradients of the shape functions with respect to the box at a Gauss point. Parabola k varies
/// along axis k only.
void box_gradients_at(int point, const std::array<Pack, 3>& size, Gradients& g) {
  std::array<double, 3> xi{};
  std::array<Pack, 3> inverse;  // d xi / d X
  for (int axis = 0; axis < 3; ++axis) {
    xi[axis] = side(point, axis) * kGauss;
    inverse[axis] = Pack(2.0) / size[axis];
  }
  for (int a = 0; a < kHexNodes; ++a) {
    for (int axis = 0; axis < 3; ++axis) {
      double d = 0.125 * side(a, axis);
      for (int other = 0; other < 3; ++other) {
        if (other != axis) d *= 1 + side(a, other) * xi[other];
      }
      g[a][axis] = Pack(d) * inverse[axis];
    }
  }
  for (int k = 0; k < 3; ++k) {
    g[kHexNodes + k] = {};
    g[kHexNodes + k][k] = Pack(-2 * xi[k]) * inverse[k];
  }
}

void deformation_gradient(const HexShape& shape, const Gradients& g, PackTensor& F) {
  for (int i = 0; i < 3; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      Pack sum = shape.bubble[3 * axis + i] * g[kHexNodes + axis][axis];
      for (int a = 0; a < kHexNodes; ++a) sum = fma(shape.x[3 * a + i], g[a][axis], sum);
      F[3 * i + axis] = sum;
    }
  }
}

/// The same with respect to the stress-free shape. The parabolas are enhancements of the strain:
/// theirs stay those of the box.
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

Pack volume_at(const HexShape& shape, int point, Pack volume) {
  const bool mapped = shape.effects != nullptr && shape.effects->rest != nullptr;
  return mapped ? volume * shape.effects->rest->volume[point] : volume;
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

void add_bubble_force(const PackTensor& stress, const Gradients& g, Pack volume,
                      std::array<Pack, 9>& force) {
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k)
      force[3 * k + i] = fma(volume * stress[3 * i + k], g[kHexNodes + k][k], force[3 * k + i]);
  }
}

constexpr int block_index(int a, int b) { return 9 * (a * (a + 1) / 2 + b); }

using FullStiffness = std::array<Pack, 9 * kFunctions*(kFunctions + 1) / 2>;

/// K_ab += volume grad_a . A . grad_b for all a >= b; A_iJkL the tangent of the law.
void add_stiffness(const std::array<Pack, 81>& A, const Gradients& g, Pack volume,
                   FullStiffness& K) {
  for (int b = 0; b < kFunctions; ++b) {
    std::array<Pack, 27> T;  // volume A . grad_b, [iJ][k]
    for (int row = 0; row < 9; ++row) {
      for (int k = 0; k < 3; ++k) {
        const Pack* a = &A[9 * row + 3 * k];
        Pack sum;
        if (b < kHexNodes) {
          sum = fma(a[0], g[b][0], fma(a[1], g[b][1], a[2] * g[b][2]));
        } else {
          sum = a[b - kHexNodes] * g[b][b - kHexNodes];
        }
        T[3 * row + k] = volume * sum;
      }
    }
    for (int a = b; a < kFunctions; ++a) {
      Pack* block = &K[block_index(a, b)];
      const int first = a < kHexNodes ? 0 : a - kHexNodes;
      const int last = a < kHexNodes ? 2 : a - kHexNodes;
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
          Pack sum = block[3 * i + k];
          for (int axis = first; axis <= last; ++axis)
            sum = fma(g[a][axis], T[3 * (3 * i + axis) + k], sum);
          block[3 * i + k] = sum;
        }
      }
    }
  }
}

constexpr int packed(int row, int column) { return row * (row + 1) / 2 + column; }

/// Cholesky factor of the 9 x 9 block of the parabolas. A pivot that vanishes at an instability is
/// held at a small fraction of its diagonal, so that the step stays a descent direction.
void factor_inner(const FullStiffness& K, HexInner& inner) {
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c <= r; ++c) {
      Pack sum = K[block_index(kHexNodes + r / 3, kHexNodes + c / 3) + 3 * (r % 3) + c % 3];
      const Pack diagonal = sum;
      for (int m = 0; m < c; ++m)
        sum = sum - inner.factor[packed(r, m)] * inner.factor[packed(c, m)];
      inner.factor[packed(r, c)] =
          r == c ? Pack(1.0) / root(at_least(sum, at_least(Pack(1e-3) * diagonal, Pack(1e-300))))
                 : sum * inner.factor[packed(c, c)];
    }
  }
}

}  // namespace

void hex_force(pb::ElasticLaw law, const HexShape& shape, HexForce& out) {
  out = {};
  const Pack box = point_volume(shape.size);
  Gradients g;
  PackTensor F;
  ElasticResponse<Pack> response;
  for (int point = 0; point < kPoints; ++point) {
    gradients_at(shape, point, g);
    deformation_gradient(shape, g, F);
    point_response(law, shape, point, F, false, response);
    const Pack volume = volume_at(shape, point, box);
    out.energy = fma(volume, response.energy, out.energy);
    add_node_force(response.stress, g, volume, out.force);
    add_bubble_force(response.stress, g, volume, out.bubble_force);
  }
}

void hex_tangent(pb::ElasticLaw law, const HexShape& shape, HexTangent& out) {
  FullStiffness K{};
  std::array<Pack, 9> bubble_force{};
  const Pack box = point_volume(shape.size);
  Gradients g;
  PackTensor F;
  ElasticResponse<Pack> response;
  for (int point = 0; point < kPoints; ++point) {
    gradients_at(shape, point, g);
    deformation_gradient(shape, g, F);
    point_response(law, shape, point, F, true, response);
    const Pack volume = volume_at(shape, point, box);
    add_bubble_force(response.stress, g, volume, bubble_force);
    add_stiffness(response.tangent, g, volume, K);
  }

  HexInner& inner = out.inner;
  factor_inner(K, inner);
  hex_condense(bubble_force, inner);
  for (int r = 0; r < 9; ++r) {
    for (int c = 0; c < 24; ++c) {
      Pack sum = K[block_index(kHexNodes + r / 3, c / 3) + 3 * (r % 3) + c % 3];
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
          Pack sum = K[entry];
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
  Gradients g;
  PackTensor F;
  for (int point = 0; point < kPoints; ++point) {
    gradients_at(shape, point, g);
    deformation_gradient(shape, g, F);
    remember_point(law, shape, point, F, prony, memory);
  }
}

void hex_condense(const std::array<Pack, 9>& bubble_force, HexInner& inner) {
  for (int r = 0; r < 9; ++r) {
    Pack rhs = bubble_force[r];
    for (int m = 0; m < r; ++m) rhs = rhs - inner.factor[packed(r, m)] * inner.rhs[m];
    inner.rhs[r] = rhs * inner.factor[packed(r, r)];
  }
}

void hex_recover(const HexInner& inner, const std::array<Pack, 24>& dx,
                 std::array<Pack, 9>& dbubble) {
  std::array<Pack, 9> y;
  for (int r = 0; r < 9; ++r) {
    y[r] = inner.rhs[r];
    for (int c = 0; c < 24; ++c) y[r] = fma(inner.coupling[24 * r + c], dx[c], y[r]);
  }
  for (int r = 8; r >= 0; --r) {
    Pack sum = -y[r];
    for (int m = r + 1; m < 9; ++m) sum = sum - inner.factor[packed(m, r)] * dbubble[m];
    dbubble[r] = sum * inner.factor[packed(r, r)];
  }
}

}  // namespace omentum
