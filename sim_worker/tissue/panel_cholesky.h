#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <cstdint>
#include <span>
#include <vector>

#include "core/aligned.h"
#include "sim_worker/lanes/panel_solve.h"

namespace omentum {

/// Cholesky factor of a symmetric positive definite matrix over some nodes, in dense panels for the
/// lane kernel (FactorPanel says how they are stored).
struct PanelFactor {
  std::vector<FactorPanel> panels;
  std::vector<std::int32_t> row;  ///< of PanelArgs
  std::vector<double> values;

  /// Replaces every row of b (any number x nodes, the highest of node_of_row included) by the
  /// solution; nodes without a row of the matrix are left alone.
  void solve(Eigen::MatrixXd& b) const;
};

/// A factor in the precision of a lane kernel. The PanelFactor must outlive it.
template <typename Real>
class LaneFactor {
 public:
  LaneFactor() = default;
  explicit LaneFactor(const PanelFactor& factor);
  PanelArgs<Real> args() const;

 private:
  const PanelFactor* factor_ = nullptr;
  AlignedVector<Real> value_;
};

extern template class LaneFactor<float>;
extern template class LaneFactor<double>;

/// Factor of `matrix`, whose row k belongs to node node_of_row[k]. Minimum degree ordering. Reads
/// the lower triangle; aborts where the matrix is not positive definite or has another number of
/// rows.
PanelFactor factorize(const Eigen::SparseMatrix<double>& matrix, std::span<const int> node_of_row);

}  // namespace omentum
