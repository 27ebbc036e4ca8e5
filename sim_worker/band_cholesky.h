#pragma once

#include <Eigen/Core>
#include <vector>

namespace omentum {

/// Cholesky factorisation of a symmetric positive definite band matrix, in panels, so that the work
/// is dense matrix products. A sheet numbered line by line has such a matrix: it is the fastest
/// direct solver for it without another library. One thread at a time.
class BandCholesky {
 public:
  /// `bandwidth`: largest row - column of an entry. Entries start at zero.
  BandCholesky(int size, int bandwidth);

  int size() const { return size_; }
  void set_zero();
  /// Entry of the lower triangle before factor(): row - column in [0, bandwidth].
  double& at(int row, int column) { return entries_[index(row, column)]; }
  /// A = L L^T in place; false where A is not positive definite (the entries are then lost).
  bool factor();
  /// rhs <- L^-1 rhs. Rows before `first` are zero and stay so.
  void solve_lower(Eigen::Ref<Eigen::MatrixXd> rhs, int first) const;
  /// rhs <- L^-T rhs.
  void solve_upper(Eigen::Ref<Eigen::MatrixXd> rhs) const;

 private:
  std::size_t index(int row, int column) const {
    return static_cast<std::size_t>(row - column) +
           static_cast<std::size_t>(column) * static_cast<std::size_t>(height_);
  }

  int size_, bandwidth_, height_;  // height_: stored entries per column
  std::vector<double> entries_;
};

}  // namespace omentum
