#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <cstdint>
#include <span>
#include <vector>

#include "sim_worker/elastic_kernel.h"

namespace omentum {

/// Cholesky factor of a symmetric positive definite matrix over some nodes, in dense panels for the
/// lane kernel (FactorPanel says how they are stored).
struct PanelFactor {
  std::vector<FactorPanel> panels;
  std::vector<std::int32_t> panel_node;
  std::vector<double> panel_value;

  /// Replaces every row of b (any x nodes) by the solution; nodes without a row of the matrix are
  /// left alone.
  void solve(Eigen::MatrixXd& b) const;
};

/// Factor of `matrix`, whose row k belongs to node node_of_row[k]. Minimum degree ordering.
PanelFactor factorize(const Eigen::SparseMatrix<double>& matrix, std::span<const int> node_of_row);

}  // namespace omentum
