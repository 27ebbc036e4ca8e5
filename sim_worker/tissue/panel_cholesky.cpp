#include "sim_worker/tissue/panel_cholesky.h"

#include <Eigen/SparseCholesky>

#include "core/check.h"

namespace omentum {
namespace {

using SparseMatrix = Eigen::SparseMatrix<double>;
using Cholesky = Eigen::SimplicialLLT<SparseMatrix, Eigen::Lower,
                                      Eigen::AMDOrdering<SparseMatrix::StorageIndex>>;

/// Rows below the diagonal of each column of L.
std::vector<std::vector<int>> column_patterns(const SparseMatrix& l) {
  std::vector<std::vector<int>> pattern(l.cols());
  for (int c = 0; c < l.cols(); ++c) {
    for (SparseMatrix::InnerIterator it(l, c); it; ++it) {
      if (it.row() > c) pattern[c].push_back(static_cast<int>(it.row()));
    }
  }
  return pattern;
}

/// Last column of the panel that begins at `first`: neighbours that follow each other in the
/// elimination tree, as long as few zeros are stored.
int last_of_panel(const std::vector<std::vector<int>>& pattern, int first) {
  int last = first;
  std::size_t entries = pattern[first].size();
  while (last + 1 - first < kMaxPanelWidth && last + 1 < static_cast<int>(pattern.size())) {
    const auto& below = pattern[last];
    if (below.empty() || below.front() != last + 1) break;
    const auto& next = pattern[last + 1];
    const std::size_t width = static_cast<std::size_t>(last + 2 - first);
    const std::size_t dense = width * next.size() + width * (width - 1) / 2;
    entries += next.size();
    if (dense > entries + entries / 2) break;
    ++last;
  }
  return last;
}

/// Stores L as dense panels whose rows and columns are node indices.
PanelFactor make_panels(const SparseMatrix& l, const std::vector<int>& node_of) {
  PanelFactor factor;
  const auto pattern = column_patterns(l);
  for (int first = 0; first < l.cols();) {
    const int last = last_of_panel(pattern, first);
    const auto& below = pattern[last];
    const int width = last - first + 1;
    const auto rows = static_cast<int>(below.size());
    factor.panels.push_back({width, static_cast<std::int32_t>(factor.row.size()), rows,
                             static_cast<std::int32_t>(factor.values.size())});
    std::vector<int> index;
    for (int c = first; c <= last; ++c) index.push_back(c);
    index.insert(index.end(), below.begin(), below.end());
    for (const int row : index) {
      factor.row.push_back(node_of[row]);
      for (int c = first; c <= last; ++c) {
        const double value = row < c ? 0.0 : l.coeff(row, c);
        factor.values.push_back(row == c ? 1 / value : value);
      }
    }
    first = last + 1;
  }
  return factor;
}

}  // namespace

PanelFactor factorize(const SparseMatrix& matrix, std::span<const int> node_of_row) {
  OMENTUM_CHECK(static_cast<std::size_t>(matrix.rows()) == node_of_row.size());
  const Cholesky cholesky(matrix);
  OMENTUM_CHECK(cholesky.info() == Eigen::Success);
  std::vector<int> node_of(node_of_row.size());
  for (std::size_t k = 0; k < node_of.size(); ++k) {
    node_of[cholesky.permutationP().indices()(static_cast<Eigen::Index>(k))] = node_of_row[k];
  }
  return make_panels(SparseMatrix(cholesky.matrixL()), node_of);
}

template <typename Real>
LaneFactor<Real>::LaneFactor(const PanelFactor& factor) : factor_(&factor) {
  for (const double v : factor.values) value_.push_back(static_cast<Real>(v));
}

template <typename Real>
PanelArgs<Real> LaneFactor<Real>::args() const {
  return {factor_->panels.data(), static_cast<std::int32_t>(factor_->panels.size()),
          factor_->row.data(), value_.data()};
}

template class LaneFactor<float>;
template class LaneFactor<double>;

void PanelFactor::solve(Eigen::MatrixXd& b) const {
  for (const FactorPanel& panel : panels) {
    const std::int32_t* const node = row.data() + panel.row_begin;
    const double* value = values.data() + panel.value_begin;
    for (int k = 0; k < panel.width; ++k, value += panel.width) {
      for (int j = 0; j < k; ++j) b.col(node[k]) -= value[j] * b.col(node[j]);
      b.col(node[k]) *= value[k];
    }
    for (int r = 0; r < panel.rows; ++r, value += panel.width) {
      for (int k = 0; k < panel.width; ++k) {
        b.col(node[panel.width + r]) -= value[k] * b.col(node[k]);
      }
    }
  }
  for (auto panel = panels.rbegin(); panel != panels.rend(); ++panel) {
    const std::int32_t* const node = row.data() + panel->row_begin;
    const double* const block = values.data() + panel->value_begin;
    const double* value = block + panel->width * panel->width;
    for (int r = 0; r < panel->rows; ++r, value += panel->width) {
      for (int k = 0; k < panel->width; ++k) {
        b.col(node[k]) -= value[k] * b.col(node[panel->width + r]);
      }
    }
    for (int k = panel->width - 1; k >= 0; --k) {
      for (int j = k + 1; j < panel->width; ++j) {
        b.col(node[k]) -= block[panel->width * j + k] * b.col(node[j]);
      }
      b.col(node[k]) *= block[panel->width * k + k];
    }
  }
}

}  // namespace omentum
