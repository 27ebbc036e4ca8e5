#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "core/aligned.h"
#include "core/result.h"
#include "core/types.h"
#include "sim_worker/solid_effects.h"
#include "sim_worker/solid_model.h"

namespace omentum {

/// Effects of the lanes of one elastic solid: parameters and memory in the layout of the lane
/// kernel. Memory is made when the first lane needs it. One thread at a time.
template <typename Real>
class SolidLaneEffects {
 public:
  SolidLaneEffects(std::shared_ptr<const SolidTissueModel> model, int lanes);

  /// For the kernel; valid until the next call of set().
  const SolidEffectArgs<Real>& args() const { return args_; }
  const EffectValues& values(int lane) const { return values_[static_cast<std::size_t>(lane)]; }
  /// How many times stiffer than the scene's the effects of a lane make the material at most, 1 or
  /// more.
  double stiffer(int lane) const;

  void set(int lane, const EffectValues& values);
  /// Memory of a body that never moved.
  void reset(int lane);

  /// Values, then the memory of those that have one.
  void save(int lane, Bytes& out) const;
  /// Two halves, so that nothing changes before all is known to be sound: read() checks and gives
  /// the values and the number of bytes; load() takes them over.
  Result<std::size_t> read(std::span<const std::byte> state, EffectValues& values) const;
  void load(int lane, std::span<const std::byte> state);

 private:
  void set_map(int lane);

  std::shared_ptr<const SolidTissueModel> model_;
  int lanes_;
  SolidEffectArgs<Real> args_{};
  std::vector<EffectValues> values_;
  AlignedVector<Real> mu_, lambda_, alpha_, bulk_, density_, map_;
};

extern template class SolidLaneEffects<float>;
extern template class SolidLaneEffects<double>;

}  // namespace omentum
