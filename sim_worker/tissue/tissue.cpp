#include "sim_worker/tissue/tissue.h"

#include "core/check.h"

namespace omentum {

bool usable(const LaneParameters& p) {
  const auto within = [](double v, double min, double max) { return v >= min && v <= max; };
  return within(p.stiffness_scale, 1e-3, 1e3) && within(p.gravity_scale, -100, 100) &&
         within(p.damping_scale, 0, 1e3) && within(p.friction_scale, 0, 1e3) &&
         within(p.thickness_scale, 0.1, 10);
}

template <typename Real>
void Tissue<Real>::step(std::span<const ToolMotion> motion) {
  OMENTUM_CHECK(static_cast<int>(motion.size()) == lanes());
  const auto substeps = static_cast<int>(model().substeps());
  begin_step(motion);
  for (int substep = 0; substep < substeps; ++substep) {
    begin_substep(motion, substep);
    solve_substep();
    end_substep(substep + 1 == substeps);
  }
}

template class Tissue<float>;
template class Tissue<double>;

}  // namespace omentum
