#include "sim_worker/reference/frontal_cholesky.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "core/check.h"

namespace omentum {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using Dense = Eigen::Map<MatrixXd>;
using ConstDense = Eigen::Map<const MatrixXd>;

// Rectangles of up to so many columns are not cut: smaller ones save operations, but their matrices
// are too small to be fast.
constexpr int kLeaf = 9;
// Columns that a front eliminates at once, and of which it updates its border at once. Below what
// Eigen splits by the size of the cache: the sums are the same on every machine.
constexpr int kPanel = 32;
constexpr int kDepth = 96;
using Block = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kPanel, kPanel>;
// Share of a diagonal entry below which a pivot without a sign of its own is rounding.
constexpr double kVanishes = 1e-10;
// Update matrices of fronts down to this depth of the tree are kept, so that 16 parts of the sheet
// can be factored again alone; more would not fit the cache.
constexpr int kKeptDepth = 4;

struct Rectangle {
  int x0, x1, y0, y1;  // half open
};

/// Row of an unknown among those of a front: its own, then its border.
int row_of(const Dissection::Front& front, int unknown) {
  if (unknown < front.first + front.own) return unknown - front.first;
  const auto at = std::lower_bound(front.border.begin(), front.border.end(), unknown);
  OMENTUM_CHECK(at != front.border.end() && *at == unknown, "unknown {}", unknown);
  return front.own + static_cast<int>(at - front.border.begin());
}

class Dissector {
 public:
  Dissector(int nx, int ny, std::span<const int> unknowns) : nx_(nx), ny_(ny), unknowns_(unknowns) {
    order_.first_unknown.assign(unknowns.size(), -1);
  }

  Dissection run() {
    cut({0, nx_, 0, ny_}, 0, 0);
    finish();
    return std::move(order_);
  }

 private:
  std::vector<int> columns(const Rectangle& r) const {
    std::vector<int> found;
    for (int iy = r.y0; iy < r.y1; ++iy) {
      for (int ix = r.x0; ix < r.x1; ++ix) {
        const int column = iy * nx_ + ix;
        if (unknowns_[column] > 0) found.push_back(column);
      }
    }
    return found;
  }

  /// Columns around the rectangle; all lie on cuts, eliminated later.
  std::vector<int> ring(const Rectangle& r) const {
    const Rectangle wide = {std::max(0, r.x0 - 1), std::min(nx_, r.x1 + 1), std::max(0, r.y0 - 1),
                            std::min(ny_, r.y1 + 1)};
    std::vector<int> found = columns(wide);
    std::erase_if(found, [&](int column) {
      const int ix = column % nx_;
      const int iy = column / nx_;
      return ix >= r.x0 && ix < r.x1 && iy >= r.y0 && iy < r.y1;
    });
    return found;
  }

  /// Cuts a rectangle; the number of its last front, -1 where it has no unknowns.
  int cut(const Rectangle& r, int depth, int side) {
    if (columns(r).empty()) return -1;
    Dissection::Front front;
    front.depth = depth;
    front.side = side;
    Rectangle own = r;
    const int width = r.x1 - r.x0;
    const int height = r.y1 - r.y0;
    if (width * height > kLeaf && std::max(width, height) >= 3) {
      Rectangle low = r;
      Rectangle high = r;
      if (width >= height) {
        own.x0 = low.x1 = (r.x0 + r.x1) / 2;
        own.x1 = high.x0 = own.x0 + 1;
      } else {
        own.y0 = low.y1 = (r.y0 + r.y1) / 2;
        own.y1 = high.y0 = own.y0 + 1;
      }
      front.child = {cut(low, depth + 1, 0), cut(high, depth + 1, 1)};
    }
    front.first = order_.size;
    for (const int column : columns(own)) {
      order_.first_unknown[column] = order_.size;
      order_.size += unknowns_[column];
    }
    front.own = order_.size - front.first;
    front.border = ring(r);  // columns, until all are numbered
    order_.fronts.push_back(front);
    return static_cast<int>(order_.fronts.size()) - 1;
  }

  void finish() {
    for (Dissection::Front& front : order_.fronts) {
      std::vector<int> border;
      for (const int column : front.border) {
        for (int k = 0; k < unknowns_[column]; ++k)
          border.push_back(order_.first_unknown[column] + k);
      }
      std::sort(border.begin(), border.end());
      front.border = std::move(border);
      front.entries = order_.entries;
      order_.entries += front.own * front.height();
      const auto number = static_cast<int>(&front - order_.fronts.data());
      order_.front_of.insert(order_.front_of.end(), front.own, number);
    }
    for (const Dissection::Front& parent : order_.fronts) {
      for (const int child : parent.child) {
        if (child >= 0) map_border(parent, order_.fronts[child]);
      }
    }
  }

  static void map_border(const Dissection::Front& parent, Dissection::Front& child) {
    for (int k = 0; k < static_cast<int>(child.border.size()); ++k) {
      const int to = row_of(parent, child.border[k]);
      if (!child.into_parent.empty()) {
        Dissection::Run& last = child.into_parent.back();
        if (last.to + last.length == to && to != parent.own) {
          ++last.length;
          continue;
        }
      }
      child.into_parent.push_back({k, 1, to});
    }
  }

  int nx_, ny_;
  std::span<const int> unknowns_;
  Dissection order_;
};

/// Extend-add: adds the update matrix of a child to the columns the front eliminates and to its own
/// update matrix.
void add_child(const Dissection::Front& child, const double* update, const Dissection::Front& front,
               Dense& panel, Dense& border) {
  const auto rim = static_cast<std::ptrdiff_t>(child.border.size());
  for (const Dissection::Run& across : child.into_parent) {
    for (int j = 0; j < across.length; ++j) {
      const int column = across.to + j;
      const bool eliminated = column < front.own;
      for (const Dissection::Run& down : child.into_parent) {
        if (down.from < across.from) continue;  // upper triangle
        const int skip = down.from == across.from ? j : 0;
        const int length = down.length - skip;
        const double* part = update + (across.from + j) * rim + down.from + skip;
        double* to = eliminated ? &panel(down.to + skip, column)
                                : &border(down.to + skip - front.own, column - front.own);
        for (int i = 0; i < length; ++i) to[i] += part[i];
      }
    }
  }
}

/// A = L S L^T of a block that is not positive definite; false where a pivot vanishes.
bool factor_signed(Eigen::Ref<MatrixXd> block, Eigen::Ref<VectorXd> sign) {
  for (Eigen::Index k = 0; k < block.rows(); ++k) {
    const auto row = block.row(k).head(k);
    const double diagonal = block(k, k);
    const double pivot = diagonal - row.cwiseAbs2().dot(sign.head(k));
    if (!(std::fabs(pivot) > kVanishes * std::fabs(diagonal))) return false;
    sign[k] = pivot < 0 ? -1 : 1;
    block(k, k) = std::sqrt(std::fabs(pivot));
    const Eigen::Index under = block.rows() - k - 1;
    const VectorXd signed_row = row.transpose().cwiseProduct(sign.head(k));
    auto column = block.col(k).tail(under);
    column -= block.bottomLeftCorner(under, k) * signed_row;
    column /= sign[k] * block(k, k);
  }
  return true;
}

/// Lower triangle of to <- to - part S part^T.
template <typename To, typename Part, typename Sign>
void subtract_square(To&& to, const Part& part, const Sign& sign) {
  if ((sign.array() > 0).all()) {
    to.template selfadjointView<Eigen::Lower>().rankUpdate(part, -1.0);
  } else {
    to.template triangularView<Eigen::Lower>() -= part * (part * sign.asDiagonal()).transpose();
  }
}

/// Factor of the own columns of a front, their signs, and its update matrix; false where a pivot
/// vanishes.
bool eliminate(Dense& panel, Dense& border, Eigen::Ref<VectorXd> sign) {
  const Eigen::Index own = panel.cols();
  const Eigen::Index rim = border.rows();
  sign.setOnes();
  for (Eigen::Index start = 0; start < own; start += kPanel) {
    const Eigen::Index width = std::min<Eigen::Index>(kPanel, own - start);
    const Eigen::Index next = start + width;
    Eigen::Ref<MatrixXd> diagonal = panel.block(start, start, width, width);
    auto signs = sign.segment(start, width);
    const Block before = diagonal;
    const Eigen::LLT<Eigen::Ref<MatrixXd>> llt(diagonal);
    const bool positive = llt.info() == Eigen::Success;
    if (!positive) {
      diagonal = before;
      if (!factor_signed(diagonal, signs)) return false;
    }
    auto under = panel.block(next, start, panel.rows() - next, width);
    if (under.rows() == 0) continue;
    diagonal.triangularView<Eigen::Lower>().transpose().solveInPlace<Eigen::OnTheRight>(under);
    if (!positive) under *= signs.asDiagonal();
    const Eigen::Index more = own - next;
    if (more == 0) continue;
    subtract_square(panel.block(next, next, more, more), under.topRows(more), signs);
    if (rim == 0) continue;
    auto rows = panel.block(own, next, rim, more);
    if (positive) {
      rows.noalias() -= under.bottomRows(rim) * under.topRows(more).transpose();
    } else {
      rows -= under.bottomRows(rim) * (under.topRows(more) * signs.asDiagonal()).transpose();
    }
  }
  if (rim == 0) return true;
  for (Eigen::Index start = 0; start < own; start += kDepth) {
    const Eigen::Index width = std::min<Eigen::Index>(kDepth, own - start);
    subtract_square(border, panel.block(own, start, rim, width), sign.segment(start, width));
  }
  return true;
}

}  // namespace

Dissection dissect(int nx, int ny, std::span<const int> unknowns) {
  return Dissector(nx, ny, unknowns).run();
}

std::size_t Dissection::index(int row, int column) const {
  const Front& front = fronts[front_of[column]];
  return front.entries + (column - front.first) * front.height() + row_of(front, row);
}

FrontalCholesky::FrontalCholesky(const Dissection& order) : order_(order) {
  stale_.assign(order_.fronts.size(), 1);
  negative_.assign(order_.fronts.size(), 0);
  sign_.setOnes(order_.size);
  // Below kKeptDepth one place for each depth and side suffices, since a front is done right after
  // its two children; it stays in the cache.
  std::map<std::pair<int, int>, std::size_t> shared;  // entries
  for (const Dissection::Front& front : order_.fronts) {
    std::size_t& widest = shared[{front.depth, front.side}];
    widest = std::max(widest, front.border.size() * front.border.size());
    widest_border_ = std::max(widest_border_, static_cast<Eigen::Index>(front.border.size()));
  }
  std::map<std::pair<int, int>, std::size_t> place;
  std::size_t end = 0;
  for (const Dissection::Front& front : order_.fronts) {
    const std::pair<int, int> key(front.depth, front.side);
    if (front.depth <= kKeptDepth) {
      update_at_.push_back(end);
      end += front.border.size() * front.border.size();
      continue;
    }
    const auto [at, is_new] = place.try_emplace(key, end);
    if (is_new) end += shared[key];
    update_at_.push_back(at->second);
  }
  update_size_ = end + 1;
}

double* FrontalCholesky::entries() {
  if (entries_.empty()) {
    entries_.assign(order_.entries, 0);
    panels_.assign(order_.entries, 0);
    update_.assign(update_size_, 0);
  }
  return entries_.data();
}

void FrontalCholesky::set_zero() { std::fill_n(entries(), order_.entries, 0.0); }

bool FrontalCholesky::factor() {
  entries();
  std::fill(stale_.begin(), stale_.end(), 1);
  return factor_fronts();
}

bool FrontalCholesky::factor_again(std::span<const int> changed) {
  std::fill(stale_.begin(), stale_.end(), 0);
  for (const int unknown : changed) stale_[order_.front_of[unknown]] = 1;
  // Up the tree, children before parents; then down, where the update matrices are not kept.
  for (std::size_t f = 0; f < order_.fronts.size(); ++f) {
    for (const int child : order_.fronts[f].child) {
      if (child >= 0 && stale_[child] != 0) stale_[f] = 1;
    }
  }
  for (std::size_t f = order_.fronts.size(); f-- > 0;) {
    if (stale_[f] == 0 || order_.fronts[f].depth < kKeptDepth) continue;
    for (const int child : order_.fronts[f].child) {
      if (child >= 0) stale_[child] = 1;
    }
  }
  return factor_fronts();
}

bool FrontalCholesky::factor_fronts() {
  for (std::size_t f = 0; f < order_.fronts.size(); ++f) {
    if (stale_[f] == 0) continue;
    const Dissection::Front& front = order_.fronts[f];
    const auto rim = static_cast<Eigen::Index>(front.border.size());
    const double* from = &entries_[front.entries];
    std::copy(from, from + static_cast<std::ptrdiff_t>(front.height()) * front.own,
              &panels_[front.entries]);
    Dense panel(&panels_[front.entries], front.height(), front.own);
    Dense border(update_of(f), rim, rim);
    for (Eigen::Index k = 0; k < rim; ++k) border.col(k).tail(rim - k).setZero();
    for (const int child : front.child) {
      if (child >= 0) add_child(order_.fronts[child], update_of(child), front, panel, border);
    }
    auto sign = sign_.segment(front.first, front.own);
    if (!eliminate(panel, border, sign)) return false;
    negative_[f] = static_cast<int>((sign.array() < 0).count());
  }
  return true;
}

int FrontalCholesky::negative() const {
  return std::accumulate(negative_.begin(), negative_.end(), 0);
}

template <typename Matrix>
void FrontalCholesky::change_signs(Matrix& rhs) const {
  for (std::size_t f = 0; f < negative_.size(); ++f) {
    const Dissection::Front& front = order_.fronts[f];
    for (int k = front.first; k < front.first + front.own && negative_[f] > 0; ++k) {
      if (sign_[k] < 0) rhs.row(k) *= -1;
    }
  }
}

template <typename Matrix>
void FrontalCholesky::lower(Matrix& rhs) const {
  typename Matrix::PlainObject border(widest_border_, rhs.cols());
  for (const Dissection::Front& front : order_.fronts) {
    const auto rim = static_cast<Eigen::Index>(front.border.size());
    auto own = rhs.middleRows(front.first, front.own);
    if ((own.array() == 0.0).all()) continue;
    const ConstDense panel(&panels_[front.entries], front.height(), front.own);
    panel.topRows(front.own).triangularView<Eigen::Lower>().solveInPlace(own);
    if (rim == 0) continue;
    border.topRows(rim).noalias() = panel.bottomRows(rim) * own;
    for (Eigen::Index k = 0; k < rim; ++k) rhs.row(front.border[k]) -= border.row(k);
  }
}

template <typename Matrix>
void FrontalCholesky::upper(Matrix& rhs) const {
  change_signs(rhs);
  typename Matrix::PlainObject border(widest_border_, rhs.cols());
  for (auto front = order_.fronts.rbegin(); front != order_.fronts.rend(); ++front) {
    const auto rim = static_cast<Eigen::Index>(front->border.size());
    auto own = rhs.middleRows(front->first, front->own);
    const ConstDense panel(&panels_[front->entries], front->height(), front->own);
    for (Eigen::Index k = 0; k < rim; ++k) border.row(k) = rhs.row(front->border[k]);
    if (rim > 0) own.noalias() -= panel.bottomRows(rim).transpose() * border.topRows(rim);
    panel.topRows(front->own).triangularView<Eigen::Lower>().transpose().solveInPlace(own);
  }
}

void FrontalCholesky::solve_lower(Eigen::Ref<MatrixXd> rhs) const { lower(rhs); }
void FrontalCholesky::solve_lower(RightSides& rhs) const { lower(rhs); }
void FrontalCholesky::apply_signs(Eigen::Ref<MatrixXd> rhs) const { change_signs(rhs); }
void FrontalCholesky::solve_upper(Eigen::Ref<MatrixXd> rhs) const { upper(rhs); }
void FrontalCholesky::solve_upper(RightSides& rhs) const { upper(rhs); }

bool BorderSolver::compute(const MatrixXd& B, int negative) {
  negative_ = negative;
  if (negative == 0) {
    definite_.compute(B);
    return true;
  }
  indefinite_.compute(B);
  const VectorXd& values = indefinite_.eigenvalues();
  const bool regular = values.cwiseAbs().minCoeff() > kVanishes * values.cwiseAbs().maxCoeff();
  return regular && (values.array() < 0).count() == negative;
}

MatrixXd BorderSolver::solve(const MatrixXd& rhs) const {
  if (negative_ == 0) return definite_.solve(rhs);
  const MatrixXd& axes = indefinite_.eigenvectors();
  return axes * indefinite_.eigenvalues().asDiagonal().inverse() * (axes.transpose() * rhs);
}

}  // namespace omentum
