#include "sim_worker/band_cholesky.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace omentum {
namespace {

using Eigen::MatrixXd;
using Dense = Eigen::Map<MatrixXd, 0, Eigen::OuterStride<>>;
using ConstDense = Eigen::Map<const MatrixXd, 0, Eigen::OuterStride<>>;

// Columns per panel: small enough that the zeros between band and panel cost little.
constexpr int kPanel = 32;

}  // namespace

// Column j stores rows j ... j + height - 1 one after the other, so entry (i, j) lies at
// i + j (height - 1): any block of the lower triangle that the storage covers is a dense matrix
// with outer stride height - 1. A panel of 32 columns covers the rectangle below it when height is
// the bandwidth + 32; entries between the band and that rectangle are zeros.
BandCholesky::BandCholesky(int size, int bandwidth)
    : size_(size), bandwidth_(std::min(bandwidth, size)), height_(bandwidth_ + kPanel) {
  entries_.assign(static_cast<std::size_t>(size_ + kPanel) * static_cast<std::size_t>(height_), 0);
}

void BandCholesky::set_zero() { std::fill(entries_.begin(), entries_.end(), 0.0); }

bool BandCholesky::factor() {
  const Eigen::OuterStride<> stride(height_ - 1);
  for (int start = 0; start < size_; start += kPanel) {
    const int width = std::min(kPanel, size_ - start);
    const int next = start + width;
    const int below = std::min(bandwidth_, size_ - next);
    Dense diagonal(&entries_[index(start, start)], width, width, stride);
    const MatrixXd block = diagonal.triangularView<Eigen::Lower>();
    const Eigen::LLT<MatrixXd> llt(block);
    if (llt.info() != Eigen::Success) return false;
    diagonal.triangularView<Eigen::Lower>() = llt.matrixLLT();
    if (below == 0) continue;
    Dense under(&entries_[index(next, start)], below, width, stride);
    llt.matrixL().transpose().solveInPlace<Eigen::OnTheRight>(under);
    Dense rest(&entries_[index(next, next)], below, below, stride);
    rest.selfadjointView<Eigen::Lower>().rankUpdate(under, -1.0);
  }
  return true;
}

void BandCholesky::solve_lower(Eigen::Ref<MatrixXd> rhs, int first) const {
  const Eigen::OuterStride<> stride(height_ - 1);
  for (int start = first / kPanel * kPanel; start < size_; start += kPanel) {
    const int width = std::min(kPanel, size_ - start);
    const int next = start + width;
    const int below = std::min(bandwidth_, size_ - next);
    const ConstDense diagonal(&entries_[index(start, start)], width, width, stride);
    auto part = rhs.middleRows(start, width);
    diagonal.triangularView<Eigen::Lower>().solveInPlace(part);
    if (below == 0) continue;
    const ConstDense under(&entries_[index(next, start)], below, width, stride);
    rhs.middleRows(next, below).noalias() -= under * part;
  }
}

void BandCholesky::solve_upper(Eigen::Ref<MatrixXd> rhs) const {
  const Eigen::OuterStride<> stride(height_ - 1);
  for (int start = (size_ - 1) / kPanel * kPanel; start >= 0; start -= kPanel) {
    const int width = std::min(kPanel, size_ - start);
    const int next = start + width;
    const int below = std::min(bandwidth_, size_ - next);
    auto part = rhs.middleRows(start, width);
    if (below > 0) {
      const ConstDense under(&entries_[index(next, start)], below, width, stride);
      part.noalias() -= under.transpose() * rhs.middleRows(next, below);
    }
    const ConstDense diagonal(&entries_[index(start, start)], width, width, stride);
    diagonal.triangularView<Eigen::Lower>().transpose().solveInPlace(part);
  }
}

}  // namespace omentum
