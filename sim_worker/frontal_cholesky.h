#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

namespace omentum {

/// Order in which the unknowns of a sheet are eliminated: nested dissection [George73]. The sheet
/// is a grid of columns (all nodes above one another); neighbours, diagonal ones included, couple.
/// A line of columns cuts a rectangle in two halves that do not couple, each half is cut again, and
/// a line is eliminated after its halves. Against line-by-line numbering a 37 x 36 grid needs 2.5
/// times fewer operations.
struct Dissection {
  /// Rows `from` ... `from + length - 1` of a front's border are rows `to` ... of its parent;
  /// a run never spans rows that the parent eliminates and rows of its border.
  struct Run {
    int from = 0, length = 0, to = 0;
  };
  /// A cut, or a small rectangle: unknowns `first` ... `first + own - 1`, which once eliminated
  /// couple all of `border` (unknowns eliminated later, ascending). Rows of a front: own, border.
  struct Front {
    int first = 0, own = 0;
    std::vector<int> border;
    std::vector<Run> into_parent;
    std::array<int, 2> child = {-1, -1};  ///< -1 = none
    int depth = 0, side = 0;              ///< in the tree; which child of its parent
    std::size_t entries = 0;              ///< where its entries start
    int height() const { return own + static_cast<int>(border.size()); }
  };
  std::vector<Front> fronts;       ///< children before parents
  std::vector<int> first_unknown;  ///< per grid column; -1 = it has none
  std::vector<int> front_of;       ///< per unknown
  int size = 0;                    ///< unknowns
  std::size_t entries = 0;         ///< of all fronts

  /// Entry (row, column) of the lower triangle, row >= column; the next row lies behind it, the
  /// next column of the same grid column stride(column) further. The two must couple.
  std::size_t index(int row, int column) const;
  int stride(int column) const {
    return fronts[static_cast<std::size_t>(front_of[static_cast<std::size_t>(column)])].height();
  }
};

/// `unknowns[iy nx + ix]`: of each grid column, >= 0.
Dissection dissect(int nx, int ny, std::span<const int> unknowns);

/// Multifrontal Cholesky factorisation of a symmetric positive definite matrix [Duff83]: each front
/// is a dense matrix that hands what is left on its border to its parent. One thread at a time.
class FrontalCholesky {
 public:
  /// `order` must outlive this. Entries start at zero.
  explicit FrontalCholesky(const Dissection& order);

  void set_zero();
  /// Entries by Dissection::index() before factor(); the upper triangle is never read.
  double* entries() { return entries_.data(); }
  /// A = L L^T in place; false where A is not positive definite (the entries are then lost).
  bool factor();
  /// rhs <- L^-1 rhs. Fronts that nothing reaches cost nothing.
  void solve_lower(Eigen::Ref<Eigen::MatrixXd> rhs) const;
  /// rhs <- L^-T rhs.
  void solve_upper(Eigen::Ref<Eigen::MatrixXd> rhs) const;

 private:
  const Dissection& order_;
  std::vector<double> entries_;  ///< per front: own columns of all its rows
  /// What fronts leave on their borders, by depth and side: a front is done when the two below it
  /// are, so one place for each suffices.
  std::vector<std::array<std::vector<double>, 2>> left_;
  Eigen::Index widest_border_ = 0;
};

}  // namespace omentum
