#pragma once

#include <cstdint>

namespace omentum {

/// What the lane kernel of the elastic solid knows of effects (mismatch.md 5.1): parameters and
/// memory per lane, and masks of the lanes in which an effect is on that needs more than a number.
/// Lane index fastest, as in SolidArgs. A lane in which an effect is off keeps its bits whatever
/// the others do.
template <typename Real>
struct SolidEffectArgs {
  // Parameters, [lane].
  const Real* mu;      ///< stable neo-Hooke [Pa]
  const Real* lambda;  ///< [Pa]
  const Real* alpha;
  const Real* bulk;     ///< the part of lambda that acts on the mean of an element [Pa]
  const Real* density;  ///< 1 + change

  /// [tetrahedron][integration point][lane]: stiffness there over that of the lane; null = 1.
  const Real* map;
};

}  // namespace omentum
