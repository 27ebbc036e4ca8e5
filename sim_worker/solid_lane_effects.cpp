#include "sim_worker/solid_lane_effects.h"

#include <algorithm>
#include <cstring>

namespace omentum {
namespace {

template <typename Real>
Real real(double v) {
  return static_cast<Real>(v);
}

}  // namespace

template <typename Real>
SolidLaneEffects<Real>::SolidLaneEffects(std::shared_ptr<const SolidTissueModel> model, int lanes)
    : model_(std::move(model)), lanes_(lanes) {
  const auto W = static_cast<std::size_t>(lanes);
  values_.resize(W);
  for (auto* v : {&mu_, &lambda_, &alpha_, &bulk_, &density_}) v->assign(W, Real{0});
  args_.mu = mu_.data();
  args_.lambda = lambda_.data();
  args_.alpha = alpha_.data();
  args_.bulk = bulk_.data();
  args_.density = density_.data();
  for (int lane = 0; lane < lanes; ++lane) set(lane, model_->effects);
}

template <typename Real>
double SolidLaneEffects<Real>::stiffer(int lane) const {
  const EffectValues& v = values(lane);
  const EffectValues& scene = model_->effects;
  const auto modulus = [this](const EffectValues& e) {
    const SolidLaw law = make_solid_law(1, model_->material.poisson_ratio() + e.poisson_change);
    return (law.lambda + law.bulk + law.mu) * (1 + std::max(0.0, e.inclusion_change));
  };
  return v == scene ? 1 : std::max(1.0, modulus(v) / modulus(scene));
}

template <typename Real>
void SolidLaneEffects<Real>::set(int lane, const EffectValues& v) {
  const auto l = static_cast<std::size_t>(lane);
  values_[l] = v;
  const SolidLaw law = make_solid_law(model_->material.young_modulus_pa(),
                                      model_->material.poisson_ratio() + v.poisson_change);
  mu_[l] = real<Real>(law.mu);
  lambda_[l] = real<Real>(law.lambda);
  alpha_[l] = real<Real>(law.alpha);
  bulk_[l] = real<Real>(law.bulk);
  density_[l] = real<Real>(1 + v.density_change);
  set_map(lane);
}

/// Stiffness at the integration points, where some lane has an inclusion.
template <typename Real>
void SolidLaneEffects<Real>::set_map(int lane) {
  const bool any = std::any_of(values_.begin(), values_.end(),
                               [](const EffectValues& v) { return v.inclusion_change != 0; });
  const auto W = static_cast<std::size_t>(lanes_);
  const std::size_t tetrahedra = model_->mesh.tetrahedra.size();
  if (any && map_.empty()) map_.assign(4 * tetrahedra * W, Real{1});
  args_.map = any ? map_.data() : nullptr;
  for (std::size_t t = 0; t < tetrahedra && any; ++t) {
    for (std::size_t q = 0; q < 4; ++q) {
      const Eigen::Vector3d p_B = model_->integration_point(t, static_cast<int>(q));
      map_[(4 * t + q) * W + static_cast<std::size_t>(lane)] =
          real<Real>(values(lane).stiffness_at(p_B));
    }
  }
}

template <typename Real>
void SolidLaneEffects<Real>::reset(int) {}

template <typename Real>
void SolidLaneEffects<Real>::save(int lane, Bytes& out) const {
  const auto* bytes = reinterpret_cast<const std::byte*>(&values(lane));
  out.insert(out.end(), bytes, bytes + sizeof(EffectValues));
}

template <typename Real>
Result<std::size_t> SolidLaneEffects<Real>::read(std::span<const std::byte> state,
                                                 EffectValues& v) const {
  if (state.size() < sizeof v) return Failure{"tissue state ends in its effects"};
  std::memcpy(static_cast<void*>(&v), state.data(), sizeof v);
  if (v == EffectValues{} || !usable(v, model_->material.poisson_ratio(), {})) {
    return Failure{"tissue state holds effects out of range"};
  }
  return sizeof v;
}

template <typename Real>
void SolidLaneEffects<Real>::load(int, std::span<const std::byte>) {}

template class SolidLaneEffects<float>;
template class SolidLaneEffects<double>;

}  // namespace omentum
