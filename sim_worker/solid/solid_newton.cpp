// The elastic solid: Newton's method with conjugate gradients on all lanes (docs/decisions/0018).
#include <algorithm>

#include "sim_worker/solid/solid_tissue.h"

namespace omentum {
namespace {

constexpr int kMaxConjugateSteps = 40;
// Of the residual in the norm of the preconditioner, within a Newton step and over the substep:
// what is left is done by the next substep, which starts from it.
constexpr double kReduction = 0.01;
constexpr double kNewtonReduction = 1e-5;
constexpr int kMaxNewtonSteps = 16;
constexpr int kMaxHalvings = 10;

}  // namespace

/// z = A^-1 b on the free nodes.
template <typename Real>
void SolidTissue<Real>::precondition() {
  z_ = b_;
  if (model_->by_component) {
    kernel_.solve_scalars(factor_.args(), z_.data());
  } else {
    kernel_.solve_vectors(factor_.args(), z_.data());
  }
  solid_.keep_free(args_, z_.data());
}

/// b, z = A^-1 b and their product, the square of the residual in the norm of the preconditioner.
template <typename Real>
void SolidTissue<Real>::find_residual(PerLane& size) {
  solid_.find_residual(args_);
  gather_residual();
  solid_.keep_free(args_, b_.data());
  precondition();
  solid_.dot(args_, b_.data(), z_.data(), size.data());
}

/// hp = Hessian times p.
template <typename Real>
void SolidTissue<Real>::multiply_hessian() {
  follow_leaders(p_);
  solid_.multiply_hessian(args_);
  gather_product();
  solid_.keep_free(args_, hp_.data());
}

// Newton steps until the residual is small, in every lane on its own; a step that makes it larger
// is halved. Most substeps take two, an impact ten. The tolerance is set by
// the residual at the first call in a substep.
template <typename Real>
void SolidTissue<Real>::solve_lanes(std::uint32_t active) {
  const auto W = static_cast<std::size_t>(lanes());
  PerLane size{};
  PerLane size_new{};
  PerLane step_length{};
  find_residual(size);
  for (std::size_t l = 0; l < W; ++l) {
    if (enough_[l] >= Real{0}) continue;
    enough_[l] =
        std::max(static_cast<Real>(kNewtonReduction * kNewtonReduction) * size[l], rest_energy_[l]);
  }
  for (int k = 0; k < kMaxNewtonSteps; ++k) {
    std::uint32_t moves = 0;
    for (std::size_t l = 0; l < W; ++l) {
      if (size[l] > enough_[l]) moves |= active & 1U << l;
    }
    if (moves == 0) return;
    find_newton_step(size, moves);
    step_length.fill(Real{-1});
    std::uint32_t worse = moves;
    for (int halving = 0; worse != 0 && halving <= kMaxHalvings; ++halving) {
      solid_.add_scaled(args_, d_.data(), step_.data(), step_length.data(), worse);
      find_residual(size_new);
      for (std::size_t l = 0; l < W; ++l) {
        // Written so that a residual that is no number counts as worse.
        if (size_new[l] <= size[l]) worse &= ~(1U << l);
      }
      step_length.fill(halving == 0 ? Real{0.5} : step_length[0] / 2);
    }
    size = size_new;
  }
}

template <typename Real>
void SolidTissue<Real>::response(const Real* force, Real* work, Real* cross) {
  std::copy_n(force, b_.size(), b_.data());
  solid_.keep_free(args_, b_.data());
  precondition();
  follow_leaders(z_);
  PerLane product{};
  solid_.dot(args_, force, z_.data(), product.data());
  std::copy_n(product.begin(), lanes(), work);
  solid_.dot(args_, force, p_.data(), product.data());
  std::copy_n(product.begin(), lanes(), cross);
}

template <typename Real>
void SolidTissue<Real>::take_response(const Real* beta, const Real* step_length,
                                      std::uint32_t active) {
  solid_.advance_direction(args_, beta);
  solid_.add_scaled(args_, d_.data(), p_.data(), step_length, active);
}

// step = H^-1 b by conjugate gradients, from the residual b with z = A^-1 b and its square `rz`. A
// lane takes part until its residual is small or its Hessian not positive along the direction; what
// the others do then leaves its bits alone.
template <typename Real>
void SolidTissue<Real>::find_newton_step(PerLane rz, std::uint32_t active) {
  const auto W = static_cast<std::size_t>(lanes());
  PerLane rz_new{};
  PerLane php{};
  PerLane factor{};
  PerLane enough{};
  for (std::size_t l = 0; l < W; ++l) {
    enough[l] = static_cast<Real>(kReduction * kReduction) * rz[l];
  }
  p_ = z_;
  step_.fill(Real{0});
  for (int k = 0; k < kMaxConjugateSteps && active != 0; ++k) {
    multiply_hessian();
    solid_.dot(args_, p_.data(), hp_.data(), php.data());
    std::uint32_t moves = 0;
    for (std::size_t l = 0; l < W; ++l) {
      factor[l] = Real{0};
      if ((active >> l & 1U) == 0) continue;
      if (php[l] > Real{0}) {
        factor[l] = rz[l] / php[l];
      } else {
        active &= ~(1U << l);
        if (k > 0) continue;
        factor[l] = Real{1};  // a step of the preconditioner alone goes downhill
      }
      moves |= 1U << l;
    }
    solid_.add_scaled(args_, step_.data(), p_.data(), factor.data(), moves);
    for (Real& f : factor) f = -f;
    solid_.add_scaled(args_, b_.data(), hp_.data(), factor.data(), moves);
    precondition();
    solid_.dot(args_, b_.data(), z_.data(), rz_new.data());
    for (std::size_t l = 0; l < W; ++l) {
      factor[l] = (active >> l & 1U) != 0 ? rz_new[l] / rz[l] : Real{0};
      rz[l] = rz_new[l];
      if (!(rz[l] > enough[l])) active &= ~(1U << l);
    }
    solid_.advance_direction(args_, factor.data());
  }
}

#define OMENTUM_INSTANTIATE(Real)                                            \
  template void SolidTissue<Real>::precondition();                           \
  template void SolidTissue<Real>::find_residual(PerLane&);                  \
  template void SolidTissue<Real>::multiply_hessian();                       \
  template void SolidTissue<Real>::find_newton_step(PerLane, std::uint32_t); \
  template void SolidTissue<Real>::solve_lanes(std::uint32_t);               \
  template void SolidTissue<Real>::response(const Real*, Real*, Real*);      \
  template void SolidTissue<Real>::take_response(const Real*, const Real*, std::uint32_t)
OMENTUM_INSTANTIATE(float);
OMENTUM_INSTANTIATE(double);
#undef OMENTUM_INSTANTIATE

}  // namespace omentum
