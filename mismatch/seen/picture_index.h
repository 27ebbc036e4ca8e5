#pragma once

#include <Eigen/Core>
#include <cmath>
#include <compare>
#include <cstddef>
#include <optional>
#include <vector>

namespace omentum {

/// Points of a picture in rows of cells, to find the nearest one.
class PictureIndex {
 public:
  PictureIndex(std::vector<Eigen::Vector2d> points, double reach);
  /// Nearest within the reach, but for that number; nothing beyond.
  std::optional<std::size_t> nearest(const Eigen::Vector2d& q, std::size_t skip) const;
  const Eigen::Vector2d& at(std::size_t k) const { return points_[k]; }
  /// Median distance from a point to the next one; 0 where none has one.
  double spacing() const;
  std::size_t size() const { return points_.size(); }

 private:
  static constexpr int kCells = 8;  ///< of the reach
  struct Entry {
    int y, x;
    std::size_t point;
    auto operator<=>(const Entry&) const = default;
  };
  int cell_of(double at) const;
  std::vector<Eigen::Vector2d> points_;
  double reach_;
  std::vector<Entry> entries_;
};

}  // namespace omentum
