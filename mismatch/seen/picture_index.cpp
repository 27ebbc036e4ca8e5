#include "mismatch/seen/picture_index.h"

#include <algorithm>
#include <utility>

namespace omentum {

using Eigen::Vector2d;

PictureIndex::PictureIndex(std::vector<Vector2d> points, double reach)
    : points_(std::move(points)), reach_(reach) {
  for (std::size_t k = 0; k < points_.size(); ++k)
    entries_.push_back({cell_of(points_[k].y()), cell_of(points_[k].x()), k});
  std::ranges::sort(entries_);
}

std::optional<std::size_t> PictureIndex::nearest(const Vector2d& q, std::size_t skip) const {
  std::optional<std::size_t> best;
  double least = reach_ * reach_;
  const int x = cell_of(q.x()), y = cell_of(q.y());
  // In ever larger squares, until no cell outside can have a nearer one.
  for (int around = 1; around <= kCells; around *= 2) {
    for (int row = y - around; row <= y + around; ++row) {
      auto entry = std::ranges::lower_bound(entries_, Entry{row, x - around, 0});
      for (; entry != entries_.end() && entry->y == row && entry->x <= x + around; ++entry) {
        const double squared = (points_[entry->point] - q).squaredNorm();
        if (entry->point == skip || !(squared < least)) continue;
        least = squared;
        best = entry->point;
      }
    }
    const double seen = around * reach_ / kCells;
    if (best && least <= seen * seen) break;
  }
  return best;
}

double PictureIndex::spacing() const {
  std::vector<double> spacing;
  for (std::size_t k = 0; k < size(); k += 7) {
    if (const auto other = nearest(points_[k], k))
      spacing.push_back((points_[*other] - points_[k]).norm());
  }
  if (spacing.empty()) return 0;
  const auto middle = spacing.begin() + static_cast<std::ptrdiff_t>(spacing.size() / 2);
  std::nth_element(spacing.begin(), middle, spacing.end());
  return *middle;
}

int PictureIndex::cell_of(double at) const {
  constexpr double kFar = 1e9;  // beside the camera
  return static_cast<int>(std::floor(std::clamp(kCells * at / reach_, -kFar, kFar)));
}

}  // namespace omentum
