#pragma once

#include <immintrin.h>

namespace omentum {

/// True when this thread computes by the IEEE default: round to nearest, no flush-to-zero, no
/// denormals-are-zero, all exceptions masked. Status bits are ignored. One shared library linked
/// with -ffast-math changes the mode of the whole process, and a thread inherits its creator's, so
/// every thread that computes checks this at its entry.
inline bool fp_mode_is_default() {
  constexpr unsigned int kStatusBits = 0x3Fu;
  return (_mm_getcsr() & ~kStatusBits) == 0x1F80u;
}

}  // namespace omentum
