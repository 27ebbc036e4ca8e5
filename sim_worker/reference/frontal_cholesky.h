#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

// reference/ is the converged solid (docs/tissue.md 13): bricks, exact tangents, double precision,
// one environment. The oracle of the fast models, and what `mismatch` compares recordings with. It
// shares no arithmetic with the lanes.

namespace omentum {

/// Order in which the unknowns of a sheet are eliminated: nested dissection [George73]. The sheet
/// is a grid of columns of nodes; neighbours, diagonal ones included, couple. A line of columns
/// cuts a rectangle in two halves that do not couple, each half is cut again, and a line is
/// eliminated after its halves. Against line-by-line numbering a 37 x 36 grid needs 2.5 times fewer
/// operations.
struct Dissection {
  /// Rows `from` ... `from + length - 1` of a front's border are rows `to` ... of its parent;
  /// a run never spans rows that the parent eliminates and rows of its border.
  struct Run {
    int from = 0, length = 0, to = 0;
  };
  /// A cut, or a small rectangle: unknowns `first` ... `first + own - 1`, whose elimination couples
  /// all of `border` (unknowns eliminated later, ascending). Rows of a front: own, border.
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

  /// Index of the entry (row, column), row >= column, of unknowns that couple. The next row is one
  /// further, the next column of the same grid column stride(column).
  std::size_t index(int row, int column) const;
  int stride(int column) const { return fronts[front_of[column]].height(); }
};

/// `unknowns[iy nx + ix]`: of each grid column, >= 0.
Dissection dissect(int nx, int ny, std::span<const int> unknowns);

/// Many right sides at once: the values of an unknown lie side by side, so that fronts gather and
/// scatter whole rows.
using RightSides = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Multifrontal Cholesky factorisation A = L S L^T of a symmetric matrix [Duff83], S = diag(+-1),
/// which is I where A is positive definite: each front is a dense matrix that adds its update
/// matrix, the Schur complement on its border, to its parent. A has as many negative eigenvalues as
/// S. Pivots stay in their order, so one that vanishes ends it. One thread at a time.
class FrontalCholesky {
 public:
  /// `order` must outlive this. Entries start at zero; their memory is taken at their first use.
  explicit FrontalCholesky(const Dissection& order);

  void set_zero();
  /// Of A, by Dissection::index(); the upper triangle is never read.
  double* entries();
  /// False, and no factor, where a pivot vanishes.
  bool factor();
  /// The same, to the last bit, where A changed since the last factor in the columns of these
  /// unknowns only; renews the fronts that depend on them.
  bool factor_again(std::span<const int> changed);
  /// rhs <- L^-1 rhs; skips fronts where rhs is zero.
  void solve_lower(Eigen::Ref<Eigen::MatrixXd> rhs) const;
  void solve_lower(RightSides& rhs) const;
  /// Negative eigenvalues of A.
  int negative() const;
  /// rhs <- S rhs.
  void apply_signs(Eigen::Ref<Eigen::MatrixXd> rhs) const;
  /// rhs <- L^-T S rhs.
  void solve_upper(Eigen::Ref<Eigen::MatrixXd> rhs) const;
  void solve_upper(RightSides& rhs) const;

 private:
  bool factor_fronts();
  template <typename Matrix>
  void lower(Matrix& rhs) const;
  template <typename Matrix>
  void upper(Matrix& rhs) const;
  template <typename Matrix>
  void change_signs(Matrix& rhs) const;
  double* update_of(std::size_t front) { return &update_[update_at_[front]]; }

  const Dissection& order_;
  std::vector<double> entries_;  ///< of A, per front: own columns of all its rows
  std::vector<double> panels_;   ///< of L, alike
  std::vector<double> update_;   ///< update matrices
  std::size_t update_size_ = 0;
  std::vector<std::size_t> update_at_;  ///< start of each front's in update_
  std::vector<std::uint8_t> stale_;     ///< per front: to be factored
  std::vector<int> negative_;           ///< per front: negative entries of S
  Eigen::VectorXd sign_;                ///< the diagonal of S
  Eigen::Index widest_border_ = 0;
};

/// Solver of the Schur complement B of rows that border a matrix with this factor.
class BorderSolver {
 public:
  /// `negative` is that of the factor. Where it is not 0, false unless B has as many negative
  /// eigenvalues: then the bordered matrix has one for each row.
  bool compute(const Eigen::MatrixXd& B, int negative);
  Eigen::MatrixXd solve(const Eigen::MatrixXd& rhs) const;

 private:
  int negative_ = 0;
  Eigen::LDLT<Eigen::MatrixXd> definite_;
  Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> indefinite_;
};

}  // namespace omentum
