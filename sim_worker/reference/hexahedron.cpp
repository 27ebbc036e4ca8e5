#include "sim_worker/reference/hexahedron.h"

namespace omentum {
namespace {

constexpr int kFunctions = kHexNodes + 3;  // eight nodes, three parabolas
constexpr int kPoints = kHexPoints;
constexpr double kGauss = 0.57735026918962576451;  // 1 / sqrt(3)

using Gradients = std::array<std::array<Pack, 3>, kFunctions>;

constexpr double side(int node, int axis) { return ((node >> axis) & 1) != 0 ? 1.0 : -1.0; }

/// Gradients of the shape functions with respect to the rest position at a Gauss point. Parabola k
/// varies along axis k only.
void gradients_at(int point, const std::array<Pack, 3>& size, Gradients& g) {
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

void deformation_gradient(const HexShape& shape, const Gradients& g, std::array<Pack, 9>& F) {
  for (int i = 0; i < 3; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      Pack sum = shape.bubble[3 * axis + i] * g[kHexNodes + axis][axis];
      for (int a = 0; a < kHexNodes; ++a) sum = fma(shape.x[3 * a + i], g[a][axis], sum);
      F[3 * i + axis] = sum;
    }
  }
}

/// Gradients with respect to the stress-free shape. The parabolas are enhancements of the strain:
/// theirs stay those of the box.
void map_gradients(const HexShape& shape, int point, Gradients& g) {
  if (shape.effects == nullptr || shape.effects->rest == nullptr) return;
  const std::array<Pack, 9>& map = shape.effects->rest->map[point];
  for (int a = 0; a < kHexNodes; ++a) {
    const std::array<Pack, 3> box = g[a];
    for (int axis = 0; axis < 3; ++axis)
      g[a][axis] = fma(box[0], map[axis], fma(box[1], map[3 + axis], box[2] * map[6 + axis]));
  }
}

PackTensor green_strain(const std::array<Pack, 9>& F) {
  PackTensor E;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const Pack c = fma(F[i], F[j], fma(F[3 + i], F[3 + j], F[6 + i] * F[6 + j]));
      E[3 * i + j] = Pack(0.5) * (i == j ? c - Pack(1.0) : c);
    }
  }
  return E;
}

Pack inner(const PackTensor& a, const PackTensor& b) {
  Pack sum = a[0] * b[0];
  for (int k = 1; k < 9; ++k) sum = fma(a[k], b[k], sum);
  return sum;
}

/// Stress S, energy and tangent dS = identity dE + sum_k weight_k T_k (T_k : dE) of an effect.
struct StrainResponse {
  Pack energy;
  PackTensor S{};
  Pack identity;
  std::array<Pack, 2> weight{};
  std::array<PackTensor, 2> direction{};
};

/// P += F S and A_iJkL += delta_ik S_JL + F_iM C_MJNL F_kN.
void add_strain_response(const std::array<Pack, 9>& F, const StrainResponse& r, bool want_tangent,
                         ElasticResponse<Pack>& out) {
  const auto product = [&F](const PackTensor& S) {  // F S
    std::array<Pack, 9> P;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j)
        P[3 * i + j] = fma(F[3 * i], S[j], fma(F[3 * i + 1], S[3 + j], F[3 * i + 2] * S[6 + j]));
    }
    return P;
  };
  const std::array<Pack, 9> P = product(r.S);
  out.energy = out.energy + r.energy;
  for (int k = 0; k < 9; ++k) out.stress[k] = out.stress[k] + P[k];
  if (!want_tangent) return;
  const std::array<Pack, 9> first = product(r.direction[0]);
  const std::array<Pack, 9> second = product(r.direction[1]);
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      const Pack left =
          fma(F[3 * i], F[3 * k], fma(F[3 * i + 1], F[3 * k + 1], F[3 * i + 2] * F[3 * k + 2]));
      for (int j = 0; j < 3; ++j) {
        for (int l = 0; l < 3; ++l) {
          const int iJ = 3 * i + j;
          const int kL = 3 * k + l;
          Pack value =
              fma(r.weight[0] * first[iJ], first[kL], r.weight[1] * second[iJ] * second[kL]);
          // Symmetric identity: (delta_MN delta_JL + delta_ML delta_JN) / 2.
          Pack half = F[3 * i + l] * F[3 * k + j];
          if (j == l) half = half + left;
          value = fma(Pack(0.5) * r.identity, half, value);
          if (i == k) value = value + r.S[3 * j + l];
          out.tangent[9 * iJ + kL] = out.tangent[9 * iJ + kL] + value;
        }
      }
    }
  }
}

StrainResponse stiffening(const PackTensor& E, Pack c2) {
  StrainResponse r;
  const Pack invariant = Pack(2.0) * inner(E, E);
  const Pack scale = Pack(8.0) * c2 * invariant;
  r.energy = c2 * invariant * invariant;
  for (int k = 0; k < 9; ++k) r.S[k] = scale * E[k];
  r.identity = scale;
  r.weight[0] = Pack(32.0) * c2;
  r.direction[0] = E;
  return r;
}

StrainResponse fibres(const PackTensor& E, const std::array<double, 2>& a, Pack modulus) {
  constexpr double w = 1e-3;
  StrainResponse r;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) r.direction[0][3 * i + j] = Pack(a[i] * a[j]);
  }
  const Pack along = inner(r.direction[0], E);
  const Pack smooth = root(fma(along, along, Pack(w * w)));
  const Pack taut = Pack(0.5) * (along + smooth - Pack(w));
  // Integral of taut; (along + smooth) / w > 0.
  r.energy = modulus * Pack(0.25) *
             (along * (along + smooth) + Pack(w * w) * logarithm((along + smooth) / Pack(w)) -
              Pack(2 * w) * along);
  for (int k = 0; k < 9; ++k) r.S[k] = modulus * taut * r.direction[0][k];
  r.weight[0] = modulus * Pack(0.5) * (Pack(1.0) + along / smooth);
  return r;
}

/// Strain that the slider's spring carries, and how the sliding strain is directed.
struct Slide {
  PackTensor off;      ///< E - plastic
  Pack size, carried;  ///< |off|; share of it that is carried
};

Slide slide_of(const PackTensor& E, const PackTensor& plastic, double yield) {
  Slide s;
  for (int k = 0; k < 9; ++k) s.off[k] = E[k] - plastic[k];
  s.size = root(at_least(inner(s.off, s.off), Pack(1e-30)));
  s.carried = -at_least(-(Pack(yield) / s.size), Pack(-1.0));
  return s;
}

StrainResponse slider(const PackTensor& E, const PackTensor& plastic, Pack modulus, double yield) {
  StrainResponse r;
  const Slide s = slide_of(E, plastic, yield);
  const Pack held = s.carried * s.size;  // min(size, yield)
  r.energy = modulus * held * (s.size - Pack(0.5) * held);
  for (int k = 0; k < 9; ++k) r.S[k] = modulus * s.carried * s.off[k];
  r.identity = modulus * s.carried;
  const Pack slides = is_less(Pack(yield), s.size);
  r.weight[0] = -(slides * modulus * s.carried) / (s.size * s.size);
  r.direction[0] = s.off;
  return r;
}

/// Energy that a point of energy W gives back, the integral of eta over 0 ... W for Wmax = `peak`,
/// with its derivatives. With v and s of the law (HexEffects) and q = sqrt(1 + v^2) the integral of
/// s (3 - s^2) / 2 over v is q - 1 / (2 q), its derivative 3 / (2 q^5).
void soften(Pack share, Pack m, Pack peak, bool want_tangent, ElasticResponse<Pack>& out) {
  const Pack scale = Pack(1.0) / (m + peak);
  const Pack below = is_less(out.energy, peak);
  const Pack v = below * scale * (peak - out.energy);
  const Pack q = root(fma(v, v, Pack(1.0)));
  const Pack s = v / q;
  const Pack left = Pack(1.0) - share * Pack(0.5) * s * (Pack(3.0) - s * s);
  if (want_tangent) {
    const Pack q2 = q * q;
    const Pack slope = below * share * scale * Pack(1.5) / (q2 * q2 * q);
    for (int i = 0; i < 9; ++i) {
      for (int k = 0; k < 9; ++k) {
        Pack& a = out.tangent[9 * i + k];
        a = fma(slope * out.stress[i], out.stress[k], left * a);
      }
    }
  }
  for (Pack& p : out.stress) p = left * p;
  const auto integral = [](Pack root) { return root - Pack(0.5) / root; };
  const Pack end = scale * peak;
  const Pack whole = integral(root(fma(end, end, Pack(1.0))));
  out.energy = out.energy - share / scale * (whole - integral(q));
}

/// Elastic part of the effects, of which the branches remember the history. Returns the energy of
/// law and stiffening as if nothing were softened.
Pack add_elastic_effects(const HexShape& shape, int point, const std::array<Pack, 9>& F,
                         const PackTensor& E, bool want_tangent, ElasticResponse<Pack>& out) {
  const HexEffects& fx = *shape.effects;
  if (fx.stiffening != 0)
    add_strain_response(F, stiffening(E, Pack(fx.stiffening) * shape.mu), want_tangent, out);
  const Pack energy = out.energy;
  if (fx.softening > 0) {
    soften(Pack(fx.softening), Pack(fx.softening_energy) * shape.mu,
           fx.memory->energy_peak[point] * shape.mu, want_tangent, out);
  }
  if (fx.fibre > 0)
    add_strain_response(F, fibres(E, fx.axis, Pack(fx.fibre) * shape.mu), want_tangent, out);
  return energy;
}

/// Answer of material and effects to F at a Gauss point.
void point_response(pb::ElasticLaw law, const HexShape& shape, int point,
                    const std::array<Pack, 9>& F, bool want_tangent, ElasticResponse<Pack>& out) {
  elastic_response(law, F, shape.mu, shape.lambda, want_tangent, out);
  if (shape.effects == nullptr) return;
  const HexEffects& fx = *shape.effects;
  const PackTensor E = green_strain(F);
  add_elastic_effects(shape, point, F, E, want_tangent, out);
  if (fx.branches) {
    const Pack more(1 + fx.gains);
    out.energy = more * out.energy;
    for (Pack& p : out.stress) p = more * p;
    if (want_tangent) {
      for (Pack& a : out.tangent) a = more * a;
    }
    StrainResponse bias;
    bias.S = fx.memory->bias[point];
    bias.energy = inner(bias.S, E);
    add_strain_response(F, bias, want_tangent, out);
  }
  if (fx.slider > 0) {
    add_strain_response(F,
                        slider(E, fx.memory->plastic[point], Pack(fx.slider) * shape.mu, fx.yield),
                        want_tangent, out);
  }
}

/// S = F^-1 P.
PackTensor pulled_back(const std::array<Pack, 9>& F, const std::array<Pack, 9>& P) {
  std::array<Pack, 9> cofactor;  // F^-1 = cofactor^T / det
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const int a = 3 * ((i + 1) % 3);
      const int b = 3 * ((i + 2) % 3);
      cofactor[3 * i + j] =
          F[a + (j + 1) % 3] * F[b + (j + 2) % 3] - F[a + (j + 2) % 3] * F[b + (j + 1) % 3];
    }
  }
  const Pack scale = Pack(1.0) / fma(F[0], cofactor[0], fma(F[1], cofactor[1], F[2] * cofactor[2]));
  PackTensor S;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      S[3 * i + j] = scale * fma(cofactor[i], P[j],
                                 fma(cofactor[3 + i], P[3 + j], cofactor[6 + i] * P[6 + j]));
    }
  }
  return S;
}

Pack volume_at(const HexShape& shape, int point, Pack volume) {
  const bool mapped = shape.effects != nullptr && shape.effects->rest != nullptr;
  return mapped ? volume * shape.effects->rest->volume[point] : volume;
}

Pack point_volume(const std::array<Pack, 3>& size) {
  return Pack(1.0 / kPoints) * size[0] * size[1] * size[2];
}

void add_node_force(const std::array<Pack, 9>& stress, const Gradients& g, Pack volume,
                    std::array<Pack, 24>& force) {
  for (int i = 0; i < 3; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const Pack P = volume * stress[3 * i + axis];
      for (int a = 0; a < kHexNodes; ++a) force[3 * a + i] = fma(P, g[a][axis], force[3 * a + i]);
    }
  }
}

void add_bubble_force(const std::array<Pack, 9>& stress, const Gradients& g, Pack volume,
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

/// Cholesky factor of the 9 x 9 block of the parabolas. A pivot that is lost to instability is held
/// at a small share of its diagonal: the step stays a descent direction.
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
  std::array<Pack, 9> F;
  ElasticResponse<Pack> response;
  for (int point = 0; point < kPoints; ++point) {
    gradients_at(point, shape.size, g);
    map_gradients(shape, point, g);
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
  std::array<Pack, 9> F;
  ElasticResponse<Pack> response;
  for (int point = 0; point < kPoints; ++point) {
    gradients_at(point, shape.size, g);
    map_gradients(shape, point, g);
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
  const HexEffects& fx = *shape.effects;
  Gradients g;
  std::array<Pack, 9> F;
  ElasticResponse<Pack> response;
  for (int point = 0; point < kPoints; ++point) {
    gradients_at(point, shape.size, g);
    map_gradients(shape, point, g);
    deformation_gradient(shape, g, F);
    const PackTensor E = green_strain(F);
    if (fx.slider > 0) {
      const Slide s = slide_of(E, memory.plastic[point], fx.yield);
      for (int k = 0; k < 9; ++k) memory.plastic[point][k] = E[k] - s.carried * s.off[k];
    }
    if (!fx.branches && !(fx.softening > 0)) continue;
    elastic_response(law, F, shape.mu, shape.lambda, false, response);
    const Pack energy = add_elastic_effects(shape, point, F, E, false, response);
    if (fx.softening > 0)
      memory.energy_peak[point] = at_least(memory.energy_peak[point], energy / shape.mu);
    if (!fx.branches) continue;
    const PackTensor S = pulled_back(F, response.stress);
    for (std::size_t b = 0; b < static_cast<std::size_t>(prony.branches); ++b) {
      for (int k = 0; k < 9; ++k) {
        Pack& memory_k = memory.branch[b][point][k];
        memory_k = fma(Pack(prony.gain[b]), S[k] - memory.stress[point][k],
                       Pack(prony.keep[b]) * memory_k);
      }
    }
    memory.stress[point] = S;
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
