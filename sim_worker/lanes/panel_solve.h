#pragma once

#include <cstdint>

namespace omentum {

inline constexpr int kMaxPanelWidth = 4;

/// Up to kMaxPanelWidth neighbouring columns of L, stored dense: first a width x width block (lower
/// triangle, reciprocal of the diagonal on the diagonal), then one row of `width` values per row
/// below. Indices are rows of the vector that is solved for, so that nothing has to be permuted.
struct FactorPanel {
  std::int32_t width;
  std::int32_t row_begin;  ///< in PanelArgs::row: the columns, then the rows below
  std::int32_t rows;       ///< below the block
  std::int32_t value_begin;
};

/// A Cholesky factor L L^T in panels, shared by all lanes.
template <typename Real>
struct PanelArgs {
  const FactorPanel* panel;
  std::int32_t panels;
  const std::int32_t* row;
  const Real* value;
};

}  // namespace omentum
