#include "sim_worker/reference/hexahedron.h"
#include "sim_worker/reference/tensor.h"

namespace omentum {
namespace {

/// Energy, second Piola-Kirchhoff stress S and tangent dS = identity dE + sum_k weight_k T_k (T_k :
/// dE) of an effect.
struct StrainResponse {
  Pack energy;
  PackTensor S{};
  Pack identity;
  std::array<Pack, 2> weight{};
  std::array<PackTensor, 2> direction{};
};

/// P += F S and A_iJkL += delta_ik S_JL + F_iM C_MJNL F_kN.
void add_strain_response(const PackTensor& F, const StrainResponse& r, bool want_tangent,
                         ElasticResponse<Pack>& out) {
  const PackTensor P = product(F, r.S);
  out.energy = out.energy + r.energy;
  for (int k = 0; k < 9; ++k) out.stress[k] = out.stress[k] + P[k];
  if (!want_tangent) return;
  const PackTensor first = product(F, r.direction[0]);
  const PackTensor second = product(F, r.direction[1]);
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

/// Of W(I): S = 4 W' E, dS = 4 W' dE + 16 W'' E (E : dE).
StrainResponse stiffening(const PackTensor& E, const HexEffects& fx, Pack mu) {
  StrainResponse r;
  const Pack c2 = Pack(fx.stiffening) * mu;
  const Pack invariant = Pack(2.0) * dot(E, E);
  Pack scale = Pack(8.0) * c2 * invariant;
  r.energy = c2 * invariant * invariant;
  r.weight[0] = Pack(32.0) * c2;
  if (fx.exponential > 0) {
    const Pack b(fx.exponential);
    const Exponential e = exponential(b * invariant);
    scale = fma(Pack(2.0) * mu, e.minus_one, scale);
    r.energy = fma(mu / (Pack(2.0) * b), e.excess, r.energy);
    r.weight[0] = fma(Pack(8.0) * mu * b, e.slope, r.weight[0]);
  }
  for (int k = 0; k < 9; ++k) r.S[k] = scale * E[k];
  r.identity = scale;
  r.direction[0] = E;
  return r;
}

StrainResponse fibres(const PackTensor& E, const std::array<double, 2>& a, Pack modulus) {
  constexpr double w = 1e-3;
  StrainResponse r;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) r.direction[0][3 * i + j] = Pack(a[i] * a[j]);
  }
  const Pack along = dot(r.direction[0], E);
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

/// Elastic strain of the slider.
struct Slide {
  PackTensor off;      ///< E - plastic
  Pack size, carried;  ///< |off|; fraction of it that is elastic
};

Slide slide_of(const PackTensor& E, const PackTensor& plastic, double yield) {
  Slide s;
  for (int k = 0; k < 9; ++k) s.off[k] = E[k] - plastic[k];
  s.size = root(at_least(dot(s.off, s.off), Pack(1e-30)));
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

/// Mullins softening: replaces the energy W by the integral of eta over 0 ... W for Wmax = `peak`,
/// with its derivatives. With v and s of the law (HexEffects) and q = sqrt(1 + v^2) the integral of
/// s (3 - s^2) / 2 over v is q - 1 / (2 q), its derivative 3 / (2 q^5).
void soften(Pack loss, Pack m, Pack peak, bool want_tangent, ElasticResponse<Pack>& out) {
  const Pack scale = Pack(1.0) / (m + peak);
  const Pack below = is_less(out.energy, peak);
  const Pack v = below * scale * (peak - out.energy);
  const Pack q = root(fma(v, v, Pack(1.0)));
  const Pack s = v / q;
  const Pack eta = Pack(1.0) - loss * Pack(0.5) * s * (Pack(3.0) - s * s);
  if (want_tangent) {
    const Pack q2 = q * q;
    const Pack slope = below * loss * scale * Pack(1.5) / (q2 * q2 * q);
    for (int i = 0; i < 9; ++i) {
      for (int k = 0; k < 9; ++k) {
        Pack& a = out.tangent[9 * i + k];
        a = fma(slope * out.stress[i], out.stress[k], eta * a);
      }
    }
  }
  for (Pack& p : out.stress) p = eta * p;
  const auto integral = [](Pack root) { return root - Pack(0.5) / root; };
  const Pack end = scale * peak;
  const Pack whole = integral(root(fma(end, end, Pack(1.0))));
  out.energy = out.energy - loss / scale * (whole - integral(q));
}

/// S = F^-1 P.
PackTensor pulled_back(const PackTensor& F, const PackTensor& P) {
  const PackTensor cofactors = cofactor(F);  // F^-1 = cofactors^T / det
  const Pack scale = Pack(1.0) / determinant(F, cofactors);
  PackTensor S = product_transposed(cofactors, P);
  for (Pack& s : S) s = scale * s;
  return S;
}

/// Adds the elastic effects, whose stress drives the Prony branches. Returns the energy of law and
/// stiffening without softening.
Pack add_elastic_effects(const HexShape& shape, int point, const PackTensor& F, const PackTensor& E,
                         bool want_tangent, ElasticResponse<Pack>& out) {
  const HexEffects& fx = *shape.effects;
  if (fx.stiffening != 0 || fx.exponential > 0)
    add_strain_response(F, stiffening(E, fx, shape.mu), want_tangent, out);
  const Pack energy = out.energy;
  if (fx.softening > 0) {
    soften(Pack(fx.softening), Pack(fx.softening_energy) * shape.mu,
           fx.memory->energy_peak[point] * shape.mu, want_tangent, out);
  }
  if (fx.fibre > 0)
    add_strain_response(F, fibres(E, fx.axis, Pack(fx.fibre) * shape.mu), want_tangent, out);
  return energy;
}

}  // namespace

void point_response(pb::ElasticLaw law, const HexShape& shape, int point, const PackTensor& F,
                    bool want_tangent, ElasticResponse<Pack>& out) {
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
    bias.energy = dot(bias.S, E);
    add_strain_response(F, bias, want_tangent, out);
  }
  if (fx.slider > 0) {
    add_strain_response(F,
                        slider(E, fx.memory->plastic[point], Pack(fx.slider) * shape.mu, fx.yield),
                        want_tangent, out);
  }
}

void remember_point(pb::ElasticLaw law, const HexShape& shape, int point, const PackTensor& F,
                    const PronyStep& prony, HexMemory& memory) {
  const HexEffects& fx = *shape.effects;
  const PackTensor E = green_strain(F);
  if (fx.slider > 0) {
    const Slide s = slide_of(E, memory.plastic[point], fx.yield);
    for (int k = 0; k < 9; ++k) memory.plastic[point][k] = E[k] - s.carried * s.off[k];
  }
  if (!fx.branches && !(fx.softening > 0)) return;
  ElasticResponse<Pack> response;
  elastic_response(law, F, shape.mu, shape.lambda, false, response);
  const Pack energy = add_elastic_effects(shape, point, F, E, false, response);
  if (fx.softening > 0)
    memory.energy_peak[point] = at_least(memory.energy_peak[point], energy / shape.mu);
  if (!fx.branches) return;
  const PackTensor S = pulled_back(F, response.stress);
  for (int b = 0; b < prony.branches; ++b) {
    PackTensor& branch = memory.branch[b][point];
    for (int k = 0; k < 9; ++k) {
      branch[k] =
          fma(Pack(prony.gain[b]), S[k] - memory.stress[point][k], Pack(prony.keep[b]) * branch[k]);
    }
  }
  memory.stress[point] = S;
}

}  // namespace omentum
